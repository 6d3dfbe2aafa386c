"""Checks of frames, compiled: CRCs by their numbers, and the checks that are no CRC.

A CRC is folded with carry-less products where the processor has them: a word that stands j words before the last one
is multiplied by x^(64 j) mod P, all products are added, and the 128 bits that remain are divided by three more. Eight
tables serve processors without the instruction, and messages of fewer than eight bytes. The register of the bytes
before goes into the first bytes of what follows.

Source: V. Gopal and others, "Fast CRC computation for generic polynomials using PCLMULQDQ instruction", Intel (2009);
M. Kounavis, F. Berry, "A systematic approach to building high performance software-based CRC generators" (2005).
"""

from __future__ import annotations

import numpy as np

from bench.frame.kernel import arrays as place
from bench.frame.kernel.variant import folds
from bench.frame.kernel.words import (
    BYTE,
    EIGHT,
    fold_plain,
    fold_reflected,
    inlined,
    load_8,
    load_64,
    row_of,
    swap_64,
    told,
    turn_64,
)

FOLDS = folds()


@inlined
def crc_plan(numbers):
    """Return what ``check_of`` needs of a definition, so that a loop reads it once."""
    return (
        np.uint64(told(numbers, place.CHECK)),
        np.uint64(told(numbers, place.REFLECTED)),
        np.uint64(told(numbers, place.TURNED)),
        np.uint64(64 - told(numbers, place.WIDTH)),
        np.uint64(told(numbers, place.XOROUT)),
        np.uint64(told(numbers, place.INITIAL)),
        numbers + np.uint64(8 * place.POLY),
        row_of(numbers, place.STEPS_AT, 0, 0),
        row_of(numbers, place.POWERS_AT, 0, 0),
        np.uint64(told(numbers, place.FOLDED_FROM)),
    )


@inlined
def crc_sliced(address, count, steps, state):
    """Return the register behind ``count`` bytes, its bytes in the order of memory; words by tables."""
    odd = count & 7
    for index in range(odd):
        byte = (state ^ load_8(address + np.uint64(index))) & BYTE
        state = (state >> EIGHT) ^ load_64(steps + EIGHT * byte)
    for index in range(count >> 3):
        word = load_64(address + np.uint64(odd + 8 * index)) ^ state
        state = np.uint64(0)
        for byte in range(8):
            state ^= load_64(steps + np.uint64(2048 * (7 - byte)) + EIGHT * ((word >> np.uint64(8 * byte)) & BYTE))
    return state


def fold_odd(address, odd, words, plan, state):
    """Return the register behind ``odd`` bytes and ``words`` words; the register before goes into the first eight."""
    _, reflected, _, _, _, _, constants, _, powers, _ = plan
    first, carry, shift = np.uint64(0), state, np.uint64(8 * odd)
    if reflected:
        if odd:
            first, carry = (load_64(address) ^ state) << (np.uint64(64) - shift), state >> shift
        return fold_reflected(address + np.uint64(odd), np.uint64(words), first, carry, powers, constants)
    if odd:
        first, carry = (swap_64(load_64(address)) ^ state) >> (np.uint64(64) - shift), state << shift
    return fold_plain(address + np.uint64(odd), np.uint64(words), first, carry, powers, constants)


def crc_folded(address, count, plan, state):
    """Return the register behind ``count`` bytes, eight or more, by carry-less products."""
    odd, words = count & 7, count >> 3
    while words > place.FOLDED_WORDS:
        state = _fold_odd(address, odd, place.FOLDED_WORDS, plan, state)
        address += np.uint64(odd + 8 * place.FOLDED_WORDS)
        words -= place.FOLDED_WORDS
        odd = 0
    return _fold_odd(address, odd, words, plan, state)


if FOLDS:
    _fold_odd, _folded = inlined(fold_odd), inlined(crc_folded)


@inlined
def crc_of(address, count, plan):
    """Return the value of the CRC over ``count`` bytes."""
    _, reflected, turned, above, xorout, state, _, steps, _, least = plan
    if FOLDS and count >= np.int64(least):
        state = _folded(address, count, plan, state)
    else:
        state = state if reflected else swap_64(state)
        state = crc_sliced(address, count, steps, state)
        state = state if reflected else swap_64(state)
    value = state if reflected else state >> above
    if turned:
        value = turn_64(value) >> above
    return value ^ xorout


@inlined
def checksum(address, count, kind):
    """Return a check that is no CRC: exclusive or, sum, or Fletcher's two sums."""
    low = high = both = np.uint64(0)
    if kind == place.FLETCHER_32:
        for index in range(0, count, 2):
            low += load_8(address + np.uint64(index))
            if index + 1 < count:
                low += load_8(address + np.uint64(index + 1)) << EIGHT
            high += low
        return (high % np.uint64(65535)) << np.uint64(16) | low % np.uint64(65535)
    for index in range(count):
        byte = load_8(address + np.uint64(index))
        both ^= byte
        low += byte
        high += low
    if kind == place.XOR_8:
        return both
    if kind == place.FLETCHER_16:
        return (high % BYTE) << EIGHT | low % BYTE
    return low & (BYTE if kind == place.SUM_8 else np.uint64(65535))


@inlined
def check_of(address, count, plan):
    """Return the value of the check over ``count`` bytes."""
    kind = np.int64(plan[0])
    return crc_of(address, count, plan) if kind == place.CRC else checksum(address, count, kind)
