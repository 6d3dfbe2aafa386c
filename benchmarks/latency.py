"""From the write of a frame at the far end of a serial line to its place in the record, beside four busy processes.

Two pseudo-terminals carry 100 measurement frames of 57 bytes a second each, written by another process which
says when it wrote the last byte of each: at once as a pseudo-terminal does, and in pieces as the interrupts of a UART
bring them at 115,200 Bd.
"""

from __future__ import annotations

import multiprocessing
import os
import pty
import subprocess
import sys
import tempfile
import tty
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from bench.frame import FrameDefinition, load_frame
from bench.model.clock import NS, WallClock
from bench.record import SessionWriter
from bench.run.bus.acquisition import Acquisition
from bench.run.bus.opener import open_port
from bench.run.bus.port import PortLink
from bench.run.bus.reader import LinkReader
from bench.run.stop import StopSwitch

FRAMES = Path(__file__).resolve().parents[1] / "frames"
SECONDS = 20.0
BURNERS = 4
PORTS = ("port_a", "port_b")
PIECE_BYTES = 14  # trigger level of a 16550
BYTES_PER_S = 11_520
BURN = "while True: pass"


def frames_of(definition: FrameDefinition, count: int) -> list[bytes]:
    """Measurement frames, counters from 0 on."""
    columns = {
        "counter": np.arange(count) % 65536, "npp": np.zeros((count, 10), int), "ppp": np.zeros((count, 10), int),
        "af_clock": 2560, "master_count": 100_000, "fg_count": 100_000, "status": 0,
    }  # fmt: skip
    return [row.tobytes() for row in definition.encode(columns, count)]


def feed(descriptors: list[int], sent_ns: list[Any], piece: int) -> None:
    """Write to the lines at 100 Hz in pieces of so many bytes; runs as a process of its own.

    ``sent_ns``: per line, shared with the parent: when the last piece of each frame was written.
    """
    clock = WallClock()
    due_ns = clock.now_ns()
    for counter, raw in enumerate(frames_of(load_frame(FRAMES / "ngu_a.yaml"), len(sent_ns[0]))):
        due_ns += NS // 100
        clock.sleep_until_ns(due_ns)
        for at in range(0, len(raw), piece):
            if at:
                clock.sleep(piece / BYTES_PER_S)
            for descriptor, stamps in zip(descriptors, sent_ns, strict=True):
                stamps[counter] = clock.now_ns()
                os.write(descriptor, raw[at : at + piece])


@contextmanager
def two_lines() -> Iterator[tuple[list[int], list[str]]]:
    """Two pseudo-terminals: descriptors of the far ends, names of the near ones."""
    pairs = [pty.openpty() for _ in PORTS]
    for pair in pairs:
        tty.setraw(pair[1])
    try:
        yield [far for far, _ in pairs], [os.ttyname(near) for _, near in pairs]
    finally:
        for pair in pairs:
            for descriptor in pair:
                os.close(descriptor)


class Noting:
    """A session's sink that notes when each chunk had been taken."""

    def __init__(self, writer: SessionWriter, clock: WallClock) -> None:
        self._writer, self._clock = writer, clock
        self.event, self.command = writer.event, writer.command
        self.chunks: list[tuple[str, int, bytes]] = []

    def raw(self, link: str, direction: str, t_mono_ns: int, chunk: bytes) -> None:
        """Record, then note."""
        self._writer.raw(link, direction, t_mono_ns, chunk)
        self.chunks.append((link, self._clock.now_ns(), chunk))


Acquire = Callable[[list[str], Noting, SessionWriter, WallClock, Callable[[], None]], None]


def acquire(names: list[str], sink: Noting, writer: SessionWriter, clock: WallClock, wait: Callable[[], None]) -> None:
    """The acquisition of the bench, decoding included, until ``wait`` returns."""
    readers = {}
    for port, name in zip(PORTS, names, strict=True):
        link = PortLink(partial(open_port, port, name, 115_200, exclusive=True))
        readers[port] = LinkReader(port, link, load_frame(FRAMES / "ngu_a.yaml"), clock, sink)
    acquisition = Acquisition(readers, clock, writer.tick, StopSwitch())
    wait()
    acquisition.stop()
    for port, reader in readers.items():
        sys.stdout.write(f"  {port}: {reader.decoder.counts.frames} frames, {reader.decoder.counts.lost} lost\n")
        reader.link.close()


def measure(way: Acquire, piece: int, busy: int, seconds: float = SECONDS) -> tuple[list[float], float]:
    """Latencies of all frames, millisecond, and CPU time of this process as a share of the time."""
    clock, fork = WallClock(), multiprocessing.get_context("fork")
    with ExitStack() as stack, tempfile.TemporaryDirectory() as folder:
        far, names = stack.enter_context(two_lines())
        writer = SessionWriter.create(Path(folder) / "session", {}, {}, t_mono_ns=clock.now_ns())
        sink = Noting(writer, clock)
        sent_ns = [fork.Array("q", int(seconds * 100), lock=False) for _ in PORTS]
        feeder = fork.Process(target=feed, args=(far, sent_ns, piece), daemon=True)
        spent = [0.0, 0.0]

        def wait() -> None:
            feeder.start()
            began_s, began_ns = process_time(), clock.now_ns()
            with burners(busy):
                feeder.join()
            spent[:] = [process_time() - began_s, (clock.now_ns() - began_ns) / NS]
            clock.sleep(0.5)

        way(names, sink, writer, clock, wait)
        writer.close("done")
    return latencies_ms(sink.chunks, sent_ns), spent[0] / spent[1]


@contextmanager
def burners(count: int) -> Iterator[None]:
    """Busy processes."""
    busy = [subprocess.Popen([sys.executable, "-c", BURN]) for _ in range(count)]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


def latencies_ms(chunks: list[tuple[str, int, bytes]], sent_ns: list[Any]) -> list[float]:
    """Per frame: recorded minus sent, millisecond; a frame is recorded with the chunk that holds its last byte."""
    found = []
    for port, stamps in zip(PORTS, sent_ns, strict=True):
        length, received = load_frame(FRAMES / "ngu_a.yaml").layout.max_length, 0
        for _, recorded_ns, chunk in (item for item in chunks if item[0] == port):
            complete = range(received // length, (received + len(chunk)) // length)
            found += [(recorded_ns - stamps[frame]) / 1e6 for frame in complete]
            received += len(chunk)
    return found


def show(way: Acquire, piece: int, busy: int) -> None:
    """One line of the table."""
    found, share = measure(way, piece, busy)
    p50, p99 = np.percentile(found, (50, 99))
    sys.stdout.write(
        f"{busy} busy processes, pieces of {piece} bytes at most: to the record p50 {p50:.2f} ms, p99 {p99:.2f} ms, "
        f"max {max(found):.2f} ms; {100 * share:.2f} % of a core; {len(found)} frames\n"
    )


def main() -> None:
    """Print the table. Of the pieces only the CPU time says something: in them the tail is that of the kernel's worker
    which carries bytes through a pseudo-terminal."""
    for piece, busy in ((1000, BURNERS), (1000, 0), (PIECE_BYTES, 0)):
        show(acquire, piece, busy)


if __name__ == "__main__":
    main()
