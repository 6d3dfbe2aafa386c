"""Every shipped format beside the library of its makers and friends, construct and a loop: CPU nanoseconds per frame.

Run: python -m benchmarks.formats [FRAMES]. The stream is golden frames, one after the other. Ours decodes all fields of
all frames; the loop finds, checks and unpacks one frame at a time (find, crcmod or sum, struct or construct); the
libraries parse each frame into an object. What is not installed is left out (extras ``peers``, ``benchmark``).
"""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from functools import partial
from importlib import import_module
from types import ModuleType

from bench.frame import FrameDefinition, LinkDecoder, load_frame
from benchmarks.decoder import BLOCK_BYTES, FRAMES, chunked, cost_ns
from benchmarks.rivals import construct_readers, one_by_one, struct_readers

_READERS = {
    "ublox_ubx": ("pyubx2", "UBXReader"),
    "septentrio_sbf": ("pysbf2", "SBFReader"),
    "rtcm3": ("pyrtcm", "RTCMReader"),
    "nmea_0183": ("pynmeagps", "NMEAReader"),
    "ublox_sensors": ("pyubx2", "UBXReader"),
    "ccsds_jpss1": ("space_packet_parser.generators", "ccsds_generator"),  # tells packets apart, reads no field
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


def main() -> None:
    """Print one table."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100_000
    sys.stdout.write(
        f"{'format':<18} {'bytes':>6} {'ours':>9} {'struct':>9} {'construct':>12} {'library':>12}   ns per frame\n"
    )
    construct = _module("construct")
    for path in sorted(FRAMES.glob("*.yaml")):
        definition = load_frame(path)
        golden = definition.golden
        several, few = (b"".join(golden) * (number // len(golden)) for number in (count, _FEW))
        frames, some = (len(golden) * (number // len(golden)) for number in (count, _FEW))
        fast = cost_ns(partial(ours, definition, chunked(several, BLOCK_BYTES)), frames)
        slow = cost_ns(partial(one_by_one, definition, struct_readers(definition), few), some)
        by_construct = by_library = None
        if construct is not None and definition.layout.lines is None:
            readers = construct_readers(definition, construct)
            by_construct = cost_ns(partial(one_by_one, definition, readers, few), some, 1)
        module, name = _READERS.get(path.stem, ("", ""))
        if module and _module(module) is not None:
            by_library = cost_ns(partial(library, getattr(_module(module), name), few), some, 1)
        size = sum(map(len, golden)) / len(golden)
        rivals = " ".join(f"{'-' if cost is None else f'{cost:.0f}':>12}" for cost in (by_construct, by_library))
        sys.stdout.write(f"{path.stem:<18} {size:6.0f} {fast:9.0f} {slow:9.0f} {rivals}\n")


def _module(name: str) -> ModuleType | None:
    """Return a module, None where it is not installed."""
    try:
        return import_module(name)
    except ImportError:
        return None


if __name__ == "__main__":
    main()
