"""Checks of a frame: CRCs two ways, and the checksums that are no CRC.

A CRC is computed by crcmod (C) for a single frame, by 16-bit-step tables in numpy for a matrix of frames. Both work on
a little-end register ``s`` with the step ``s = (s >> 8) ^ T8[(s ^ byte) & 0xff]``. A reflected CRC has that form by
nature; the other kind is aligned to the left of a 16/32/64-bit register that is kept byte-swapped, so one step
without branches serves every model. A CRC is affine in the message: a matrix starts from a zero register (leading
zero bytes change nothing, odd lengths are padded in front) and the CRC of as many zero bytes is added. Checksums have a
closed form for a matrix of messages.

Beside them stand published CRC models of width 3 to 64, by name.

Source: Catalogue of parametrised CRC algorithms (RevEng). One line per model: name, width, poly, init, refin, refout,
xorout, check; numbers are hexadecimal, ``t``/``f`` are the reflections, check is the CRC of the text "123456789".
CRC-82/DARC is left out: it is wider than 64 bits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import crcmod.crcmod
import numpy as np

from bench.model.arrays import Array, Integers, Octets
from bench.model.errors import InputError


@dataclass(frozen=True)
class CrcModel:
    """The parameters that define a CRC (Williams' model); ``check`` is the CRC of b"123456789"."""

    name: str
    width: int
    poly: int
    init: int
    refin: bool
    refout: bool
    xorout: int
    check: int | None = None


_MODELS = """
crc-3/gsm 3 3 0 f f 7 4
crc-3/rohc 3 3 7 t t 0 6
crc-4/g-704 4 3 0 t t 0 7
crc-4/interlaken 4 3 f f f f b
crc-5/epc-c1g2 5 09 09 f f 00 00
crc-5/g-704 5 15 00 t t 00 07
crc-5/usb 5 05 1f t t 1f 19
crc-6/cdma2000-a 6 27 3f f f 00 0d
crc-6/cdma2000-b 6 07 3f f f 00 3b
crc-6/darc 6 19 00 t t 00 26
crc-6/g-704 6 03 00 t t 00 06
crc-6/gsm 6 2f 00 f f 3f 13
crc-7/mmc 7 09 00 f f 00 75
crc-7/rohc 7 4f 7f t t 00 53
crc-7/umts 7 45 00 f f 00 61
crc-8/autosar 8 2f ff f f ff df
crc-8/bluetooth 8 a7 00 t t 00 26
crc-8/cdma2000 8 9b ff f f 00 da
crc-8/darc 8 39 00 t t 00 15
crc-8/dvb-s2 8 d5 00 f f 00 bc
crc-8/gsm-a 8 1d 00 f f 00 37
crc-8/gsm-b 8 49 00 f f ff 94
crc-8/hitag 8 1d ff f f 00 b4
crc-8/i-432-1 8 07 00 f f 55 a1
crc-8/i-code 8 1d fd f f 00 7e
crc-8/lte 8 9b 00 f f 00 ea
crc-8/maxim-dow 8 31 00 t t 00 a1
crc-8/mifare-mad 8 1d c7 f f 00 99
crc-8/nrsc-5 8 31 ff f f 00 f7
crc-8/opensafety 8 2f 00 f f 00 3e
crc-8/rohc 8 07 ff t t 00 d0
crc-8/sae-j1850 8 1d ff f f ff 4b
crc-8/smbus 8 07 00 f f 00 f4
crc-8/tech-3250 8 1d ff t t 00 97
crc-8/wcdma 8 9b 00 t t 00 25
crc-10/atm 10 233 000 f f 000 199
crc-10/cdma2000 10 3d9 3ff f f 000 233
crc-10/gsm 10 175 000 f f 3ff 12a
crc-11/flexray 11 385 01a f f 000 5a3
crc-11/umts 11 307 000 f f 000 061
crc-12/cdma2000 12 f13 fff f f 000 d4d
crc-12/dect 12 80f 000 f f 000 f5b
crc-12/gsm 12 d31 000 f f fff b34
crc-12/umts 12 80f 000 f t 000 daf
crc-13/bbc 13 1cf5 0000 f f 0000 04fa
crc-14/darc 14 0805 0000 t t 0000 082d
crc-14/gsm 14 202d 0000 f f 3fff 30ae
crc-15/can 15 4599 0000 f f 0000 059e
crc-15/mpt1327 15 6815 0000 f f 0001 2566
crc-16/arc 16 8005 0000 t t 0000 bb3d
crc-16/cdma2000 16 c867 ffff f f 0000 4c06
crc-16/cms 16 8005 ffff f f 0000 aee7
crc-16/dds-110 16 8005 800d f f 0000 9ecf
crc-16/dect-r 16 0589 0000 f f 0001 007e
crc-16/dect-x 16 0589 0000 f f 0000 007f
crc-16/dnp 16 3d65 0000 t t ffff ea82
crc-16/en-13757 16 3d65 0000 f f ffff c2b7
crc-16/genibus 16 1021 ffff f f ffff d64e
crc-16/gsm 16 1021 0000 f f ffff ce3c
crc-16/ibm-3740 16 1021 ffff f f 0000 29b1
crc-16/ibm-sdlc 16 1021 ffff t t ffff 906e
crc-16/iso-iec-14443-3-a 16 1021 c6c6 t t 0000 bf05
crc-16/kermit 16 1021 0000 t t 0000 2189
crc-16/lj1200 16 6f63 0000 f f 0000 bdf4
crc-16/m17 16 5935 ffff f f 0000 772b
crc-16/maxim-dow 16 8005 0000 t t ffff 44c2
crc-16/mcrf4xx 16 1021 ffff t t 0000 6f91
crc-16/modbus 16 8005 ffff t t 0000 4b37
crc-16/nrsc-5 16 080b ffff t t 0000 a066
crc-16/opensafety-a 16 5935 0000 f f 0000 5d38
crc-16/opensafety-b 16 755b 0000 f f 0000 20fe
crc-16/profibus 16 1dcf ffff f f ffff a819
crc-16/riello 16 1021 b2aa t t 0000 63d0
crc-16/spi-fujitsu 16 1021 1d0f f f 0000 e5cc
crc-16/t10-dif 16 8bb7 0000 f f 0000 d0db
crc-16/teledisk 16 a097 0000 f f 0000 0fb3
crc-16/tms37157 16 1021 89ec t t 0000 26b1
crc-16/umts 16 8005 0000 f f 0000 fee8
crc-16/usb 16 8005 ffff t t ffff b4c8
crc-16/xmodem 16 1021 0000 f f 0000 31c3
crc-17/can-fd 17 1685b 00000 f f 00000 04f03
crc-21/can-fd 21 102899 000000 f f 000000 0ed841
crc-24/ble 24 00065b 555555 t t 000000 c25a56
crc-24/flexray-a 24 5d6dcb fedcba f f 000000 7979bd
crc-24/flexray-b 24 5d6dcb abcdef f f 000000 1f23b8
crc-24/interlaken 24 328b63 ffffff f f ffffff b4f3e6
crc-24/lte-a 24 864cfb 000000 f f 000000 cde703
crc-24/lte-b 24 800063 000000 f f 000000 23ef52
crc-24/openpgp 24 864cfb b704ce f f 000000 21cf02
crc-24/os-9 24 800063 ffffff f f ffffff 200fa5
crc-30/cdma 30 2030b9c7 3fffffff f f 3fffffff 04c34abf
crc-31/philips 31 04c11db7 7fffffff f f 7fffffff 0ce9e46c
crc-32/aixm 32 814141ab 00000000 f f 00000000 3010bf7f
crc-32/autosar 32 f4acfb13 ffffffff t t ffffffff 1697d06a
crc-32/base91-d 32 a833982b ffffffff t t ffffffff 87315576
crc-32/bzip2 32 04c11db7 ffffffff f f ffffffff fc891918
crc-32/cd-rom-edc 32 8001801b 00000000 t t 00000000 6ec2edc4
crc-32/cksum 32 04c11db7 00000000 f f ffffffff 765e7680
crc-32/iscsi 32 1edc6f41 ffffffff t t ffffffff e3069283
crc-32/iso-hdlc 32 04c11db7 ffffffff t t ffffffff cbf43926
crc-32/jamcrc 32 04c11db7 ffffffff t t 00000000 340bc6d9
crc-32/mef 32 741b8cd7 ffffffff t t 00000000 d2c22f51
crc-32/mpeg-2 32 04c11db7 ffffffff f f 00000000 0376e6e7
crc-32/xfer 32 000000af 00000000 f f 00000000 bd0be338
crc-40/gsm 40 0004820009 0000000000 f f ffffffffff d4164fc646
crc-64/ecma-182 64 42f0e1eba9ea3693 0000000000000000 f f 0000000000000000 6c40df5f0b497347
crc-64/go-iso 64 000000000000001b ffffffffffffffff t t ffffffffffffffff b90956c775a41001
crc-64/ms 64 259c84cba6426349 ffffffffffffffff t t 0000000000000000 75d4b74f024eceea
crc-64/nvme 64 ad93d23594c93659 ffffffffffffffff t t ffffffffffffffff ae8b14860a799888
crc-64/redis 64 ad93d23594c935a9 0000000000000000 t t 0000000000000000 e9c6d914c4b8d9ca
crc-64/we 64 42f0e1eba9ea3693 ffffffffffffffff f f ffffffffffffffff 62ec59e3f1a4f00a
crc-64/xz 64 42f0e1eba9ea3693 ffffffffffffffff t t ffffffffffffffff 995dc9bbdf1939fa
"""

_ALIASES = """
crc-4/g-704 crc-4/itu
crc-5/epc-c1g2 crc-5/epc
crc-5/g-704 crc-5/itu
crc-6/g-704 crc-6/itu
crc-7/mmc crc-7
crc-8/i-432-1 crc-8/itu
crc-8/maxim-dow crc-8/maxim dow-crc
crc-8/smbus crc-8
crc-8/tech-3250 crc-8/aes crc-8/ebu
crc-10/atm crc-10 crc-10/i-610
crc-11/flexray crc-11
crc-12/dect crc-12-x
crc-12/umts crc-12/3gpp
crc-15/can crc-15
crc-16/arc arc crc-16/lha crc-ibm
crc-16/dect-r r-crc-16
crc-16/dect-x x-crc-16
crc-16/genibus crc-16/darc crc-16/epc crc-16/epc-c1g2 crc-16/i-code
crc-16/ibm-3740 crc-16/autosar crc-16/ccitt-false ccitt-false
crc-16/ibm-sdlc crc-16/iso-hdlc crc-16/iso-iec-14443-3-b crc-16/x-25 crc-b x-25
crc-16/iso-iec-14443-3-a crc-a
crc-16/kermit crc-16/ccitt crc-16/ccitt-true crc-16/v-41-lsb crc-ccitt kermit
crc-16/maxim-dow crc-16/maxim
crc-16/modbus modbus
crc-16/profibus crc-16/iec-61158-2
crc-16/spi-fujitsu crc-16/aug-ccitt
crc-16/umts crc-16/buypass crc-16/verifone
crc-16/xmodem crc-16/acorn crc-16/lte crc-16/v-41-msb xmodem zmodem
crc-24/lte-a crc-24q
crc-24/openpgp crc-24
crc-32/aixm crc-32q
crc-32/base91-d crc-32d
crc-32/bzip2 crc-32/aal5 crc-32/dect-b b-crc-32
crc-32/cksum cksum crc-32/posix
crc-32/iscsi crc-32/base91-c crc-32/castagnoli crc-32/interlaken crc-32c
crc-32/iso-hdlc crc-32 crc-32/adccp crc-32/v-42 crc-32/xz pkzip
crc-32/jamcrc jamcrc
crc-32/xfer xfer
crc-64/ecma-182 crc-64
crc-64/xz crc-64/go-ecma
"""


def _read_model(line: str) -> CrcModel:
    name, width, poly, init, refin, refout, xorout, check = line.split()
    numbers = [int(text, 16) for text in (poly, init, xorout, check)]
    return CrcModel(name, int(width), numbers[0], numbers[1], refin == "t", refout == "t", numbers[2], numbers[3])


CATALOGUE: dict[str, CrcModel] = {model.name: model for model in map(_read_model, _MODELS.split("\n")[1:-1])}

ALIASES: dict[str, str] = {
    alias: name for name, *aliases in map(str.split, _ALIASES.split("\n")[1:-1]) for alias in aliases
}


def find_model(name: str) -> CrcModel | None:
    """Return the published model of that name or alias; letter case does not matter."""
    key = name.lower()
    return CATALOGUE.get(ALIASES.get(key, key))


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
