"""The compiled decoder: one function for every frame definition, which comes in as an array of numbers.

``decode`` goes through a block as the reference engine does, byte by byte, cuts the fields of frames out while their
bytes are in the cache, and follows the counters.
"""

from __future__ import annotations

import numpy as np

from bench.frame.kernel import arrays as place
from bench.frame.kernel import task as order
from bench.frame.kernel.checks import check_of, crc_plan
from bench.frame.kernel.columns import cut_column
from bench.frame.kernel.counters import count_frames
from bench.frame.kernel.words import (
    EIGHT,
    ONE,
    inlined,
    load_8,
    load_64,
    number_at,
    number_before,
    row_of,
    store_8,
    store_64,
    tell,
    told,
)

_CACHED_BYTES = 16_384  # of the stream between two cuts: still in the first-level cache


@inlined
def measure(address, there, numbers):
    """Return length and message of a candidate with ``there`` bytes; length -1: not known yet, 0: no such frame."""
    if there < told(numbers, place.HEADER):
        return -1, 0
    message, kinds, at = 0, told(numbers, place.KINDS), told(numbers, place.TYPE_AT)
    if at >= 0:
        size, big = told(numbers, place.TYPE_SIZE), told(numbers, place.TYPE_BIG) != 0
        kind = np.int64(number_at(address + np.uint64(at), there - at, size, big))
        rule = row_of(numbers, place.MESSAGES_AT, 0, 0)
        while message < kinds and told(rule, place.TYPE_VALUE) != kind:
            message += 1
            rule += np.uint64(8 * place.MESSAGE_NUMBERS)
        if message == kinds:
            return 0, 0
    rule, at = row_of(numbers, place.MESSAGES_AT, message, place.MESSAGE_NUMBERS), told(numbers, place.LENGTH_AT)
    fixed = told(rule, place.LENGTH)
    if at < 0:
        return fixed, message
    size, big = told(numbers, place.LENGTH_SIZE), told(numbers, place.LENGTH_BIG) != 0
    length = np.int64(number_at(address + np.uint64(at), there - at, size, big)) + told(numbers, place.LENGTH_PLUS)
    if length < told(rule, place.SHORTEST) or length > told(numbers, place.LONGEST):
        return 0, 0
    return (0, 0) if fixed not in (0, length) else (length, message)


@inlined
def passes(address, length, size, big, start, stop, plan):
    """Return whether the check of a frame, over its bytes [start, stop), is right."""
    stored = number_before(address + np.uint64(length), length, size, big)
    return check_of(address + np.uint64(start), stop - start, plan) == stored


@inlined
def begins(address, there, numbers, count, word, mask):
    """Return whether the pattern of ``count`` bytes stands at an address, of which ``there`` bytes are there."""
    if there >= 8:
        if (load_64(address) & mask) != word:
            return False
        first = 8
    else:
        first = 0
    if there < count:
        return False
    pattern = row_of(numbers, place.PATTERN_AT, 0, 0)
    for index in range(first, count):
        if load_8(address + np.uint64(index)) != load_64(pattern + np.uint64(8 * index)):
            return False
    return True


@inlined
def differs(address, numbers, rule):
    """Return 1 if a byte that the definition fixes is another one, else 0."""
    for index in range(told(rule, place.CONSTANTS), told(rule, place.CONSTANTS_END)):
        due = row_of(numbers, place.CONSTANTS_AT, index, 2)
        if np.int64(load_8(address + np.uint64(told(due, 0)))) != told(due, 1):
            return ONE
    return np.uint64(0)


@inlined
def take(stream, end, numbers, task, kinds):
    """Write the fields of the frames of every message from the first one on that is not cut."""
    room, block = told(task, order.ROOM), np.uint64(told(task, order.BLOCK))
    columns = block + np.uint64(order.FOUND_BYTES * kinds * room)
    origin, limit = stream - np.uint64(told(task, order.POSITION)), stream + np.uint64(end) - EIGHT
    for message in range(kinds):
        spot = order.MESSAGES + order.PER_MESSAGE * message
        count, first = told(task, spot), told(task, spot + 1)
        rule = row_of(numbers, place.MESSAGES_AT, message, place.MESSAGE_NUMBERS)
        offsets = block + np.uint64(order.FOUND_BYTES * message * room)
        for index in range(told(rule, place.FIELDS), told(rule, place.FIELDS_END)):
            field = row_of(numbers, place.FIELDS_AT, index, place.FIELD_NUMBERS)
            cut_column(
                origin, limit, offsets, first, count, field, columns + np.uint64(told(field, place.COLUMN) * room)
            )
        tell(task, spot + 1, count)


@inlined
def stamp_of(last, chunk, task):
    """Return the chunk that holds the byte with that stream offset, from ``chunk`` on."""
    ends, chunks = np.uint64(told(task, order.ENDS)), told(task, order.CHUNKS)
    while chunk < chunks and np.int64(load_64(ends + np.uint64(8 * chunk))) <= last:
        chunk += 1
    return chunk


@inlined
def reject(task, rejected, offset, chunk):
    """Write down a rejected candidate, as far as there is room."""
    room = told(task, order.BAD_ROOM)
    if rejected < room:
        spot = np.uint64(told(task, order.BAD)) + np.uint64(8 * rejected)
        store_64(spot, np.uint64(offset))
        if chunk < told(task, order.CHUNKS):
            stamp = load_64(np.uint64(told(task, order.STAMPS)) + np.uint64(8 * chunk))
            store_64(spot + np.uint64(8 * room), stamp)


@inlined
def run_of(address, frames, length, word, mask, size, big, start, stop, plan):
    """Return how many of the next frames, of one length, follow each other without a fault."""
    number = np.uint64(0)
    while number < frames:
        if (load_64(address) & mask) != word or not passes(address, length, size, big, start, stop, plan):
            break
        number += ONE
        address += np.uint64(length)
    return np.int64(number)


@inlined
def keep_run(address, offset, frames, length, stamp, numbers, rule, mine, suspects, room):
    """Write down frames that follow each other; return how many of them are suspect."""
    first, end = told(rule, place.COUNTER_AT), told(rule, place.COUNTER_SIZE)
    big, fixed, suspect = told(rule, place.COUNTER_BIG) != 0, told(rule, place.CONSTANTS), np.uint64(0)
    for number in range(np.uint64(frames)):
        spot = mine + EIGHT * number
        store_64(spot, np.uint64(offset) + number * np.uint64(length))
        store_64(spot + np.uint64(8 * room), np.uint64(length))
        store_64(spot + np.uint64(16 * room), stamp)
        if first >= 0:
            at = address + number * np.uint64(length) + np.uint64(first)
            store_64(spot + np.uint64(24 * room), number_at(at, length - first, end, big))
    for number in range(np.uint64(frames)):
        odd = np.uint64(0)
        if fixed < told(rule, place.CONSTANTS_END):
            odd = differs(address + number * np.uint64(length), numbers, rule)
        store_8(suspects + number, odd)
        suspect += odd
    return np.int64(suspect)


@inlined
def keep(stream, at, frames, length, message, chunk, task, numbers):
    """Write down frames of one message that follow each other, the first in the stretch of a chunk; count them."""
    room, kinds, spot = told(task, order.ROOM), told(numbers, place.KINDS), order.MESSAGES + order.PER_MESSAGE * message
    number, block, stamp = told(task, spot), np.uint64(told(task, order.BLOCK)), np.uint64(0)
    if chunk < told(task, order.CHUNKS):
        stamp = load_64(np.uint64(told(task, order.STAMPS)) + np.uint64(8 * chunk))
    suspects = (order.FOUND_BYTES * kinds + told(numbers, place.ROW) + message) * room + number
    suspect = keep_run(
        stream + np.uint64(at), told(task, order.POSITION) + at, frames, length, stamp, numbers,
        row_of(numbers, place.MESSAGES_AT, message, place.MESSAGE_NUMBERS),
        block + np.uint64(order.FOUND_BYTES * message * room + 8 * number), block + np.uint64(suspects), room,
    )  # fmt: skip
    tell(task, spot, number + frames)
    tell(task, order.SUSPECT, told(task, order.SUSPECT) + suspect)
    tell(task, order.ACCEPTED, told(task, order.ACCEPTED) + frames * length)


@inlined
def even_length(numbers):
    """Return the length that all frames have, 0 if they differ or are shorter than a word."""
    length = told(row_of(numbers, place.MESSAGES_AT, 0, 0), place.LENGTH)
    several = told(numbers, place.LENGTH_AT) >= 0 or told(numbers, place.TYPE_AT) >= 0
    return 0 if several or told(numbers, place.PATTERN) > 8 or length < 8 else length


@inlined
def keep_even(stream, at, stop, length, chunk, task, numbers, facts):
    """Write down the frames from ``at`` to ``stop`` on that end in one chunk; return their number and the chunk."""
    word, mask, size, big, plan = facts
    position, chunks = told(task, order.POSITION), told(task, order.CHUNKS)
    ahead, behind = stamp_of(position + at + length - 1, chunk, task), position + stop
    if ahead < chunks:
        behind = min(behind, told(np.uint64(told(task, order.ENDS)), ahead))
    rule = row_of(numbers, place.MESSAGES_AT, 0, 0)
    first, last = told(rule, place.COVER_START), told(rule, place.COVER_STOP)
    last = length - size if last < 0 else last
    most = np.uint64(max(1, (behind - position - at) // length))
    frames = run_of(stream + np.uint64(at), most, length, word, mask, size, big, first, last, plan)
    if frames:
        keep(stream, at, frames, length, 0, ahead, task, numbers)
    return frames, ahead if frames else chunk


@inlined
def candidate(stream, at, end, may_wait, final, task, numbers, facts):
    """Return length and message of the frame at ``at``; 0: there is none, -1: it must wait, -2: it is rejected."""
    word, mask, size, big, plan = facts
    address, pattern = stream + np.uint64(at), told(numbers, place.PATTERN)
    if end - at < pattern and may_wait:
        return -1, 0
    if not begins(address, end - at, numbers, pattern, word, mask):
        return 0, 0
    length, message = measure(address, end - at, numbers)
    whole = length >= 0 and at + length <= end
    if not whole and may_wait:
        return -1, 0
    rule = row_of(numbers, place.MESSAGES_AT, message, place.MESSAGE_NUMBERS)
    start, stop = told(rule, place.COVER_START), told(rule, place.COVER_STOP)
    stop = length - size if stop < 0 else stop
    if whole and length and passes(address, length, size, big, start, stop, plan):
        return length, message
    return (-2 if whole or not final else 0), 0


@inlined
def scan(stream, task, numbers, kinds):
    """Find, check and cut all frames of a block; see ``decode``."""
    end, position, final = told(task, order.LENGTH), told(task, order.POSITION), told(task, order.FINAL) != 0
    before, even = told(task, order.BEFORE), even_length(numbers)
    facts = (
        np.uint64(told(numbers, place.PATTERN_WORD)), np.uint64(told(numbers, place.PATTERN_MASK)),
        told(numbers, place.CHECK_SIZE), told(numbers, place.STORED_BIG) != 0, crc_plan(numbers),
    )  # fmt: skip
    at = rejected = due = chunk = 0
    while at < end:
        if at >= due:
            take(stream, end, numbers, task, kinds)
            due = at + _CACHED_BYTES
        if even and at + even <= end:
            frames, chunk = keep_even(stream, at, min(end, due), even, chunk, task, numbers, facts)
            if frames:
                at += frames * even
                continue
        length, message = candidate(stream, at, end, not final and at >= before, final, task, numbers, facts)
        if length == -1:
            break
        if length > 0:
            chunk = stamp_of(position + at + length - 1, chunk, task)
            keep(stream, at, 1, length, message, chunk, task, numbers)
            at += length
            continue
        if length == -2:
            reject(task, rejected, position + at, stamp_of(position + at, chunk, task))
            rejected += 1
        at += 1
    take(stream, end, numbers, task, kinds)
    return at, rejected


def decode(stream, task):
    """Decode a buffer from its start on; both arguments are addresses.

    Args:   task: numbers (``bench.frame.kernel.task``): the definition, bytes of the buffer and its stream offset,
            whether nothing will follow, bytes among which nothing may wait, room for frames in the block, addresses of
            the block and of room for rejected candidates (offsets, then stamps), ends and stamps of chunks, counters.
            Gives bytes decided, candidates rejected (more than there is room for: nothing else is valid), bytes
            accepted, lost, repeated and suspect frames, frames of each message.
            block: of each message stream offsets, lengths, stamps and counters; then the columns of all fields; then by
            message whether a frame is suspect; ``room`` each. Counters are as sent where no counters are told.
    """
    numbers = np.uint64(told(task, order.DEFINITION))
    kinds = told(numbers, place.KINDS)
    for index in range(order.ACCEPTED, order.MESSAGES + order.PER_MESSAGE * kinds):
        tell(task, index, 0)
    decided, rejected = scan(stream, task, numbers, kinds)
    tell(task, order.DECIDED, decided)
    tell(task, order.REJECTED, rejected)
    if rejected <= told(task, order.BAD_ROOM) and told(task, order.CHUNKS):
        count_frames(task, numbers, kinds)
