"""Decoder, encoder and CRC costs side by side in one run: CPU nanoseconds per frame on clean ngu_a frames.

Run: python benchmarks/decoder.py [FRAMES]. Every decoder yields all fields of all frames, checks verified.
``construct`` is shown where it is installed (extra ``benchmark``).
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from time import process_time

import crcmod
import numpy as np

from bench.frame import FrameDefinition, LinkDecoder, load_frame

FRAMES = Path(__file__).resolve().parent.parent / "frames"
SEED = 20240501
LENGTH = 57
FIELDS = ("counter", "npp", "ppp", "af_clock", "master_count", "fg_count", "status")
BLOCK_BYTES = 2_000_000


def columns(count: int) -> dict[str, np.ndarray]:
    """Seeded contents of ``count`` frames of ngu_a."""
    generator = np.random.default_rng(SEED)
    return {
        "counter": (np.arange(count) % 65536).astype(np.uint16),
        "npp": generator.integers(0, 2561, (count, 10)).astype(np.uint16),
        "ppp": generator.integers(0, 2561, (count, 10)).astype(np.uint16),
        "af_clock": np.full(count, 2560, np.uint32),
        "master_count": np.full(count, 100_000, np.uint32),
        "fg_count": np.full(count, 100_000, np.uint32),
        "status": np.zeros(count, np.uint16),
    }


def vectorised(definition: FrameDefinition, chunks: list[bytes]) -> int:
    """The product's own way: LinkDecoder, chunk by chunk as received, every field extracted."""
    link = LinkDecoder(definition)
    found = 0
    for stamp, chunk in enumerate(chunks):
        link.push(stamp * 10_000_000 * len(chunk) // LENGTH, chunk)
        batch = link.flush().messages["frame"]
        for name in FIELDS:
            batch.raw(name)
        found += len(batch)
    return found


def chunked(stream: bytes, size: int) -> list[bytes]:
    """A stream in chunks."""
    return [stream[at : at + size] for at in range(0, len(stream), size)]


def copy_cost_ns() -> float:
    """Copying the bytes of a frame in buffers of 64 MiB, nanoseconds."""
    source = np.zeros(64 << 20, np.uint8)
    target = np.ones_like(source)
    return cost_ns(lambda: len(source) // LENGTH if np.copyto(target, source) is None else 0, len(source) // LENGTH, 5)


def encoded(definition: FrameDefinition, content: dict[str, np.ndarray], size: int) -> int:
    """Frames made in blocks of ``size``."""
    count = len(content["counter"])
    made = 0
    for at in range(0, count, size):
        part = {name: column[at : at + size] for name, column in content.items()}
        made += len(definition.encode(part, len(part["counter"])))
    return made


def peer_loop(stream: bytes) -> int:
    """The best simple program: bytes.find, crcmod in C, one struct call per frame."""
    check = crcmod.mkCrcFun(0x11021, 0xFFFF, False, 0)
    unpack = struct.Struct(">2xH10H10HBHBHBHHH").unpack_from
    at, rows = stream.find(b"\xeb\x90"), []
    while at >= 0 and at + LENGTH <= len(stream):
        if check(stream[at + 2 : at + 55]) == stream[at + 55] << 8 | stream[at + 56]:
            values = unpack(stream, at)
            clock, master, generator = (values[i] << 16 | values[i + 1] for i in (21, 23, 25))
            rows.append((values[0], values[1:11], values[11:21], clock, master, generator, values[27]))
            at += LENGTH
            if stream[at : at + 2] == b"\xeb\x90":
                continue
        else:
            at += 1
        at = stream.find(b"\xeb\x90", at)
    return len(rows)


def housekeeping(count: int) -> dict[str, np.ndarray]:
    """Seeded contents of ``count`` housekeeping frames of ngu_b."""
    generator = np.random.default_rng(SEED)
    return {
        "counter": (np.arange(count) % 65536).astype(np.uint16),
        "unit_temperature": generator.integers(-1000, 5000, (count, 4)).astype(np.int16),
        "supply_voltage": np.full(count, 18_000, np.uint16),
        "supply_current": np.full(count, 1850, np.uint16),
        "rails": np.tile(np.array([5000, 15_000, 15_000], np.uint16), (count, 1)),
        "status": np.ones(count, np.uint16),
    }


def housekeeping_loop(stream: bytes) -> int:
    """The same simple program for port B, whose frames say how long they are."""
    check = crcmod.mkCrcFun(0x11021, 0xFFFF, False, 0)
    unpack = struct.Struct(">2xBBH4hHH3HH").unpack_from
    at, rows = stream.find(b"\xeb\x9b"), []
    while at >= 0 and at + 4 <= len(stream):
        end = at + stream[at + 2]
        if end > at + 4 and check(stream[at + 2 : end - 2]) == stream[end - 2] << 8 | stream[end - 1]:
            if stream[at + 3] == 1:
                rows.append(unpack(stream, at))
            at = end
            if stream[at : at + 2] == b"\xeb\x9b":
                continue
        else:
            at += 1
        at = stream.find(b"\xeb\x9b", at)
    return len(rows)


def construct_loop(stream: bytes) -> int:
    """The declarative peer, compiled."""
    from construct import Array, Bytes, Checksum, Const, Int16ub, Int24ub, RawCopy, Struct, this

    check = crcmod.mkCrcFun(0x11021, 0xFFFF, False, 0)
    body = Struct(
        "counter" / Int16ub,
        "npp" / Array(10, Int16ub),
        "ppp" / Array(10, Int16ub),
        "clocks" / Array(3, Int24ub),
        "status" / Int16ub,
    )
    frame = Struct(
        "sync" / Const(b"\xeb\x90"),
        "body" / RawCopy(body),
        "crc" / Checksum(Bytes(2), lambda message: check(message).to_bytes(2, "big"), this.body.data),
    )
    return sum(frame.parse(stream[at : at + LENGTH]) is not None for at in range(0, len(stream), LENGTH))


def cost_ns(work: Callable[[], int], frames: int, repeats: int = 3) -> float:
    """Least CPU time of a few passes, nanoseconds per frame."""
    best = float("inf")
    for _ in range(repeats):
        start = process_time()
        found = work()
        best = min(best, process_time() - start)
        if found != frames:
            raise SystemExit(f"decoded {found} of {frames} frames")
    return best / frames * 1e9


def damaged(stream: bytes, share: float) -> tuple[bytes, int]:
    """Flip one bit in a share of the frames; gives the number of frames left good."""
    frames = np.frombuffer(stream, np.uint8).reshape(-1, LENGTH).copy()
    generator = np.random.default_rng(SEED + 1)
    hit = generator.random(len(frames)) < share
    frames[hit, generator.integers(2, LENGTH, hit.sum())] ^= 1
    return frames.tobytes(), int(len(frames) - hit.sum())


def main() -> None:
    """Print one table."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 400_000
    definition = load_frame(FRAMES / "ngu_a.yaml")
    content = columns(count)
    stream = definition.encode(content, count).tobytes()
    hurt, good = damaged(stream, 0.01)
    few = stream[: 20_000 * LENGTH]
    some = {name: column[:20_000] for name, column in content.items()}
    rows = [
        ("memcpy in buffers of 64 MiB", copy_cost_ns()),
        ("find + crcmod + struct loop", cost_ns(lambda: peer_loop(few), 20_000)),
    ]
    for name, part, size, frames in (
        ("2 MB blocks, all fields", stream, BLOCK_BYTES, count),
        ("1 % of the frames damaged", hurt, BLOCK_BYTES, good),
        ("1000 frames per feed", few, 1000 * LENGTH, 20_000),
        ("100 frames per feed", few, 100 * LENGTH, 20_000),
    ):
        rows.append((name, cost_ns(partial(vectorised, definition, chunked(part, size)), frames, 5)))
    for size, part in ((100, some), (20_000, content)):
        made = partial(encoded, definition, part, size)
        rows.append((f"encoder, {size} frames per call", cost_ns(made, len(part["counter"]))))
    try:
        rows.append(("construct", cost_ns(lambda: construct_loop(few[: 2000 * LENGTH]), 2000, 1)))
    except ImportError:
        sys.stdout.write("construct is not installed: left out\n")
    copy = rows[0][1]
    lines = [
        f"{count} frames of {LENGTH} bytes, seed {SEED}, CPU time",
        f"{'way':<42}{'ns/frame':>12}{'x memcpy':>12}",
    ]
    lines += [f"{name:<42}{cost:>12.1f}{cost / copy:>12.1f}" for name, cost in rows]
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
