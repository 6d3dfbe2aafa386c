"""A small plan and manifest for tests of the feed: prompt, point, soak, point, and an ending."""

from __future__ import annotations

from typing import Any

from planned_step import planned

from bench.plan import Step

START_S = 1_000_000.0
MANIFEST: dict[str, Any] = {
    "session": "20200101T000000Z_small_7", "sequence": "small", "title": "Small", "simulated": True, "clock": "wall",
    "station": "desk", "campaign": {"uut": {"model": "NGU", "serial": "7"}},
    "identities": {"source": {"manufacturer": "FLUKE", "model": "5720A", "serial": "1", "firmware": "A"}},
}  # fmt: skip
_POINT = {"retry_step": 3, "seconds": 10.0, "retry": 1}
_SOAK = {"temperature": 50.0, "ramp": 1.0, "within": 1.0, "for": 60.0, "late": "hold", "hold_limit": 600.0}


def small_plan() -> tuple[Step, ...]:
    """Steps 0 to 8; planned: prepare 5 s, campaign 1,030 s, finally 100 s."""
    rows: list[tuple[Any, ...]] = [
        ("prepare", "prompt", 0.0, 0.0, "", "", {}, {"text": "door closed?"}),
        ("prepare", "settle", 0.0, 5.0, "", "", {}, {}),
        ("campaign", "soak", 0.0, 1000.0, "chamber", "soak", {"temperature_degC": 50.0}, _SOAK),
        ("campaign", "call", 1000.0, 0.0, "source", "operate", {"channel": 1}, {}),
        ("campaign", "settle", 1000.0, 20.0, "", "", {"channel": 1}, {}),
        ("campaign", "record", 1020.0, 10.0, "port_a", "", {"channel": 1, "current_A": 0.01, "polarity": -1}, _POINT),
        ("campaign", "verify", 1030.0, 0.0, "source", "operating", {"channel": 1}, {}),
        ("finally", "soak", 0.0, 100.0, "chamber", "soak", {}, {**_SOAK, "temperature": 23.0, "late": "skip"}),
        ("finally", "call", 100.0, 0.0, "source", "standby", {}, {}),
    ]
    keys = ("at_s", "duration_s", "role", "name", "conditions", "where")
    return tuple(
        planned(kind, at, phase=phase, **dict(zip(keys, (*row, f"small.yaml:{at + 1}:1"), strict=True)), **arguments)
        for at, (phase, kind, *row, arguments) in enumerate(rows)
    )
