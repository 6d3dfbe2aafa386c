"""Sessions and disks for the tests of record and replay."""

from __future__ import annotations

import errno
import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from bench.frame import FrameDefinition, load_frame
from bench.record import SessionWriter
from bench.record.files import AppendFile, OsFiles

NS = 1_000_000_000
ROOT = Path(__file__).resolve().parents[2]
MANIFEST = {"schema": 1, "session": "sample", "links": {"port_a": "frames/ngu_a.yaml"}, "measurement_link": "port_a"}
TEXTS = {"sequences/x.yaml": "sequence: x\n", "frames/ngu_a.yaml": "frame: ngu_a\n", "plan.json": "[]"}

Fault = Callable[[str, int], OSError | int | None]


@cache
def frame(name: str) -> FrameDefinition:
    """Return a shipped definition; nothing in it changes, so all tests share one."""
    return load_frame(ROOT / "frames" / f"{name}.yaml")


def write_sample(folder: Path, seconds: int = 20, seed: int = 1, files: OsFiles | None = None) -> list[bytes]:
    """A closed session of ``seconds`` chunks; returns the raw bytes given, in order."""
    rng = np.random.default_rng(seed)
    writer = SessionWriter.create(folder, MANIFEST, TEXTS, t_mono_ns=0, files=files)
    writer.clock_pair(0, 946_684_800 * NS)
    given = []
    for second in range(1, seconds + 1):
        t_ns = second * NS
        chunk = rng.integers(0, 30, 600, dtype=np.uint8).tobytes()
        given.append(chunk)
        writer.raw("port_a", "rx", t_ns, chunk)
        writer.command("dmm", "tx", f"READ? {second}", t_ns)
        if second % 5 == 0:
            writer.event("step", t_ns, {"number": second, "temperature_degC": float("nan"), "counts": np.arange(3)})
        writer.tick(t_ns)
    writer.close("done")
    return given


def digest(folder: Path) -> str:
    """SHA-256 over the names and bytes of all segments."""
    total = hashlib.sha256()
    for path in sorted(folder.glob("*.mcap")):
        total.update(path.name.encode() + path.read_bytes())
    return total.hexdigest()


class FaultyFile:
    """Passes on to a real file; asks first whether call ``n`` of a kind shall fail or be short."""

    def __init__(self, inner: AppendFile, disk: FaultyFiles) -> None:
        self._inner = inner
        self._disk = disk

    def write(self, chunk: bytes) -> int:
        fault = self._disk.next_fault("write")
        if isinstance(fault, int):
            return self._inner.write(chunk[: min(fault, len(chunk))])
        if fault is not None:
            raise fault
        return self._inner.write(chunk)

    def truncate(self, size: int) -> None:
        fault = self._disk.next_fault("truncate")
        if isinstance(fault, OSError):
            raise fault
        self._inner.truncate(size)

    def sync(self) -> None:
        fault = self._disk.next_fault("sync")
        if isinstance(fault, OSError):
            raise fault
        self._inner.sync()

    def close(self) -> None:
        self._inner.close()


class FaultyFiles(OsFiles):
    """A disk whose calls fail when ``fault(kind, n)`` says so; kinds are create, write, truncate, sync; n from 1."""

    def __init__(self, fault: Fault) -> None:
        self.fault = fault
        self.calls: dict[str, int] = {}

    def next_fault(self, kind: str) -> OSError | int | None:
        self.calls[kind] = self.calls.get(kind, 0) + 1
        return self.fault(kind, self.calls[kind])

    def create(self, path: Path) -> AppendFile:
        fault = self.next_fault("create")
        if isinstance(fault, OSError):
            raise fault
        return FaultyFile(super().create(path), self)

    def append(self, path: Path) -> AppendFile:
        return FaultyFile(super().append(path), self)


def no_space() -> OSError:
    return OSError(errno.ENOSPC, "No space left on device")


def io_error() -> OSError:
    return OSError(errno.EIO, "Input/output error")
