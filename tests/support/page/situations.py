"""Situations as people meet them: runs that live, and sessions that are over; staged in the folder of a page server."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rehearsal import writable_copy
from report_sample import unsound
from shown_run import ShownRun, now_utc_s

from bench.record import OPEN_MARKER
from bench.run.feed.outputs import Outputs

PLACES = {
    "calibrator": ("fluke_5720a", "GPIB0::4::INSTR"), "switch": ("keithley_7002", "GPIB0::7::INSTR"),
    "supply": ("hp_6632b", "GPIB0::5::INSTR"), "chamber": ("thermotron_3800", "GPIB0::1::INSTR"),
}  # fmt: skip
QUIET = {"calibrator": {"ISR?": "0"}, "switch": {":CLOS:STAT?": "(@)"}}
DRIVEN = {"calibrator": {"ISR?": "4097", "OUT?": "2.0E-02,A,0E+00"}, "switch": {":CLOS:STAT?": "(@1!1!3)"}}
WARM = {
    "supply": {"OUTP?": "1", "MEAS:VOLT?": "18.0", "MEAS:CURR?": "1.25"},
    "chamber": {"MODE?": "16", "SETP1?": "55.0", "PVAR1?": "54.8"},
}
PORT = "port_a: no byte for 30 s"


@dataclass(frozen=True)
class Situation:
    """One that lives. ``word`` and ``attention`` are what every view says; ``says``: words that must stand there."""

    word: str
    attention: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    says: tuple[str, ...] = ()
    replies: Mapping[str, Mapping[str, str]] = field(default_factory=lambda: {**QUIET, **WARM})
    unconfirmed: Mapping[str, str] = field(default_factory=dict)


def alarm(text: str, code: str | None = None) -> dict[str, Any]:
    return {"id": text, "severity": "alarm", "code": code, "t_utc_s": now_utc_s(), "text": text, "active": True,
            "acknowledged": None}  # fmt: skip


def held(by: str, reason: str) -> dict[str, Any]:
    wait = {"reason": reason, "since_utc_s": now_utc_s() - 100, "until_utc_s": None, "last": None}
    return {"state": "holding", "holds": {by: reason}, "wait": wait}


QUESTION = {
    "id": "1", "text": "Connect the unit to channel 3 of the matrix.", "confirm": "technician", "unit": None,
    "low": None, "high": None, "since_utc_s": 0.0,
}  # fmt: skip
LIVING = {
    "running": Situation("RUNNING", "none", says=("calibrator", "20 mA"), replies={**DRIVEN, **WARM}),
    "soak": Situation("RUNNING", "none", says=("soak 55", "18 V, 1.25 A")),
    "prompt": Situation("WAITING FOR A PERSON", "some", {"state": "waiting", "prompt": QUESTION}, (QUESTION["text"],)),
    "port": Situation("HOLDING", "much", {**held("link port_a", PORT), "alarms": [alarm(PORT, "B-LINK-003")]}, (PORT,)),
    "instrument": Situation("HOLDING", "some", held("instrument dmm", "dmm: no answer"), ("dmm: no answer",)),
    "mute": Situation("HOLDING", "much", held("instrument calibrator", "calibrator: no answer"),
                      ("NOT confirmed off: calibrator (B-INST-001)",), unconfirmed={"calibrator": "B-INST-001"}),
    "runaway": Situation("RUNNING", "much", {"alarms": [alarm("air 61.2 degC runs away")]}, ("runs away",)),
    "door": Situation("HOLDING", "much", {**held("interlock door", "door is open"), "alarms": [alarm("door is open")]},
                      ("door is open",)),
}  # fmt: skip
OVER = {"pass": "PASS", "fail": "FAIL", "doubtful": "DOUBTFUL", "damaged": "DAMAGED", "guard": "FAULT"}


def bench_of(replies: Mapping[str, Mapping[str, str]], unconfirmed: Mapping[str, str] | None = None) -> dict[str, Any]:
    """The state of the bench as the run's own reducer makes it of replies of now."""
    outputs, now = Outputs(PLACES, 150.0), now_utc_s()
    for role, told in replies.items():
        for question, reply in told.items():
            outputs.on_traffic(role, "tx", question, now - 12.0)
            outputs.on_traffic(role, "rx", reply, now - 12.0)
    return outputs.document(now, unconfirmed=unconfirmed)


def state_of(situation: Situation) -> dict[str, Any]:
    return {
        "attention": situation.attention,
        "bench": bench_of(situation.replies, situation.unconfirmed),
        **situation.changes,
    }


def stage_living(out: Path) -> dict[str, ShownRun]:
    """Every situation of a run that lives, by name; whoever stages them closes them."""
    runs = {}
    for number, (name, situation) in enumerate(LIVING.items()):
        runs[name] = ShownRun(out, f"20260301T00000{number}Z_{name}_7")
        runs[name].state.update(state_of(situation))
    return runs


def stage_over(out: Path, recorded: Path) -> dict[str, str]:
    """A recording, five times: its results judged, its end cut off, and left open by a run that its guard ended."""
    names = {what: f"20260302T00000{number}Z_{what}_7" for number, what in enumerate(OVER)}
    for what, name in names.items():
        folder = writable_copy(recorded, out / name)
        results = json.loads((folder / "results.json").read_text())
        for estimate in results["estimates"]:
            estimate |= {"verdict": "fail" if what == "fail" else "pass", "limit": 1.0}
        if what == "doubtful":
            results["estimates"][0] = unsound(results["estimates"][0])
        (folder / "results.json").write_text(json.dumps(results))
    last = sorted((out / names["damaged"]).glob("session.*.mcap"))[-1]
    os.truncate(last, last.stat().st_size // 2)
    (out / names["guard"] / OPEN_MARKER).touch()
    said = [{"what": "act", "text": "no heartbeat for 2 s", "utc": "2026-03-02T01:00:00+00:00"},
            {"what": "safe", "instruments": [], "utc": "2026-03-02T01:00:02+00:00"}]  # fmt: skip
    (out / names["guard"] / "guard.jsonl").write_text("".join(json.dumps(line) + "\n" for line in said))
    return names
