"""One element of a field, by the standard library."""

from __future__ import annotations

import struct
from typing import Any

from bench.frame.layout import Field, Span


def read_element(frame: bytes | bytearray, item: Field, element: int = 0) -> Any:
    """Return the raw value of one element of a field: a whole number or a float."""
    order: Any = "big" if item.big else "little"
    at, odd = item.place(element)
    size = -(-(odd + item.width) // 8)
    raw = frame[at : at + size]
    if item.kind == "f":
        return struct.unpack((">" if item.big else "<") + ("f" if item.size == 4 else "d"), raw)[0]
    if item.packed is None:
        return int.from_bytes(raw, order, signed=item.kind == "i")
    low = 8 * size - odd - item.width if item.big else odd
    value = int.from_bytes(raw, order) >> low & (1 << item.width) - 1
    return value - (1 << item.width) if item.kind == "i" and value >> item.width - 1 else value


def read_part(frame: bytes | bytearray, item: Field, bits: Span | None) -> int:
    """Return the whole number of a field, or of some bits of it."""
    value = int(read_element(frame, item))
    return value if bits is None else value >> bits[0] & (1 << bits[1]) - 1
