"""A layout as the array of numbers that the compiled kernel takes, and where each number stands in it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from bench.frame.catalogue import CrcModel
from bench.frame.crc import Check, Crc, reflect, register_steps
from bench.frame.layout import Field, Layout, Message

# of the frame: places in ``Arrays.numbers``; tables of rows stand where the ..._AT say
(HEADER, LENGTH_AT, LENGTH_SIZE, LENGTH_BIG, LENGTH_PLUS, LONGEST, TYPE_AT, TYPE_SIZE, TYPE_BIG, CHECK, CHECK_SIZE,
 STORED_BIG, PATTERN, PATTERN_WORD, PATTERN_MASK, SHARED, KINDS, ROW, REFLECTED, TURNED, WIDTH, XOROUT, INITIAL, POLY,
 INVERSE, POWER_128, FOLDED_FROM, PATTERN_AT, MESSAGES_AT, FIELDS_AT, CONSTANTS_AT, STEPS_AT, POWERS_AT,
 HEAD) = range(34)  # fmt: skip
# of a message: columns of its row
(TYPE_VALUE, SHORTEST, LENGTH, COVER_START, COVER_STOP, FIELDS, FIELDS_END, CONSTANTS, CONSTANTS_END, COUNTER,
 COUNTER_AT, COUNTER_SIZE, COUNTER_BIG, MESSAGE_NUMBERS) = range(14)  # fmt: skip
# of a field: columns of its row
AT, SIZE, ROOM, BIG, SIGNED, ELEMENTS, COLUMN, STEP, FIELD_NUMBERS = range(9)
# kinds of checks
CRC, XOR_8, SUM_8, SUM_16, FLETCHER_16, FLETCHER_32 = range(6)
_CHECKSUMS = {
    "xor-8": XOR_8, "sum-8": SUM_8, "sum-16": SUM_16,
    "fletcher-16-mod255": FLETCHER_16, "fletcher-32-mod65535": FLETCHER_32,
}  # fmt: skip
FOLDED_WORDS = 128
"""Words of a message that are folded at once; a longer one goes on from the register of those before."""
_REGISTER = 64
_WORD_BYTES = 8  # a shorter message goes through the tables
_ALL = (1 << _REGISTER) - 1
_TABLES = 8


@dataclass(frozen=True)
class Arrays:
    """What the kernel is told of a layout.

    ``columns``: where the column of each field begins, by message, in bytes per frame; ``width``: bytes per frame of
    all columns; ``shortest``: bytes of the shortest frame.
    """

    numbers: NDArray[np.int64]
    columns: tuple[dict[str, int], ...]
    width: int
    shortest: int


def arrays_of(layout: Layout) -> Arrays:
    """Return a layout as numbers."""
    messages: list[list[int]] = []
    fields: list[list[int]] = []
    constants: list[list[int]] = []
    columns: list[dict[str, int]] = []
    column = 0
    for message in layout.messages:
        first_field, first_constant = len(fields), len(constants)
        places: dict[str, int] = {}
        for item in message.fields:
            if not item.rest:
                fields.append(_field(item, column))
                places[item.name] = column
                column += fields[-1][STEP]
            constants += [[item.offset + index, byte] for index, byte in enumerate(_fixed(item, layout))]
        columns.append(places)
        counter = [0] if message.counter is None else [1]
        spans = [first_field, len(fields), first_constant, len(constants), *counter, *_spot(message.counter)]
        messages.append(_message(message, layout.check.size, spans))
    crc, steps, powers = _crc_numbers(layout)
    rows = ([word for row in table for word in row] for table in (messages, fields, constants))
    tables = [list(layout.pattern), *rows, steps, powers]
    places_of = HEAD + np.cumsum([0, *(len(table) for table in tables[:-1])])
    head = [*_head(layout), len(layout.messages), column, *crc, *places_of.tolist()]
    words = [number & _ALL for table in (head, *tables) for number in table]
    numbers = np.array(words, np.uint64).view(np.int64)
    shortest = min(message.body + layout.check.size for message in layout.messages)
    return Arrays(numbers, tuple(columns), column, shortest)


def knows(check: Check) -> bool:
    """Return whether the kernel knows a check."""
    return isinstance(check, Crc) or check.name in _CHECKSUMS


def holds(layout: Layout) -> bool:
    """Return whether the kernel can decode frames of a layout."""
    return not what_is_not_held(layout)


def what_is_not_held(layout: Layout) -> str:
    """Return what of a layout the kernel does not know, "" if nothing."""
    check = layout.check
    if not knows(check):
        return "frames without a check" if not check.size else check.name
    in_bits = any(message.counter is not None and message.counter.bits for message in layout.messages)
    unknown = {
        "a check that does not stand behind all fields": layout.check_field is not None,
        "escaped bytes": bool(layout.escape),
        "lines of text": layout.lines is not None,
        "a trailer": bool(layout.trailer),
        "frames without sync bytes": not layout.pattern,
        "a length or type in some bits of a field": bool(layout.length_bits or layout.type_bits),
        "a length that is a multiple": layout.length_times != 1,
        "frames of types that are not listed": layout.unlisted is not None,
        "a counter in some bits of a field": in_bits,
        "bytes in front of the sync bytes": layout.sync_at > 0,
        "integers of other than whole bytes": any(
            item.packed for message in layout.messages for item in message.fields
        ),
        "groups, items and optional parts": any(message.parts for message in layout.messages),
    }
    return next((text for text, there in unknown.items() if there), "")


def _head(layout: Layout) -> list[int]:
    """Return the numbers of the frame up to SHARED."""
    check, pattern = layout.check, layout.pattern[:8]
    kind = CRC if isinstance(check, Crc) else _CHECKSUMS[check.name]
    return [layout.header, *_spot(layout.length_field), layout.length_plus, layout.max_length,
            *_spot(layout.type_field), kind, check.size, int(layout.stored_big), len(layout.pattern),
            int.from_bytes(pattern, "little"), (1 << 8 * len(pattern)) - 1, int(layout.shared_counter)]  # fmt: skip


def _crc_numbers(layout: Layout) -> tuple[list[int], list[int], list[int]]:
    if isinstance(layout.check, Crc):
        return crc_numbers(layout.check.model)
    return [0] * (PATTERN_AT - REFLECTED), [], []


@lru_cache(maxsize=32)
def crc_numbers(model: CrcModel) -> tuple[list[int], list[int], list[int]]:
    """Return the numbers of a CRC from REFLECTED to FOLDED_FROM, its steps and its powers.

    P is its polynomial, Q the same times x^(64 - width), so that every register has 64 bits. Poly, inverse: Q and
    x^128 / Q without their highest bit; power 128: x^128 mod Q. Powers: x^(64 j) mod P for j words. All in the order of
    the bits that the message has; what is multiplied by a message in reversed order is divided by x, because the
    product of two reversed words lacks one bit. Steps, eight tables of 256: the register, in the order of the bytes in
    memory, that a byte leaves that 0 to 7 bytes follow.
    """
    width, reflected = model.width, model.refin
    full = (1 << width) | model.poly
    aligned = full << (_REGISTER - width)
    less = int(reflected)
    powers = [_power(64 * count - less, full) for count in range(1, FOLDED_WORDS + 1)]
    inverse, power_128 = _quotient(1 << 128, aligned) & _ALL, _power(128 - less, aligned)
    words = [aligned & _ALL, inverse, power_128, 0, *powers]
    if reflected:
        words = [reflect(word, _REGISTER) for word in words]
    initial = reflect(model.init, width) if reflected else model.init << (_REGISTER - width)
    head = [int(reflected), int(model.refin != model.refout), width, model.xorout, initial, *words[:3], _WORD_BYTES]
    step = register_steps(model, _REGISTER)
    tables = [np.array(step, np.uint64)]
    for _ in range(_TABLES - 1):
        last = tables[-1]
        tables.append((last >> np.uint64(8)) ^ tables[0][(last & np.uint64(255)).astype(np.intp)])
    return head, np.concatenate(tables).tolist(), words[3:]


def _power(exponent: int, modulus: int) -> int:
    """Return x^exponent modulo a polynomial."""
    found = 1
    for bit in f"{exponent:b}":
        found = _remainder(_square(found) << int(bit), modulus)
    return found


def _square(factor: int) -> int:
    """Return the square of a polynomial: its bits with zeros between them."""
    return int("0".join(f"{factor:b}"), 2)


def _remainder(dividend: int, divisor: int) -> int:
    while dividend.bit_length() >= divisor.bit_length():
        dividend ^= divisor << (dividend.bit_length() - divisor.bit_length())
    return dividend


def _quotient(dividend: int, divisor: int) -> int:
    found = 0
    while dividend.bit_length() >= divisor.bit_length():
        shift = dividend.bit_length() - divisor.bit_length()
        found |= 1 << shift
        dividend ^= divisor << shift
    return found


def _spot(item: Field | None) -> list[int]:
    return [-1, 0, 0] if item is None else [item.offset, item.size, int(item.big)]


def _message(message: Message, check_size: int, spans: list[int]) -> list[int]:
    stop = -1 if message.cover_stop is None else message.cover_stop
    kind = -1 if message.type_value is None else message.type_value
    return [kind, message.body + check_size, message.length, message.cover_start, stop, *spans]


def _field(item: Field, column: int) -> list[int]:
    room = np.dtype(item.dtype).itemsize
    elements = 1 if item.count is None else item.count
    return [item.offset, item.size, room, int(item.big), int(item.kind == "i"), elements, column, elements * room]


def _fixed(item: Field, layout: Layout) -> bytes:
    """Return the bytes of a constant that the pattern does not compare already."""
    return b"" if item.constant is None or item.offset < len(layout.pattern) else item.constant
