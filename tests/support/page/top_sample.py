"""A run as the terminal view meets it: state documents by docs/live-protocol.md, and a feed that serves them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

START_S = 1_795_000_000.0  # 2026-11-18T11:06:40Z
NOW_S = START_S + 3600.0
SIGNALS = ["port_a.npp[1]", "bench.air", "bench.unit"]


LINKS = {
            "port_a": {"state": "open", "reason": "", "frames": 4120000, "bad": 0, "lost": 0, "duplicate": 0,
                       "rate_Hz": 100.0, "age_s": 0.1},
            "port_b": {"state": "lost", "reason": "adapter pulled", "frames": 99, "bad": 3, "lost": 7, "duplicate": 0,
                       "rate_Hz": 0.0, "age_s": 61.0},
        }  # fmt: skip
INSTRUMENTS = {
            "calibrator": {"driver": "fluke_5720a", "resource": "GPIB0::4::INSTR", "identity": "FLUKE,5720A",
                           "command": "OUT?", "reply": "1.0E-02,A", "t_utc_s": NOW_S - 2, "answer_ms": 41.0,
                           "error": None, "errors": 0, "state": "ok"},
            "switch": {"driver": "keithley_7002", "resource": "GPIB0::7::INSTR", "identity": "KEITHLEY",
                       "command": "CLOS?", "reply": "", "t_utc_s": NOW_S - 90, "answer_ms": None,
                       "error": "-410,Query interrupted", "errors": 2, "state": "error"},
        }  # fmt: skip


def document(**changes: Any) -> dict[str, Any]:
    """Every key of a state document: a soak of a scale-factor campaign, one hour after its beginning."""
    step = {
        "number": 4123, "of": 9170, "phase": "campaign", "kind": "soak",
        "what": "soak 50 degC", "conditions": {"temperature_degC": 50},
        "where": "scale_factor_38h.yaml:120", "since_utc_s": NOW_S - 760, "until_utc_s": NOW_S + 1040,
    }  # fmt: skip
    wait = {
        "reason": "soak 50 degC", "since_utc_s": NOW_S - 760, "until_utc_s": NOW_S + 1040,
        "last": "48.2 degC, +0.4 degC/min",
    }  # fmt: skip
    record = {
        "number": 412, "t_utc_s": NOW_S - 800,
        "conditions": {"channel": 3, "temperature_degC": 50.0, "current_A": 0.01},
        "frames": 10000, "lost": 0, "bad": 0, "flags": [],
    }  # fmt: skip
    found = {
        "proto": 1, "run": "20261118T110640Z_scale_factor_38h_17", "boot_id": "00112233aabbccdd",
        "title": "Scale factor, 38 h", "sequence": "scale_factor_38h", "station": "af_bench",
        "uut": {"model": "NGU", "serial": "17"}, "simulated": False, "clock": "wall", "source": "live",
        "state": "running", "outcome": None, "t_utc_s": NOW_S, "started_utc_s": START_S, "step": step, "wait": wait,
        "progress": 0.38,
        "eta": {"earliest_utc_s": NOW_S + 83000, "likely_utc_s": NOW_S + 84000, "latest_utc_s": NOW_S + 86000},
        "holds": {}, "prompt": None,
        "records": {"done": 412, "planned": 765, "retaken": 1, "flagged": 0, "last": [record]},
        "links": LINKS,
        "instruments": INSTRUMENTS,
        "alarms": [],
        "log": [{"t_utc_s": NOW_S - 1.5, "kind": "phase", "text": "campaign"}],
        "signals": [{"name": name, "unit": "degC", "decimals": 2} for name in SIGNALS],
        "graphs": [], "timetable": {"t_utc_s": [START_S, NOW_S + 3600], "temperature_degC": [20.0, 60.0]},
    }  # fmt: skip
    return found | changes


ALARM = {
    "id": "a1", "severity": "warning", "code": "B-RUN-024", "t_utc_s": NOW_S - 61, "text": "port_b: adapter pulled",
    "active": True, "acknowledged": None,
}  # fmt: skip
SEEN_AND_OVER = {
    **ALARM,
    "id": "a2",
    "text": "long gone",
    "active": False,
    "acknowledged": {"by": "kim", "t_utc_s": NOW_S},
}
PROMPT = {
    "id": "p1", "text": "Bridge resistance?", "confirm": "", "unit": "ohm", "low": 99.0, "high": 101.0,
    "since_utc_s": NOW_S,
}  # fmt: skip


ESTIMATES = {
    "records": 412, "t_utc_s": NOW_S, "doubt": [],
    "rows": [
        {"quantity": quantity, "titles": {"en": title}, "unit": unit, "conditions": {"channel": channel},
         "value": value, "expanded_uncertainty": U, "expected_uncertainty": at_end, "predicted_uncertainty": predicted}
        for quantity, title, unit, channel, value, U, at_end, predicted in (
            ("dsf_n", "Scale-factor error N", "ppm", 1, 412.3, 22.14, 22.31, 22.27),
            ("dsf_n", "Scale-factor error N", "ppm", 2, None, None, 22.26, 22.26),
            ("bias", "Bias", "A", 1, 3.6e-7, 1.003e-8, 1.003e-8, 1.0e-8),
        )
    ],
}  # fmt: skip


@dataclass
class Reply:
    """What a feed answers."""

    header: Mapping[str, Any]
    t_utc_s: NDArray[np.float64]
    low: NDArray[np.float32]
    high: NDArray[np.float32]


class Gone(Exception):
    """Nobody answers."""


@dataclass
class FakeFeed:
    """Serves one document, and an hour of temperatures that rise by 10 degC, until it is told to be silent."""

    document: dict[str, Any]
    silent: bool = False
    asked: list[int] = field(default_factory=list)

    def poll(self, since: int, state: bool = True) -> Reply:
        self.asked.append(since)
        if self.silent:
            raise Gone
        seq = 360
        t_utc_s = NOW_S - 3600 + 10.0 * np.arange(min(since, seq), seq)
        unit = 38.2 + 10.0 * (t_utc_s - NOW_S + 3600) / 3600
        low = np.stack([np.zeros_like(unit), unit + 1, unit], axis=1).astype(np.float32)
        low[1::2, 1:] = np.nan  # temperatures come seldom
        header = {
            "proto": 1, "boot_id": self.document["boot_id"], "seq": seq, "first": since, "n": len(t_utc_s),
            "signals": len(SIGNALS), "state": self.document if state else None,
        }  # fmt: skip
        return Reply(header, t_utc_s, low, low.copy())


class SetClock:
    """A clock that shows what it is set to."""

    virtual = False

    def __init__(self) -> None:
        self.s = 0.0

    def now_ns(self) -> int:
        return round(self.s * 1e9)
