"""Checksums that are no CRC: Fletcher-16, Fletcher-32, XOR-8, sum-8 and sum-16.

Each has a plain loop for one message and a closed form for a matrix of messages; they are tested against each other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray


class Check(Protocol):
    """What a frame definition needs of a CRC or checksum."""

    @property
    def name(self) -> str:
        """Name as in the definition."""

    @property
    def size(self) -> int:
        """Bytes of the stored value."""

    @property
    def of(self) -> Callable[[bytes], int]:
        """Value over a message."""

    def of_rows(self, rows: NDArray[np.uint8]) -> NDArray[Any]:
        """Return values over the rows of a (n, length) uint8 matrix, (n,) unsigned integers."""


@dataclass(frozen=True)
class Checksum:
    """A checksum by name; see ``CHECKSUMS``."""

    name: str
    size: int
    of: Callable[[bytes], int]
    _rows: Callable[[NDArray[np.uint8]], NDArray[Any]]

    def of_rows(self, rows: NDArray[np.uint8]) -> NDArray[Any]:
        """Return values over the rows of a (n, length) uint8 matrix, (n,) uint64."""
        return self._rows(rows).astype(np.uint64)


def _fletcher16(message: bytes) -> int:
    low = high = 0
    for byte in message:
        low = (low + byte) % 255
        high = (high + low) % 255
    return high << 8 | low


def _fletcher32(message: bytes) -> int:
    low = high = 0
    padded = message + bytes(len(message) % 2)
    for at in range(0, len(padded), 2):
        low = (low + int.from_bytes(padded[at : at + 2], "little")) % 65535
        high = (high + low) % 65535
    return high << 16 | low


def _xor8(message: bytes) -> int:
    value = 0
    for byte in message:
        value ^= byte
    return value


def _fletcher_rows(words: NDArray[Any], modulus: int, bits: int) -> NDArray[Any]:
    wide = words.astype(np.int64)
    weights = np.arange(wide.shape[1], 0, -1, dtype=np.int64)
    low = wide.sum(axis=1) % modulus
    high = (wide @ weights) % modulus
    return np.asarray(high << bits | low)


def _fletcher32_rows(rows: NDArray[np.uint8]) -> NDArray[Any]:
    count, length = rows.shape
    padded = np.zeros((count, length + length % 2), np.uint8)
    padded[:, :length] = rows
    return _fletcher_rows(padded.view("<u2"), 65535, 16)


def _sum_rows(rows: NDArray[np.uint8], modulus: int) -> NDArray[Any]:
    return np.asarray(rows.sum(axis=1, dtype=np.int64) % modulus)


CHECKSUMS: dict[str, Checksum] = {
    check.name: check
    for check in (
        Checksum("fletcher-16", 2, _fletcher16, lambda rows: _fletcher_rows(rows, 255, 8)),
        Checksum("fletcher-32", 4, _fletcher32, _fletcher32_rows),
        Checksum("xor-8", 1, _xor8, lambda rows: np.bitwise_xor.reduce(rows, axis=1)),
        Checksum("sum-8", 1, lambda message: sum(message) % 256, lambda rows: _sum_rows(rows, 256)),
        Checksum("sum-16", 2, lambda message: sum(message) % 65536, lambda rows: _sum_rows(rows, 65536)),
    )
}
"""Fletcher-16 adds bytes modulo 255, Fletcher-32 little-endian 16-bit words modulo 65535, both from zero."""
