"""Every shipped format beside the library of its makers and friends, and a simple loop: CPU nanoseconds per frame.

Run: python -m benchmarks.formats [FRAMES]. The stream is golden frames, one after the other. Ours decodes all fields of
all frames; the loop finds, checks and unpacks one frame at a time (find, crcmod or sum, struct); the libraries parse
each frame into an object. Libraries that are not installed are left out (extra ``peers``).
"""

from __future__ import annotations

import io
import struct
import sys
from collections.abc import Callable
from functools import partial
from importlib import import_module

from bench.frame import FrameDefinition, LinkDecoder, load_frame
from bench.frame.layout import Field, Layout
from benchmarks.decoder import BLOCK_BYTES, FRAMES, chunked, cost_ns

_CODES = {"u1": "B", "u2": "H", "u4": "I", "u8": "Q", "i1": "b", "i2": "h", "i4": "i", "i8": "q", "f4": "f", "f8": "d"}
_READERS = {
    "ublox_ubx": ("pyubx2", "UBXReader"),
    "septentrio_sbf": ("pysbf2", "SBFReader"),
    "rtcm3": ("pyrtcm", "RTCMReader"),
}
_FEW = 2000


def ours(definition: FrameDefinition, chunks: list[bytes]) -> int:
    """Decode all fields; gives the frames."""
    link = LinkDecoder(definition)
    for chunk in chunks:
        link.push(0, chunk)
        for batch in link.flush().messages.values():
            batch.columns()
    return link.counts.frames


def library(reader: Callable[..., object], stream: bytes) -> int:
    """Let the reader of a library parse a stream; gives the frames."""
    return sum(1 for _ in reader(io.BytesIO(stream)))  # type: ignore[attr-defined]


def loop(definition: FrameDefinition, stream: bytes) -> int:
    """Find, check and unpack one frame after the other, as a script for one unit does; gives the frames."""
    layout, frames, at = definition.layout, 0, 0
    unpack = {message.type_value: _unpacking(message.fields) for message in layout.messages}
    bodies = {message.type_value: message for message in layout.messages}
    pattern = layout.pattern
    while (at := stream.find(pattern, at)) >= 0 and at + layout.header <= len(stream):
        kind = _number(stream, at, layout.type_field, layout.type_bits)
        message = bodies[kind]
        size = message.length
        if layout.length_field is not None:
            stated = _number(stream, at, layout.length_field, layout.length_bits) or 0
            size = stated * layout.length_times + layout.length_plus
        if not _checked(layout, stream[at : at + size], message.cover_start, message.cover_stop):
            at += 1
            continue
        for code, offset in unpack[kind]:
            code.unpack_from(stream, at + offset)
        frames += 1
        at += size
    return frames


def _unpacking(fields: tuple[Field, ...]) -> list[tuple[struct.Struct, int]]:
    """Return one struct for each field that struct knows."""
    return [
        (struct.Struct(f"{'>' if item.big else '<'}{item.count or 1}{_CODES[f'{item.kind}{item.size}']}"), item.offset)
        for item in fields
        if f"{item.kind}{item.size}" in _CODES
    ]


def _number(stream: bytes, at: int, item: Field | None, bits: tuple[int, int] | None) -> int | None:
    if item is None:
        return None
    begin = at + item.offset
    value = int.from_bytes(stream[begin : begin + item.size], "big" if item.big else "little")
    return value if bits is None else value >> bits[0] & (1 << bits[1]) - 1


def _checked(layout: Layout, frame: bytes, start: int, stop: int | None) -> bool:
    size, end = layout.check.size, len(frame) - layout.tail
    at = end if layout.check_field is None else layout.check_field.offset
    stored = int.from_bytes(frame[at : at + size], "big" if layout.stored_big else "little")
    return layout.check.of(frame[start : end if stop is None else stop]) == stored


def main() -> None:
    """Print one table."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100_000
    sys.stdout.write(f"{'format':<18} {'bytes':>6} {'ours':>9} {'loop':>9} {'library':>12}   ns per frame\n")
    for path in sorted(FRAMES.glob("*.yaml")):
        definition = load_frame(path)
        golden = definition.golden
        several = b"".join(golden) * (count // len(golden))
        few = b"".join(golden) * (_FEW // len(golden))
        frames, some = len(golden) * (count // len(golden)), len(golden) * (_FEW // len(golden))
        fast = cost_ns(partial(ours, definition, chunked(several, BLOCK_BYTES)), frames)
        slow = cost_ns(partial(loop, definition, few), some)
        peer = ""
        if path.stem in _READERS:
            module, name = _READERS[path.stem]
            try:
                reader = getattr(import_module(module), name)
            except ImportError:
                peer = "not installed"
            else:
                peer = f"{cost_ns(partial(library, reader, few), some, 1):12.0f}"
        size = sum(map(len, golden)) / len(golden)
        sys.stdout.write(f"{path.stem:<18} {size:6.0f} {fast:9.0f} {slow:9.0f} {peer:>12}\n")


if __name__ == "__main__":
    main()
