"""Fields of many frames to columns, compiled: numbers of any size and order to numbers of the machine."""

from __future__ import annotations

import numpy as np

from bench.frame.kernel import arrays as place
from bench.frame.kernel.words import (
    EIGHT,
    inlined,
    load_8,
    load_64,
    raised_at,
    store_8,
    store_16,
    store_32,
    store_64,
    swap_64,
    swap_eights,
    swap_fours,
    swap_pairs,
    told,
)

_EVEN = np.uint64(0x00FF00FF00FF00FF)


@inlined
def cut_pairs(source, target, count):
    """Copy big-endian numbers of two bytes, four at once; the last four may overlap the ones before."""
    index = 0
    while index < count:
        index = min(index, count - 4)
        at = np.uint64(2 * index)
        word = load_64(source + at)
        store_64(target + at, (word & _EVEN) << EIGHT | (word >> EIGHT) & _EVEN)
        index += 4


@inlined
def cut_vectors(source, target, count, size):
    """Copy big-endian numbers of 2, 4 or 8 bytes, 16 bytes at once; the last 16 may overlap the ones before."""
    index, end = 0, count * size
    while index < end:
        index = min(index, end - 16)
        at = np.uint64(index)
        if size == 2:
            swap_pairs(source + at, target + at)
        elif size == 4:
            swap_fours(source + at, target + at)
        else:
            swap_eights(source + at, target + at)
        index += 16


@inlined
def copy_bytes(source, target, count):
    """Copy bytes, eight at once; the last eight may overlap the ones before."""
    index = 0
    while index < count:
        if count >= 8:
            index = min(index, count - 8)
            store_64(target + np.uint64(index), load_64(source + np.uint64(index)))
            index += 8
        else:
            store_8(target + np.uint64(index), load_8(source + np.uint64(index)))
            index += 1


@inlined
def write(target, value, width):
    """Write a number in native order."""
    if width == 4:
        store_32(target, value)
    elif width == 8:
        store_64(target, value)
    elif width == 2:
        store_16(target, value)
    else:
        store_8(target, value)


@inlined
def cut_element(source, limit, size, big, signed, width, target):
    """Write one number in native order; eight bytes may be read up to the address ``limit``."""
    shift = np.uint64(64 - 8 * size)
    value = raised_at(source, 8 if source <= limit else size, size, big)
    value = np.uint64(np.int64(value) >> np.int64(shift)) if signed else value >> shift
    write(target, value, width)


def _plain_column(width):
    """Return the function that writes unsigned big-endian numbers from where eight bytes may be read."""

    @inlined
    def run(origin, offsets, first, end, at, shift, target):
        for number in range(np.uint64(first), np.uint64(end)):
            value = swap_64(load_64(origin + load_64(offsets + EIGHT * number) + at)) >> shift
            write(target + np.uint64(width) * number, value, width)

    return run


_column_2, _column_4 = _plain_column(2), _plain_column(4)


@inlined
def cut_single(origin, limit, offsets, first, end, field, target):
    """Write a field of one number."""
    size, width, at = told(field, place.SIZE), told(field, place.ROOM), np.uint64(told(field, place.AT))
    big, signed, shift = told(field, place.BIG) != 0, told(field, place.SIGNED) != 0, np.uint64(64 - 8 * size)
    safe = end
    while safe > first and origin + load_64(offsets + np.uint64(8 * (safe - 1))) + at > limit:
        safe -= 1
    if width == 2 and big and not signed:
        _column_2(origin, offsets, first, safe, at, shift, target)
    elif width == 4 and big and not signed:
        _column_4(origin, offsets, first, safe, at, shift, target)
    else:
        safe = first
    for number in range(np.uint64(safe), np.uint64(end)):
        source = origin + load_64(offsets + EIGHT * number) + at
        cut_element(source, limit, size, big, signed, width, target + np.uint64(width) * number)


@inlined
def cut_column(origin, limit, offsets, first, end, field, target):
    """Write one field of the frames ``first`` to ``end``, whose bytes begin at ``origin`` + offset."""
    count = told(field, place.ELEMENTS)
    if count == 1:
        cut_single(origin, limit, offsets, first, end, field, target)
        return
    size, width = told(field, place.SIZE), told(field, place.ROOM)
    big, signed = told(field, place.BIG) != 0, told(field, place.SIGNED) != 0
    at, step = np.uint64(told(field, place.AT)), np.uint64(told(field, place.STEP))
    for number in range(np.uint64(first), np.uint64(end)):
        source, out = origin + load_64(offsets + EIGHT * number) + at, target + step * number
        if size == 1 or (size == width and not big):
            copy_bytes(source, out, count * size)
        elif size == width and count * size >= 16:
            cut_vectors(source, out, count, size)
        elif size == 2 and count >= 4:
            cut_pairs(source, out, count)
        else:
            for index in range(count):
                spot = source + np.uint64(size * index)
                cut_element(spot, limit, size, big, signed, width, out + np.uint64(width * index))
