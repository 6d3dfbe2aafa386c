"""Checks of a frame: CRCs two ways, and the checksums that are no CRC.

A CRC is computed by crcmod (C) for a single frame, by 16-bit-step tables in numpy for a matrix of frames. Both work on
a little-end register ``s`` with the step ``s = (s >> 8) ^ T8[(s ^ byte) & 0xff]``. A reflected CRC has that form by
nature; the other kind is aligned to the left of a 16/32/64-bit register that is kept byte-swapped, so one step
without branches serves every model. A CRC is affine in the message: a matrix starts from a zero register (leading
zero bytes change nothing, odd lengths are padded in front) and the CRC of as many zero bytes is added. Checksums have a
closed form for a matrix of messages.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import crcmod.crcmod
import numpy as np

from bench.frame.catalogue import CrcModel
from bench.model.arrays import Array, Integers, Octets
from bench.model.errors import InputError

_BLOCK_ROWS = 4096  # words of a block stay in the second-level cache
_SINGLE_ROWS = 80  # below this many rows a C call per row is faster
_CRCMOD_WIDTHS = (8, 16, 24, 32, 64)


@dataclass(frozen=True)
class Checksum:
    """A checksum by name; see ``CHECKSUMS``."""

    name: str
    size: int
    _rows: Callable[[Octets], Array]

    def of(self, message: bytes) -> int:
        """Return the value over a message."""
        return int(self._rows(np.frombuffer(message, np.uint8)[np.newaxis])[0])

    def of_rows(self, rows: Octets) -> Array:
        """Return values over the rows of a (n, length) uint8 matrix, (n,) uint64."""
        return self._rows(rows).astype(np.uint64)


def _words(rows: Octets, word: int, order: str = "<") -> Integers:
    """Return the words of rows, the last one filled up with zeros."""
    padded = np.zeros((len(rows), rows.shape[1] + -rows.shape[1] % word), np.uint8)
    padded[:, : rows.shape[1]] = rows
    return padded.view(f"{order}u{word}").astype(np.int64)


def _fletcher_check(name: str, word: int, modulus: int) -> Checksum:
    def of_rows(rows: Octets) -> Array:
        wide = _words(rows, word)
        weights = np.arange(wide.shape[1], 0, -1, dtype=np.int64)
        return np.asarray((wide @ weights) % modulus << 8 * word | wide.sum(axis=1) % modulus)

    return Checksum(name, 2 * word, of_rows)


def _adler_rows(rows: Octets) -> Array:
    wide, length = rows.astype(np.int64), rows.shape[1]
    low = (1 + wide.sum(axis=1)) % _ADLER
    high = (length + wide @ np.arange(length, 0, -1, dtype=np.int64)) % _ADLER
    return np.asarray(high << 16 | low)


def _sum_check(bits: int, turned: str = "", order: str = "") -> Checksum:
    """Return the sum of the bytes, or with an order of 16-bit words, or its one's or two's complement.

    The value is stored in whole bytes.
    """
    sign, added = _TURNED[turned]

    def of_rows(rows: Octets) -> Array:
        summed = (_words(rows, 2, order) if order else rows).sum(axis=1, dtype=np.int64)
        return np.asarray((sign * summed + added) & (1 << bits) - 1)

    return Checksum(f"sum-{bits}{_WORDS[order]}{turned}", (bits + 7) // 8, of_rows)


_ADLER = 65521
_WORDS = {"": "", ">": "-words-big", "<": "-words-little"}
_TURNED = {"": (1, 0), "-ones": (-1, -1), "-twos": (-1, 0)}
CHECKSUMS: dict[str, Checksum] = {
    check.name: check
    for check in (
        _fletcher_check("fletcher-16-mod255", 1, 255),
        _fletcher_check("fletcher-16-mod256", 1, 256),
        _fletcher_check("fletcher-32-mod65535", 2, 65535),
        _fletcher_check("fletcher-32-mod65536", 2, 65536),
        Checksum("adler-32", 4, _adler_rows),
        Checksum("none", 0, lambda rows: np.zeros(len(rows), np.uint64)),
        Checksum("xor-8", 1, lambda rows: np.bitwise_xor.reduce(rows, axis=1)),
        *(_sum_check(bits, turned) for bits in (8, 16, 32) for turned in _TURNED),
        *(_sum_check(bits) for bits in (7, 15)),
        *(_sum_check(16, turned, order) for order in "><" for turned in _TURNED),
    )
}
"""Checks that are no CRC. Fletcher: sums of bytes (16) or little-endian 16-bit words (32) from zero, by its modulus."""

CHECKSUM_ALIASES = {"fletcher-16": "fletcher-16-mod255", "fletcher-32": "fletcher-32-mod65535"}
"""The modulus of Fletcher (1982) where none is said; u-blox and RFC 1145 have 256."""


def find_checksum(name: str) -> Checksum | None:
    """Return the checksum of that name or alias, None if there is none; letter case does not matter."""
    key = name.lower()
    return CHECKSUMS.get(CHECKSUM_ALIASES.get(key, key))


def require_fast_crc() -> None:
    """Refuse to work with the pure-Python fallback of crcmod, which is a hundred times slower."""
    if not getattr(crcmod.crcmod, "_usingExtension", False):
        raise InputError(
            "B-FRAME-031",
            "the compiled part of crcmod is missing (is the package 'crcmod' installed beside 'crcmod-plus'?)",
            where="python environment",
            next_step="uninstall both packages, then install 'crcmod-plus' alone",
        )


def reflect(value: int, width: int) -> int:
    """Reverse the order of the lowest ``width`` bits."""
    return int(f"{value:0{width}b}"[::-1], 2)


class Crc:
    """A CRC of width 1 to 64 by its parameters.

    ``of`` takes bytes; ``of_rows`` takes (n, length) uint8 and gives (n,) unsigned integers; both agree.
    Source: R. Williams, "A painless guide to CRC error detection algorithms" (parameter model, tables).
    """

    def __init__(self, model: CrcModel) -> None:
        self.model = model
        self.name = model.name
        self.size = (model.width + 7) // 8
        self._register = 16 if model.width <= 16 else 32 if model.width <= 32 else 64
        self._dtype = np.dtype(f"u{self._register // 8}")
        self._zeros: dict[int, int] = {}
        self.of = self._single()

    def of_rows(self, rows: Octets) -> Array:
        """CRC of every row of a (n, length) uint8 matrix, (n,) unsigned of 2, 4 or 8 bytes."""
        count, length = rows.shape
        out = np.empty(count, self._dtype)
        if count < _SINGLE_ROWS and self.model.width in _CRCMOD_WIDTHS:
            packed = rows.tobytes()
            of = self.of
            out[:] = [of(packed[at : at + length]) for at in range(0, count * length, length)]
            return out
        for start in range(0, count, _BLOCK_ROWS):
            out[start : start + _BLOCK_ROWS] = self._linear(rows[start : start + _BLOCK_ROWS])
        return np.asarray(self._finish(out) ^ self._dtype.type(self._of_zeros(length)))

    def _linear(self, rows: Octets) -> Array:
        odd, table = rows.shape[1] % 2, self._table16
        words = rows[:, odd:].view("<u2").T.copy()  # a copy of one row too: it is written to
        state = np.zeros(len(rows), self._dtype)
        if odd:
            state = table.take(rows[:, 0].astype(np.uint16) << 8)
        if self._register == 16:
            for word in words:
                word ^= state
                table.take(word, mode="clip", out=state)
            return state
        for word in words:
            word ^= state.astype(np.uint16)
            state = (state >> 16) ^ table.take(word, mode="clip")
        return state

    def _finish(self, state: Array) -> Array:
        model = self.model
        if not model.refin:
            state = state.byteswap() >> self._dtype.type(self._register - model.width)
        if model.refin != model.refout:
            turned = np.zeros_like(state)
            for bit in range(model.width):
                turned |= ((state >> self._dtype.type(bit)) & self._dtype.type(1)) << self._dtype.type(
                    model.width - 1 - bit
                )
            return turned
        return state

    @cached_property
    def _table16(self) -> Array:
        bytewise = np.array(self._table8, self._dtype)
        low, high = np.arange(65536) & 0xFF, np.arange(65536) >> 8
        state = bytewise[low]
        index = (state & self._dtype.type(0xFF)).astype(np.intp) ^ high
        return np.asarray((state >> self._dtype.type(8)) ^ bytewise[index])

    @cached_property
    def _table8(self) -> list[int]:
        """What each of the 256 bytes leaves of a register of zero; see the head of this file."""
        model, register = self.model, self._register
        if model.refin:
            return [_reflected_entry(byte, reflect(model.poly, model.width)) for byte in range(256)]
        poly = model.poly << (register - model.width)
        entries = (_plain_entry(byte, poly, register) for byte in range(256))
        return [int.from_bytes(entry.to_bytes(register // 8, "big"), "little") for entry in entries]

    def _single(self) -> Callable[[bytes], int]:
        model = self.model
        if model.width not in _CRCMOD_WIDTHS:
            return self._bytewise
        start = reflect(model.init, model.width) if model.refin else model.init
        function = crcmod.crcmod.mkCrcFun((1 << model.width) | model.poly, start, model.refin, 0)
        if model.refin == model.refout:
            return lambda message: int(function(message)) ^ model.xorout
        return lambda message: reflect(function(message), model.width) ^ model.xorout

    def _bytewise(self, message: bytes) -> int:
        """Any width, one table look-up per byte: slow, for the widths that crcmod does not hold."""
        model = self.model
        state = reflect(model.init, model.width)
        if not model.refin:
            aligned = model.init << (self._register - model.width)
            state = int.from_bytes(aligned.to_bytes(self._register // 8, "big"), "little")
        table = self._table8
        for byte in message:
            state = (state >> 8) ^ table[(state ^ byte) & 0xFF]
        if not model.refin:
            swapped = int.from_bytes(state.to_bytes(self._register // 8, "little"), "big")
            state = swapped >> (self._register - model.width)
        if model.refin != model.refout:
            state = reflect(state, model.width)
        return state ^ model.xorout

    def _of_zeros(self, length: int) -> int:
        if length not in self._zeros:
            self._zeros[length] = self.of(bytes(length))
        return self._zeros[length]


Check = Crc | Checksum
"""What a frame definition may have at its end."""


def _reflected_entry(byte: int, poly: int) -> int:
    for _ in range(8):
        byte = (byte >> 1) ^ (poly if byte & 1 else 0)
    return byte


def _plain_entry(byte: int, poly: int, register: int) -> int:
    top, mask = 1 << (register - 1), (1 << register) - 1
    state = byte << (register - 8)
    for _ in range(8):
        state = ((state << 1) ^ (poly if state & top else 0)) & mask
    return state
