"""Counters without wrap, compiled: the same numbers as ``bench.frame.counter``, one frame after the other."""

from __future__ import annotations

import numpy as np

from bench.frame.kernel import arrays as place
from bench.frame.kernel import task as order
from bench.frame.kernel.words import (
    as_float,
    as_word,
    inlined,
    load_8,
    load_64,
    row_of,
    store_8,
    store_64,
    tell,
    told,
)

_LATE = 1.5  # frames; what comes sooner is in time
_NO_FRACTION = 6755399441055744.0  # 1.5 * 2^52: a number added to it is rounded to a whole one


@inlined
def rounded(number):
    """Return the nearest whole number, an even one where two are."""
    return np.int64((number + _NO_FRACTION) - _NO_FRACTION)


@inlined
def next_of(task, first, end):
    """Return the message of ``first`` to ``end`` whose next frame stands first in the stream; ``end``: none is left."""
    block, room, found, least = np.uint64(told(task, order.BLOCK)), told(task, order.ROOM), end, np.int64(0)
    for message in range(first, end):
        spot = order.MESSAGES + order.PER_MESSAGE * message
        number = told(task, spot + 2)
        if number < told(task, spot):
            offset = told(block + np.uint64(order.FOUND_BYTES * message * room), number)
            if found == end or offset < least:
                found, least = message, offset
    return found


@inlined
def together(task, first, end, stamp):
    """Return how many of the next frames of the messages ``first`` to ``end`` have that stamp."""
    block, room, frames = np.uint64(told(task, order.BLOCK)), told(task, order.ROOM), 0
    for message in range(first, end):
        spot = order.MESSAGES + order.PER_MESSAGE * message
        number, count = told(task, spot + 2), told(task, spot)
        stamps = block + np.uint64((order.FOUND_BYTES * message + 16) * room)
        if number < count and told(stamps, count - 1) == stamp and told(stamps, number) == stamp:
            frames += count - number
            continue
        while number < count and told(stamps, number) == stamp:
            number += 1
            frames += 1
    return frames


@inlined
def due_at(task, spot, number, stamp, state, first, end):
    """Return the step that time predicts of a frame: 1 inside a chunk, at its start the time since the last one."""
    before, per_ns = told(state, order.T_NS), as_float(load_64(state + np.uint64(8 * order.PER_NS)))
    if stamp == before:
        return 1.0
    tell(state, order.T_NS, stamp)
    if per_ns == 0.0:
        return 1.0
    tell(task, spot + 2, number)
    late = (stamp - before) * per_ns - (together(task, first, end, stamp) - 1)
    return 1.0 if late < _LATE else late


@inlined
def follow(value, due, state, task):
    """Follow a counter for one frame; return its count and whether the frame is suspect."""
    wrap, reach = told(state, order.WRAP), told(state, order.REACH)
    trusted, last, highest = told(state, order.RAW), told(state, order.LAST), told(state, order.HIGHEST)
    rejected, quarter = told(state, order.REJECTED_RAW), wrap / 4
    due += as_float(load_64(state + np.uint64(8 * order.MISSED)))
    step = (value - trusted) & (wrap - 1)
    if due - step > quarter or step - due > quarter:  # else it is the nearest one as it stands
        step += wrap * rounded((due - step) / wrap)
    if -reach <= step <= due + quarter:
        last += step
    elif rejected >= 0 and 0 < (value - rejected) & (wrap - 1) <= reach:
        last = highest + max(1, rounded(due))
    else:
        tell(state, order.REJECTED_RAW, value)
        store_64(state + np.uint64(8 * order.MISSED), as_word(due))
        return last, True
    tell(state, order.RAW, value)
    tell(state, order.LAST, last)
    tell(state, order.HIGHEST, max(highest, last))
    tell(state, order.REJECTED_RAW, -1)
    store_64(state + np.uint64(8 * order.MISSED), as_word(0.0))
    tell(task, order.LOST, told(task, order.LOST) + max(0, last - highest - 1))
    tell(task, order.DUPLICATE, told(task, order.DUPLICATE) + np.int64(last <= highest))
    return last, False


@inlined
def go_on(counters, stamps, number, until, state):
    """Count frames of one chunk as long as each is the next one of a trusted counter; return the first other one."""
    last, raw, before = told(state, order.LAST), told(state, order.RAW), told(state, order.T_NS)
    odd = told(state, order.REJECTED_RAW) >= 0 or told(state, order.MISSED) or last != told(state, order.HIGHEST)
    if odd or not told(state, order.STARTED):
        return number
    within = told(state, order.WRAP) - 1
    while number < until and told(stamps, number) == before and (told(counters, number) - raw) & within == 1:
        raw = told(counters, number)
        last += 1
        tell(counters, number, last)
        number += 1
    tell(state, order.RAW, raw)
    tell(state, order.LAST, last)
    tell(state, order.HIGHEST, last)
    return number


@inlined
def unwrap(task, numbers, first, end, state):
    """Unwrap the counters of the next frames of the messages ``first`` to ``end``, which share one."""
    block, room, kinds = np.uint64(told(task, order.BLOCK)), told(task, order.ROOM), told(numbers, place.KINDS)
    suspects = block + np.uint64((order.FOUND_BYTES * kinds + told(numbers, place.ROW)) * room)
    message = next_of(task, first, end)
    while message < end:
        spot, found = (
            order.MESSAGES + order.PER_MESSAGE * message,
            block + np.uint64(order.FOUND_BYTES * message * room),
        )
        number = told(task, spot + 2)
        until = told(task, spot) if end - first == 1 else number + 1
        stamps, sent = found + np.uint64(16 * room), found + np.uint64(24 * room)
        while number < until:
            number = go_on(sent, stamps, number, until, state)
            if number == until:
                break
            stamp, counters = told(stamps, number), sent + np.uint64(8 * number)
            value = np.int64(load_64(counters))
            if not told(state, order.STARTED):
                tell(state, order.STARTED, 1)
                tell(state, order.T_NS, stamp)
                for index in (order.RAW, order.LAST, order.HIGHEST):
                    tell(state, index, value - 1)
            due = due_at(task, spot, number, stamp, state, first, end)
            count, odd = follow(value, due, state, task)
            store_64(counters, np.uint64(count))
            if odd:
                mark = suspects + np.uint64(message * room + number)
                tell(task, order.SUSPECT, told(task, order.SUSPECT) + 1 - np.int64(load_8(mark)))
                store_8(mark, np.uint64(1))
            number += 1
        tell(task, spot + 2, number)
        message = next_of(task, first, end)


@inlined
def count_frames(task, numbers, kinds):
    """Follow every counter of the definition through the frames that were found."""
    state = np.uint64(told(task, order.COUNTERS))
    step = kinds if told(numbers, place.SHARED) else 1
    first = 0
    while first < kinds:  # a range of any step could raise
        if told(row_of(numbers, place.MESSAGES_AT, first, place.MESSAGE_NUMBERS), place.COUNTER):
            unwrap(task, numbers, first, first + step, state + np.uint64(8 * order.COUNTER_NUMBERS * first))
        first += step
