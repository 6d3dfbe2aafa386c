"""A session of two parts for the tests of tables: frames of the AF converter, a resume between them, readings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from record_sample import NS, ROOT, frame

from bench.model.events import Reading, Record, Resume
from bench.record import SessionWriter, resume_session

UTC_NS = 946_684_800 * NS
AWAY_S = 1000.0
FRAMES = 250  # of each part, 100 a second


def counted(first: int, n: int = FRAMES) -> bytes:
    """Return frames whose counter runs on from ``first`` and whose P counts of channel 1 are the counter modulo 100."""
    number = np.arange(first, first + n)
    columns = {"counter": number, "npp": np.zeros((n, 10), np.int64), "ppp": np.tile(number[:, None] % 100, 10),
               "af_clock": np.full(n, 2560), "master_count": np.full(n, 100_000),
               "fg_count": np.full(n, 100_000), "status": np.zeros(n, np.int64)}  # fmt: skip
    return frame("ngu_a").encode(columns, n).tobytes()


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
        text = (ROOT / "tests" / "golden" / f"ublox_sensors.{name}.hex").read_text()
        writer.raw("sensors", "rx", start_ns + 5 * NS // 2, bytes.fromhex(text))
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
