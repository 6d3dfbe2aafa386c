"""Every view says NOT confirmed while it is not, and none OUTPUTS OFF: page, list, fleet, top, metrics, messages."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from top_sample import MANIFEST, NOW_S, SetClock, document, small_plan

from bench.commands.progress import doing
from bench.model.events import event_of
from bench.record import OPEN_MARKER, SessionWriter
from bench.run.feed.outputs import bench_in_words
from bench.run.feed.state import RunState
from bench.run.guard.diary import DIARY
from bench.run.guard.last_words import guard_lines
from bench.tui.look import Look, catalogue
from bench.tui.page import page_of
from bench.tui.watch import Seen
from bench.web.fleet.fleet_file import FleetBench
from bench.web.fleet.overview import over_card, run_card
from bench.web.fleet.seat import Seat
from bench.web.now import now_of, silent_row
from bench.web.recorded.listing import session_row
from bench.web.recorded.past import Past
from bench.web.telemetry import SeenRun, families

NAME = "20260301T000000Z_scale_factor_7"
PLACES = {"calibrator": ("fluke_5720a", "GPIB0::4::INSTR"), "supply": ("hp_6632b", "GPIB0::5::INSTR")}
MUTE = "error B-RUN-060: calibrator: not confirmed safe (no answer). Next: switch it off"
END = {"steps": 3, "records": 1, "slip_s": 0.0, "overruns": 0, "retaken": 0, "lateness_ms": [0.0, 0.0, 0.0]}
UTC = "2026-03-01T01:00:00.000+00:00"


@dataclass(frozen=True)
class Met:
    """A run as views meet it: its state document, and its guard where it does not answer."""

    state: Mapping[str, Any]
    folder: Path
    guard: Mapping[str, Any] | None = None


def answered(run: RunState, t_utc_s: float) -> None:
    """Both instruments say that they are off."""
    for role, question in (("calibrator", "ISR?"), ("supply", "OUTP?")):
        run.on_traffic(role, "tx", question, t_utc_s)
        run.on_traffic(role, "rx", "0", t_utc_s)


def living() -> RunState:
    run = RunState(small_plan(), MANIFEST, run=NAME, places=PLACES)
    run.on_event(event_of("phase", {"name": "campaign", "t_start_ns": 0}), NOW_S - 60.0)
    run.on_step(0, NOW_S - 60.0)
    answered(run, NOW_S - 30.0)
    return run


def held(folder: Path, confirmed: bool) -> Met:
    """Its calibrator was off a moment ago, and does not answer any more when it is told to go off."""
    run = living()
    run.on_event(event_of("hold", {"step": 3, "by": "operator", "reason": "door (kim)"}), NOW_S - 20.0)
    unsafe = {"what": "stimulus", "step": 3, "role": "calibrator", "code": "B-INST-001", "text": "mute"}
    run.on_event(event_of("alarm", unsafe), NOW_S - 18.0)
    if confirmed:
        answered(run, NOW_S - 10.0)
    return Met(run.document(NOW_S), folder)


def ended(folder: Path, confirmed: bool) -> Met:
    """Everything answered that it is off just before its end, at which the calibrator was not confirmed safe."""
    run = living()
    with_seal = SessionWriter.create(folder / NAME, {"session": NAME}, {}, t_mono_ns=0)
    for kind, fields in (("safe", {"failures": [] if confirmed else [MUTE]}), ("end", {**END, "error": None})):
        run.on_event(event_of(kind, fields), NOW_S - 5.0)
        with_seal.event(kind, 1, fields)
    with_seal.close("done")
    final = Past().final(folder / NAME)
    return Met({**run.document(NOW_S), "run": NAME, "session": final["session"]}, folder / NAME)


def killed(*entries: Mapping[str, Any]) -> Callable[[Path, bool], Met]:
    """Its guard has acted and has this in its diary, or that everything is confirmed."""

    def met(folder: Path, confirmed: bool) -> Met:
        SessionWriter.create(folder / NAME, {"session": NAME}, {}, t_mono_ns=0).close("done")
        (folder / NAME / OPEN_MARKER).touch()
        diary = [{"what": "act", "text": "no heartbeat for 2 s"}, *([{"what": "safe"}] if confirmed else entries)]
        lines = [json.dumps({"utc": UTC, **entry}) + "\n" for entry in diary]
        (folder / NAME / DIARY).write_text("".join(lines))
        row = silent_row(folder / NAME)
        state = {
            "run": NAME,
            "state": row["state"],
            **{key: row["now"][key] for key in ("bench", "attention", "guard")},
        }
        return Met(state, folder / NAME, row["now"]["guard"])

    return met


SITUATIONS = {
    "in a hold": held,
    "ended": ended,
    "its guard is trying": killed({"what": "unsafe", "instruments": {"calibrator": "unreachable"}}),
    "its guard names roles only": killed({"what": "unsafe", "instruments": ["calibrator"]}),
    "its guard says nothing yet": killed(),
    "its guard has named some": killed(
        {"what": "instrument", "role": "calibrator", "safe": False, "state": "commanded"}
    ),
    "taken over": killed({"what": "safe"}, {"what": "taken over", "by": "bench run 4711"}),
}


def on_card(met: Met) -> str:
    """The bench of a card, and of the page of a run; the words are those of the catalogue for these keys."""
    bench = met.state["bench"]
    word = "OUTPUTS OFF" if bench["state"] == "off" else "on, or not known"
    return word + ("; NOT confirmed" if bench["unconfirmed"] else "")


def in_list(met: Met) -> str:
    """How it stands in the list of sessions; a run that goes on stands there as a card only."""
    if "session" not in met.state and met.guard is None:
        return on_card(met)
    off = session_row(met.folder)["outcome"]["off"]
    return {True: "OUTPUTS OFF", False: "NOT confirmed"}.get(off, "nothing")


def in_fleet(met: Met) -> str:
    seat = Seat(FleetBench("bench-1", "", "fleet.yaml:2:5", "https://bench-1.example.org", "t"), SetClock())  # type: ignore[arg-type]
    if "session" in met.state:
        told = {"proto": 1, "runs": {}, "last": json.loads(json.dumps(over_card(met.state)))}
    else:
        told = {"proto": 1, "runs": {NAME: json.loads(json.dumps(run_card(SeenRun(met.state))))}, "last": None}
    seat.hear(told)
    card = seat.card()
    word = {"off": "OUTPUTS OFF", None: "OUTPUTS OFF" if card.get("off") else "nothing"}.get(card["outputs"], "on")
    return word + (f"; NOT confirmed: {card['unconfirmed']}" if card["unconfirmed"] else "")


def in_top(met: Met) -> str:
    state = document(**{**met.state, "bench": met.state["bench"]}) if met.guard is None else document()
    page = page_of(
        Seen(state, str(met.folder), lost=met.guard is not None, guard=met.guard), Look(catalogue(), width=400)
    )
    said = " ".join(line.plain for line in page.head)
    return f"{said} OUTPUTS OFF" if "has switched the outputs off, and confirmed it" in said else said


def in_metrics(met: Met) -> str:
    samples = [sample for family in families([SeenRun(met.state)]) for sample in family.samples]
    off = [one.value for one in samples if one.labels.get("bench_outputs_state") == "off"]
    left = [one.value for one in samples if one.name == "bench_outputs_unconfirmed"]
    return f"{'OUTPUTS OFF' if off == [1] else ''} {'NOT confirmed' if left != [0] else ''}"


def in_message(met: Met) -> str:
    return bench_in_words(met.state["bench"])


def for_who_looks_next(met: Met) -> str:
    """``bench resume``, ``bench top`` and the terminal of a run that its guard ended."""
    (line,) = guard_lines(met.folder)
    return line.replace("Confirmed: every instrument is off, or on hold", "OUTPUTS OFF")


def at_its_terminal(met: Met) -> str:
    return f"{doing(met.state)} OUTPUTS OFF" if not met.state["bench"]["unconfirmed"] else doing(met.state)


VIEWS = {"card": on_card, "list": in_list, "fleet": in_fleet, "top": in_top, "metrics": in_metrics}
MORE_VIEWS = {
    **{(situation, "message"): in_message for situation in ("in a hold", "ended")},
    **{(situation, "next"): for_who_looks_next for situation in list(SITUATIONS)[2:]},
    ("in a hold", "progress"): at_its_terminal,
}
CASES = {(situation, name): view for situation in SITUATIONS for name, view in VIEWS.items()} | MORE_VIEWS


@pytest.mark.parametrize(("situation", "view"), CASES, ids=[" - ".join(case) for case in CASES])
def test_it_is_not_confirmed_until_it_is(tmp_path: Path, situation: str, view: str) -> None:
    said = CASES[situation, view](SITUATIONS[situation](tmp_path / "a", False))
    assert "NOT confirm" in said
    assert "OUTPUTS OFF" not in said
    said = CASES[situation, view](SITUATIONS[situation](tmp_path / "b", True))
    assert "NOT confirm" not in said
    assert "OUTPUTS OFF" in said


def test_the_fault_of_an_instrument_lasts_until_its_reply_confirms_it(tmp_path: Path) -> None:
    for confirmed in (False, True):
        state = held(tmp_path, confirmed).state
        faults = [alarm for alarm in state["alarms"] if alarm["severity"] == "fault"]
        assert [alarm["active"] for alarm in faults] == [not confirmed]
        assert state["bench"]["unconfirmed"] == ({} if confirmed else {"calibrator": "B-INST-001"})
        assert now_of(state)["attention"] == ("some" if confirmed else "much")
