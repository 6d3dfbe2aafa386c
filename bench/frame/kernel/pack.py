"""The compiled encoder: columns of numbers of the machine to frames, their checks included."""

from __future__ import annotations

import numpy as np

from bench.frame.kernel import arrays as place
from bench.frame.kernel import task as order
from bench.frame.kernel.checks import check_of, crc_plan
from bench.frame.kernel.columns import copy_bytes, cut_vectors, write
from bench.frame.kernel.words import (
    inlined,
    load_8,
    load_16,
    load_32,
    load_64,
    row_of,
    store_8,
    store_16,
    store_32,
    store_64,
    swap_64,
    tell,
    told,
)

_ROWS_AT_ONCE = 128


def _reading(width):
    """Return the function that gives a number of the machine of that many bytes as a word."""
    above = 64 - 8 * width

    @inlined
    def number_of(address, signed):
        if width == 1:
            value = load_8(address)
        elif width == 2:
            value = load_16(address)
        elif width == 4:
            value = load_32(address)
        else:
            value = load_64(address)
        return np.uint64(np.int64(value << np.uint64(above)) >> np.int64(above)) if signed else value

    return number_of


@inlined
def beyond(value, size, signed, negative):
    """Return a word that is not 0 if a number does not fit ``size`` bytes; ``negative``: it is below 0."""
    above = 64 - 8 * size
    kept = value << np.uint64(above)
    if signed:
        again = np.uint64(np.int64(kept) >> np.int64(above))
        return value ^ again | np.uint64((np.int64(value) < 0) != negative)
    return value ^ kept >> np.uint64(above) | np.uint64(negative)


@inlined
def put(target, value, size, big):
    """Write the lowest ``size`` bytes of a word."""
    if big:
        value = swap_64(value) >> np.uint64(64 - 8 * size)
    if size == 3:
        store_16(target, value)
        store_8(target + np.uint64(2), value >> np.uint64(16))
        return
    if size in (1, 2, 4, 8):
        write(target, value, size)
        return
    for index in range(size):
        store_8(target + np.uint64(index), value >> np.uint64(8 * index))


def _converting(width):
    """Return the function that writes numbers of that many bytes into rows; it gives 0 if all of them fit."""
    number_of = _reading(width)

    @inlined
    def put_numbers(source, target, frames, length, count, size, big, signed, below):
        over = np.uint64(0)
        for _ in range(frames):
            for index in range(count):
                value = number_of(source, below)
                over |= beyond(value, size, signed, below and np.int64(value) < 0)
                put(target + np.uint64(size * index), value, size, big)
                source += np.uint64(width)
            target += np.uint64(length)
        return over

    return put_numbers


put_1, put_2, put_4, put_8 = map(_converting, (1, 2, 4, 8))


@inlined
def put_same(source, target, frames, length, count, size, big):
    """Write numbers of as many bytes as they have in the frame."""
    for _ in range(frames):
        if size == 1 or not big:
            copy_bytes(source, target, count * size)
        elif count * size >= 16:
            cut_vectors(source, target, count, size)
        elif size == 2:
            for index in range(count):
                value = swap_64(load_16(source + np.uint64(2 * index))) >> np.uint64(48)
                store_16(target + np.uint64(2 * index), value)
        elif size == 4:
            for index in range(count):
                value = swap_64(load_32(source + np.uint64(4 * index))) >> np.uint64(32)
                store_32(target + np.uint64(4 * index), value)
        else:
            for index in range(count):
                store_64(target + np.uint64(8 * index), swap_64(load_64(source + np.uint64(8 * index))))
        source += np.uint64(count * size)
        target += np.uint64(length)


@inlined
def put_column(stage, given, rows, first, end, length, field):
    """Write a field into the rows ``first`` to ``end``; return 0 if all its numbers fit."""
    size, count, frames = told(field, place.SIZE), told(field, place.ELEMENTS), end - first
    big, signed = told(field, place.BIG) != 0, told(field, place.SIGNED) != 0
    width, below = told(given, 2), told(given, 3) != 0
    source = stage + np.uint64(told(given, 1) + first * count * width)
    target = rows + np.uint64(first * length + told(field, place.AT))
    if size == width and below == signed:
        put_same(source, target, frames, length, count, size, big)
        return np.uint64(0)
    if width == 1:
        return put_1(source, target, frames, length, count, size, big, signed, below)
    if width == 2:
        return put_2(source, target, frames, length, count, size, big, signed, below)
    if width == 4:
        return put_4(source, target, frames, length, count, size, big, signed, below)
    return put_8(source, target, frames, length, count, size, big, signed, below)


@inlined
def seal(address, length, start, stop, size, big, plan):
    """Write the check over the bytes [start, stop) of a frame into its last ``size`` bytes."""
    put(address + np.uint64(length - size), check_of(address + np.uint64(start), stop - start, plan), size, big)


def encode(rows, template, stage, task):
    """Write frames; all arguments are addresses.

    Args:   rows: (n, length) bytes.   template: a frame as far as it is the same in all.
            stage: columns of the fields that are given, one behind the other from multiples of eight bytes on.
            task: the definition, number of frames, frame length, number of fields given, first and last byte that the
            check covers; of each field what ``bench.frame.kernel.task`` says. Gives 1 in the place of the definition if
            all numbers fit their fields, else 0.
    """
    numbers, count, length = np.uint64(told(task, 0)), told(task, order.FRAMES), told(task, order.FRAME_LENGTH)
    start, stop, plan = told(task, order.COVERED), told(task, order.COVERED + 1), crc_plan(numbers)
    size, big, over = told(numbers, place.CHECK_SIZE), told(numbers, place.STORED_BIG) != 0, np.uint64(0)
    for first in range(0, count, _ROWS_AT_ONCE):
        end = min(count, first + _ROWS_AT_ONCE)
        for row in range(first, end):
            copy_bytes(template, rows + np.uint64(row * length), length)
        for index in range(told(task, order.GIVEN_FIELDS)):
            given = task + np.uint64(8 * (order.OF_GIVEN + order.GIVEN_NUMBERS * index))
            field = row_of(numbers, place.FIELDS_AT, told(given, 0), place.FIELD_NUMBERS)
            over |= put_column(stage, given, rows, first, end, length, field)
        for row in range(first, end):
            seal(rows + np.uint64(row * length), length, start, stop, size, big, plan)
    tell(task, 0, np.int64(over == 0))
