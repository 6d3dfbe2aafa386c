"""Cost of recording and replay, side by side in one run: CPU time on a synthetic session of the campaign's shape.

Run: python -m benchmarks.replay [HOURS]. Two links, a chunk a second, a record of 100 s every 179 s. Compared with a
bare pass of the stock MCAP reader over the same files (no CRC checks, nothing decoded), where ``mcap`` is installed.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any

import numpy as np

from bench.frame import load_frame
from bench.record import Journal, SessionReader, SessionWriter
from bench.replay import replay_rows

FRAMES = Path(__file__).resolve().parent.parent / "frames"
SEED = 20240501
NS = 1_000_000_000
HOURS = 6.0
CAMPAIGN_S = 136_800
RECORD_EVERY_S = 179
BLOCK_S = 600
LINKS = {"port_a": "ngu_a", "port_b": "ngu_b"}


def seconds_of_bytes(begin: int, count: int) -> tuple[list[bytes], list[bytes]]:
    """Both links from second ``begin`` on, with pulse counts of a mid-range current."""
    generator = np.random.default_rng((SEED, begin))
    frames = count * 100
    columns: dict[str, Any] = {
        "counter": np.arange(begin * 100, begin * 100 + frames) % 65536,
        "npp": 24 + generator.integers(0, 2, (frames, 10)),
        "ppp": generator.integers(0, 2, (frames, 10)),
        "af_clock": 2560 + generator.integers(-1, 2, frames),
        "master_count": 100_000,
        "fg_count": 100_000 + generator.integers(-1, 2, frames),
        "status": 0,
    }
    port_a = load_frame(FRAMES / "ngu_a.yaml").encode(columns, frames)
    slow = count * 10
    house: dict[str, Any] = {
        "counter": np.arange(begin * 10, begin * 10 + slow) % 65536,
        "unit_temperature": 2000 + generator.integers(-3, 4, (slow, 4)),
        "supply_voltage": 28_000,
        "supply_current": 1_800,
        "rails": np.tile([5_000, 15_000, 15_000], (slow, 1)),
        "status": 1,
    }
    port_b = load_frame(FRAMES / "ngu_b.yaml").encode(house, slow, "housekeeping")
    fast, calm = port_a.reshape(count, -1), port_b.reshape(count, -1)
    return [row.tobytes() for row in fast], [row.tobytes() for row in calm]


def write_session(folder: Path, seconds: int) -> float:
    """Write a session of ``seconds``; returns the CPU seconds of the writer alone."""
    texts = {f"frames/{name}.yaml": (FRAMES / f"{name}.yaml").read_text(encoding="utf-8") for name in LINKS.values()}
    links = {link: f"frames/{name}.yaml" for link, name in LINKS.items()}
    writer = SessionWriter.create(folder, {"links": links, "measurement_link": "port_a"}, texts, t_mono_ns=0)
    spent = 0.0
    for begin in range(0, seconds, BLOCK_S):
        port_a, port_b = seconds_of_bytes(begin, min(BLOCK_S, seconds - begin))
        start = process_time()
        for offset, (fast, calm) in enumerate(zip(port_a, port_b, strict=True)):
            second = begin + offset + 1
            writer.raw("port_b", "rx", second * NS, calm)
            writer.raw("port_a", "rx", second * NS, fast)
            if second % RECORD_EVERY_S == 0:
                writer.event("record", second * NS, record_fields(second))
            writer.tick(second * NS)
        spent += process_time() - start
    start = process_time()
    writer.close("done")
    return spent + process_time() - start


def record_fields(second: int) -> dict[str, Any]:
    """Record of the last 100 s."""
    return {
        "number": second // RECORD_EVERY_S,
        "link": "port_a",
        "first_counter": (second - 100) * 100,
        "frames": 10_000,
        "t_start_ns": (second - 100) * NS,
        "t_end_ns": second * NS,
        "conditions": {"channel": 1, "kind": "gyro", "current_A": 1e-3, "polarity": 1},
        "step": second,
    }


def stock_pass(folder: Path) -> int:
    """Every message through the stock reader, nothing done with it."""
    from mcap.reader import make_reader

    count = 0
    for path in sorted(folder.glob("*.mcap")):
        with path.open("rb") as stream:
            for _ in make_reader(stream).iter_messages():
                count += 1
    return count


def timed(work: Callable[[], Any]) -> tuple[float, Any]:
    """CPU seconds and the result."""
    start = process_time()
    result = work()
    return process_time() - start, result


def journal_cost(folder: Path, steps: int = 20_000) -> float:
    """CPU seconds of one flushed journal line."""
    journal = Journal(folder)
    conditions = {"channel": 3, "kind": "gyro", "temperature_degC": -10.0, "current_A": 1e-3, "polarity": 1}
    start = process_time()
    for number in range(steps):
        journal.step(number, "campaign", number * NS, conditions)
    spent = process_time() - start
    journal.close()
    return spent / steps


def main() -> None:
    """Print the table."""
    hours = float(sys.argv[1]) if len(sys.argv) > 1 else HOURS
    seconds = round(hours * 3600)
    with TemporaryDirectory() as place:
        folder = Path(place) / "session"
        write_s = write_session(folder, seconds)
        size = sum(path.stat().st_size for path in folder.glob("*.mcap"))
        replay_s, done = timed(lambda: replay_rows(folder, strict=True))
        walk_s, messages = timed(lambda: sum(1 for _ in SessionReader(folder).messages()))
        lines = [
            f"{hours:g} h, {done.totals['frames']} frames in {len(done.rows)} records, {messages} messages, "
            f"{size / 1e6:.0f} MB, seed {SEED}",
            f"{'':34s}{'CPU s':>8s}{'us per s':>10s}{'38 h, s':>9s}",
        ]
        costs = {"write (lz4, CRCs, hash chain)": write_s, "verified walk": walk_s, "replay (with decoding)": replay_s}
        try:
            costs["stock MCAP reader, bare pass"], found = timed(lambda: stock_pass(folder))
        except ImportError:
            found = 0
        if found and found != messages:
            raise SystemExit(f"the stock reader found {found} messages")
        for name, spent in costs.items():
            lines.append(f"{name:34s}{spent:8.2f}{1e6 * spent / seconds:10.1f}{spent * CAMPAIGN_S / seconds:9.2f}")
        if found:
            lines.append(
                f"replay / bare stock pass: {replay_s / costs['stock MCAP reader, bare pass']:.2f} (limit 0.5)"
            )
        lines.append(f"journal: {1e6 * journal_cost(Path(place)):.1f} us per step")
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
