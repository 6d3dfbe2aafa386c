"""Small files of records: sessions and disks for them, streams of frames whole or damaged, tables, captures."""

import errno
import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.frame import Counted, Engine, FrameDefinition, MessageBatch, decode_capture, load_frame
from bench.model.events import Reading, Record, Resume
from bench.record import SessionWriter, resume_session
from bench.record.layout import AppendFile, OsFiles

NS = 1_000_000_000
ROOT = Path(__file__).resolve().parents[2]
MANIFEST = {"schema": 1, "session": "sample", "links": {"port_a": "frames/ngu_a.yaml"}, "measurement_link": "port_a"}
TEXTS = {"sequences/x.yaml": "sequence: x\n", "frames/ngu_a.yaml": "frame: ngu_a\n", "plan.json": "[]"}

RATE_HZ = 100
AF_CLOCK = 2560
MASTER = 100_000
FRAME_NS = NS // RATE_HZ
UTC_NS = 946_684_800 * NS
AWAY_S = 1000.0
FRAMES = 250  # of each part of a table sample, 100 a second
Fault = Callable[[str, int], OSError | int | None]


@cache
def frame(name: str) -> FrameDefinition:
    """Return a shipped definition; nothing in it changes, so all tests share one."""
    return load_frame(ROOT / "frames" / f"{name}.yaml")


def golden_bytes(name: str) -> bytes:
    """Return the bytes of a file in tests/golden."""
    return bytes.fromhex((ROOT / "tests" / "golden" / f"{name}.hex").read_text(encoding="ascii"))


def write_sample(folder: Path, seconds: int = 20, seed: int = 1, files: OsFiles | None = None) -> list[bytes]:
    """A closed session of ``seconds`` chunks; returns the raw bytes given, in order."""
    rng = np.random.default_rng(seed)
    writer = SessionWriter.create(folder, MANIFEST, TEXTS, t_mono_ns=0, files=files)
    writer.clock_pair(0, UTC_NS)
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

    def __init__(self, inner: AppendFile, disk: "FaultyFiles") -> None:
        self._inner = inner
        self._disk = disk

    def write(self, chunk: bytes) -> int:
        short = self._disk.next_fault("write")
        return self._inner.write(chunk if short is None else chunk[: min(short, len(chunk))])

    def truncate(self, size: int) -> None:
        self._disk.next_fault("truncate")
        self._inner.truncate(size)

    def sync(self) -> None:
        self._disk.next_fault("sync")
        self._inner.sync()

    def close(self) -> None:
        self._inner.close()


class FaultyFiles(OsFiles):
    """A disk whose calls fail when ``fault(kind, n)`` says so; kinds are create, write, truncate, sync; n from 1."""

    def __init__(self, fault: Fault) -> None:
        self.fault = fault
        self.calls: dict[str, int] = {}

    def next_fault(self, kind: str) -> int | None:
        """Return the bytes that a call may write, None for all of them. Raises: OSError if it shall fail."""
        self.calls[kind] = self.calls.get(kind, 0) + 1
        fault = self.fault(kind, self.calls[kind])
        if isinstance(fault, OSError):
            raise fault
        return fault

    def create(self, path: Path) -> AppendFile:
        self.next_fault("create")
        return FaultyFile(super().create(path), self)

    def append(self, path: Path) -> AppendFile:
        return FaultyFile(super().append(path), self)


def no_space() -> OSError:
    return OSError(errno.ENOSPC, "No space left on device")


def io_error() -> OSError:
    return OSError(errno.EIO, "Input/output error")


@dataclass
class Stream:
    """Frames of a link: ``counter`` unwrapped, ``columns`` as encoded, ``frames`` (n, 57) bytes."""

    counter: NDArray[np.int64]
    columns: dict[str, NDArray[np.int64]]
    frames: NDArray[np.uint8]

    def expected(self, name: str, keep: NDArray[np.bool_] | list[int] | slice) -> list[int]:
        """Sums by plain Python integers."""
        picked = self.columns[name][keep]
        if picked.ndim == 1:
            return [sum(int(value) for value in picked)]
        return [sum(int(value) for value in picked[:, k]) for k in range(picked.shape[1])]


def stream(count: int, seed: int = 1, first_counter: int = 0) -> Stream:
    """``count`` frames whose counts are random but possible."""
    rng = np.random.default_rng(seed)
    counter = np.arange(first_counter, first_counter + count, dtype=np.int64)
    columns = {
        "counter": counter % 65536,
        "npp": rng.integers(0, 1200, (count, 10)),
        "ppp": rng.integers(0, 1200, (count, 10)),
        "af_clock": AF_CLOCK + rng.integers(-1, 2, count),
        "master_count": np.full(count, MASTER),
        "fg_count": MASTER + rng.integers(-1, 2, count),
        "status": np.zeros(count, np.int64),
    }
    return Stream(counter, columns, frame("ngu_a").encode(columns, count))


def constant_stream(npp: NDArray[np.int64], ppp: NDArray[np.int64], first_counter: int = 0) -> Stream:
    """Frames with the given pulse counts (n, 10)."""
    count = len(npp)
    made = stream(count, first_counter=first_counter)
    made.columns |= {"npp": npp, "ppp": ppp, "af_clock": np.full(count, AF_CLOCK), "fg_count": np.full(count, MASTER)}
    made.frames = frame("ngu_a").encode(made.columns, count)
    return made


def chunks_of(raw: bytes, rng: np.random.Generator, low: int = 1, high: int = 700) -> list[bytes]:
    """The bytes cut at random places."""
    cut, at = [], 0
    while at < len(raw):
        size = int(rng.integers(low, high + 1))
        cut.append(raw[at : at + size])
        at += size
    return cut


def housekeeping(count: int, first: int = 0, temperature_degC: float = 20.0) -> bytes:
    """``count`` housekeeping frames of port B; the four sensors read the temperature, +0.01 per frame and sensor."""
    raw = np.round(temperature_degC * 100).astype(int) + np.arange(count)[:, None] + np.arange(4)[None, :]
    columns = {
        "counter": (first + np.arange(count)) % 65536, "unit_temperature": raw, "supply_voltage": 28000,
        "supply_current": 1800, "rails": np.tile([5000, 15000, 15000], (count, 1)), "status": 1,
    }  # fmt: skip
    return frame("ngu_b").encode(columns, count, "housekeeping").tobytes()


def captured(
    definition: FrameDefinition, path: Path, engine: Engine | None = None
) -> tuple[Counted, dict[str, MessageBatch]]:
    """Return counts and frames of each message of a whole capture, as no command keeps it."""
    parts: dict[str, list[MessageBatch]] = {name: [] for name in definition.messages}

    def keep(found: Mapping[str, MessageBatch]) -> None:
        for name, batch in found.items():
            parts[name].append(batch)

    with path.open("rb") as stream:
        counts = decode_capture(definition, stream, keep, engine)
    return counts, {name: MessageBatch.join(batches) for name, batches in parts.items()}


def counted(first: int, n: int = FRAMES) -> bytes:
    """Return frames whose counter runs on from ``first`` and whose P counts of channel 1 are the counter modulo 100."""
    number = np.arange(first, first + n)
    return constant_stream(np.zeros((n, 10), np.int64), np.tile(number[:, None] % 100, 10), first).frames.tobytes()


def sensors() -> str:
    """Return a definition with a group of four at most and an optional part: two messages of ``ublox_sensors``."""
    text = frame("ublox_sensors").text
    head, _, rest = text.partition("  satellites:")
    return head.replace("max: 31", "max: 4") + rest[rest.index("crc:") :]


def write_resumed(folder: Path, away_s: float = AWAY_S) -> None:
    """Two parts of 2.5 s of frames; UTC of the second one is ``away_s`` later than its monotonic time says."""
    manifest: dict[str, Any] = {
        "schema": 1, "session": "resumed", "simulated": True, "plan_sha256": "p", "measurement_link": "port_a",
        "links": {"port_a": "frames/ngu_a.yaml", "sensors": "frames/sensors.yaml"},
        "campaign": {"analysis": "none"},
    }  # fmt: skip
    texts = {"frames/ngu_a.yaml": frame("ngu_a").text, "frames/sensors.yaml": sensors(), "plan.json": "[]"}
    _fill(SessionWriter.create(folder, manifest, texts, t_mono_ns=0), 1, UTC_NS)
    later = resume_session(folder, Resume(reason="power"), t_mono_ns=5 * NS)
    _fill(later, 2, UTC_NS + round(away_s * NS), start_ns=5 * NS)


def _fill(writer: SessionWriter, number: int, utc_at_0_ns: int, start_ns: int = 0) -> None:
    raw = counted(1)
    writer.clock_pair(start_ns, utc_at_0_ns + start_ns)
    for chunk in range(5):
        t_ns = start_ns + (chunk + 1) * NS // 2
        length = len(raw) // 5
        writer.raw("port_a", "rx", t_ns, raw[chunk * length : (chunk + 1) * length])
        writer.tick(t_ns)
    for name in ("attitude", "measurements"):  # groups and optional parts
        writer.raw("sensors", "rx", start_ns + 5 * NS // 2, golden_bytes(f"ublox_sensors.{name}"))
    end_ns = start_ns + 2 * NS
    record = Record(number=number, link="port_a", first_counter=51, frames=100, t_start_ns=start_ns + NS // 2,
                    t_end_ns=start_ns + 3 * NS // 2, conditions={"channel": number, "frames": "a word"})  # fmt: skip
    readings = [
        Reading(step=1, role="dmm", name="measure_current", value=0.01 * number, conditions={"range_A": 0.1}),
        Reading(step=2, role="lock_in_1", name="measure", value={"x_V": 0.5, "overload": False}, conditions={}),
        Reading(
            step=3, role="dmm", name="measure_current", value=None, conditions={}, quality=16, code="B-X", text="y"
        ),
    ]
    for event in (record, *readings):
        writer.event(event.kind, end_ns + NS // 2, event.document())
    writer.close("done")
