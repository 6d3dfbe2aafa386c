"""A run as the terminal view meets it: state documents by docs/live-protocol.md, and a feed that serves them."""

import socket
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from plan_sample import planned
from shown_run import first_state as shown_state
from shown_run import packed, serve

from bench.plan import Step

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


NAMES = tuple(f"port_a.npp[{index + 1}]" for index in range(20))
T0 = 946_684_800.0


def first_state(names: tuple[str, ...] = NAMES) -> dict[str, Any]:
    """A state document with every key, of a run that begins."""
    soak = {"number": 1, "of": 9, "phase": "campaign", "kind": "soak", "what": "soak", "conditions": {"channel": 1}}
    return shown_state("r") | {
        "title": "t", "sequence": "s", "station": "b", "uut": {"model": "NGU", "serial": "1"}, "t_utc_s": T0,
        "started_utc_s": T0, "step": {**soak, "where": "s.yaml:3:1", "since_utc_s": T0, "until_utc_s": T0 + 60},
        "wait": None, "progress": 0.1, "eta": None,
        "records": {"done": 3, "planned": 9, "retaken": 0, "flagged": 0, "last": []},
        "links": {"port_a": {"state": "open", "frames": 10}}, "instruments": {},
        "log": [{"t_utc_s": T0, "kind": "phase", "text": "campaign"}] * 50,
        "signals": [{"name": name, "unit": "1", "decimals": 0} for name in names], "graphs": [],
        "timetable": {"t_utc_s": [T0, T0 + 60], "temperature_degC": [23.0, 50.0]},
    }  # fmt: skip


class FeedStandIn:
    """Serves the feed of a folder. Point k has time T0 + k / 10 and in column c the pair (k + c, k + c + 1)."""

    def __init__(self, folder: Path) -> None:
        self.state = first_state()
        self.made = 0  # points so far
        self.asked: list[dict[str, Any]] = []
        self._open: list[socket.socket] = []
        self._place = TemporaryDirectory()  # the folders of tests are too deep for the path of a socket
        self.pointer = folder / "live.path"
        self.path = Path(self._place.name) / "live.sock"
        self.pointer.write_text(str(self.path))
        self._server = serve(self.path, self.reply, self._open.append)

    def reply(self, request: dict[str, Any]) -> bytes:
        self.asked.append(request)
        since = request["since"] if request["since"] <= self.made else 0
        first = max(since, self.made - 600)
        count = np.arange(first, self.made)
        low = (count[:, None] + np.arange(len(self.state["signals"]))[None, :]).astype("<f4")
        header = {"boot_id": self.state["boot_id"], "seq": self.made, "first": first}
        if request.get("state"):
            header["state"] = self.state
        return packed(header, T0 + count / 10, low, low + 1)

    def close(self) -> None:
        """Nobody answers any more; whoever is connected is answered by nobody either."""
        if self._server is not None:
            self._server.shutdown()
            self._server.server_close()
            self._server = None
            self._cut()
            self.pointer.unlink()
            self._place.cleanup()

    def _cut(self) -> None:
        while self._open:
            with suppress(OSError):
                self._open.pop().shutdown(socket.SHUT_RDWR)


PLAN_START_S = 1_000_000.0
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
