"""The state document: what a run does, waits for and has done, by events alone and told by a living run; alarms."""

import json
from dataclasses import replace
from typing import Any

import pytest
from top_sample import MANIFEST, small_plan
from top_sample import PLAN_START_S as START_S

from bench.model.events import Phase, ThermalLag, event_of
from bench.plan import PlannedSoak
from bench.run.feed.place import MARGIN_S, SHARE, PlannedRun, Remaining, early_s, end_of_run
from bench.run.feed.run_state import MOST, Alarms, RunState

KEYS = {
    "proto", "run", "boot_id", "title", "sequence", "station", "uut", "simulated", "clock", "source", "state",
    "outcome", "attention", "bench", "t_utc_s", "started_utc_s", "step", "wait", "progress", "eta", "holds", "prompt",
    "records", "links", "instruments", "alarms", "unwatched", "log", "signals", "graphs", "limits", "timetable",
}  # fmt: skip
RECORD = {
    "number": 1, "link": "port_a", "first_counter": 0, "frames": 1000, "t_start_ns": 0, "t_end_ns": 0, "step": 5,
    "conditions": {"channel": 1},
}  # fmt: skip


def told(state: RunState, kind: str, t_utc_s: float, fields: dict[str, Any]) -> None:
    """An event as a session holds it."""
    state.on_event(event_of(kind, fields), t_utc_s)


def replayed() -> RunState:
    state = RunState(small_plan(), MANIFEST, source="replay")
    told(state, "phase", START_S, {"name": "prepare"})
    return state


def in_campaign() -> RunState:
    """Second 0 of the campaign is START_S + 5."""
    state = replayed()
    told(state, "prompt", START_S, {"step": 0, "text": "door closed?", "by": "operator"})
    told(state, "phase", START_S + 5.0, {"name": "campaign"})
    return state


def what(state: RunState, seconds: float) -> str:
    document = state.document(START_S + 5.0 + seconds)
    json.dumps(document, allow_nan=False)
    assert set(document) == KEYS
    return str(document["step"]["what"])


def test_a_run_that_has_not_begun() -> None:
    document = RunState(small_plan(), MANIFEST, boot_id="ab").document(START_S)
    assert (document["state"], document["step"], document["eta"], document["progress"]) == ("starting", None, None, 0.0)
    assert (document["run"], document["boot_id"], document["source"]) == (MANIFEST["session"], "ab", "live")
    assert document["uut"] == {"model": "NGU", "serial": "7"}
    assert document["records"]["planned"] == 1
    assert document["unwatched"] == []
    assert RunState(small_plan(), MANIFEST, unwatched=["nothing"]).document(START_S)["unwatched"] == ["nothing"]


def test_a_recording_follows_the_plan_but_never_past_an_event_that_is_missing() -> None:
    state = replayed()
    assert state.document(START_S + 3.0)["step"]["what"] == "prompt"  # not answered yet, whatever the plan says
    state = in_campaign()
    assert what(state, 10.0) == "soak 50 degC"
    assert what(state, 1000.0) == "settle channel 1"  # calls and settle share their start
    assert what(state, 1025.0) == "record channel 1 -10 mA"
    assert what(state, 1100.0) == "record channel 1 -10 mA"
    told(state, "record", START_S + 5.0 + 1032.0, RECORD)
    assert what(state, 1032.0) == "source.operating channel 1"
    document = state.document(START_S + 5.0 + 1032.5)
    assert document["step"]["number"] == 7
    assert document["step"]["where"] == "small.yaml:7:1"
    assert document["records"]["done"] == 1
    assert document["records"]["last"][0] == {
        "number": 1, "t_utc_s": START_S + 1037.0, "conditions": {"channel": 1}, "frames": 1000, "lost": None,
        "bad": None, "flags": None,
    }  # fmt: skip


def test_a_soak_is_a_wait_with_its_last_reading() -> None:
    state = in_campaign()
    for minute in range(3):
        fields = {"air_degC": 40.0, "unit_degC": 30.0 + minute}
        told(state, "environment", START_S + 5.0 + 60.0 * minute, fields)
    wait = state.document(START_S + 130.0)["wait"]
    assert wait == {
        "reason": "soak 50 degC", "since_utc_s": START_S + 5.0, "until_utc_s": START_S + 1005.0,
        "last": "32.00 degC, +1.000 degC/min",
    }  # fmt: skip


def test_a_late_soak_says_until_when_and_widens_the_range() -> None:
    state = in_campaign()
    told(state, "late", START_S + 1005.0, {"step": 2, "policy": "hold", "last_degC": 48.0, "slope_degC_min": 0.1})
    document = state.document(START_S + 1105.0)
    assert document["wait"]["reason"] == "soak 50 degC, later than planned"
    assert document["wait"]["until_utc_s"] == START_S + 5.0 + 1000.0 + 600.0
    assert document["step"]["what"] == "soak 50 degC"
    spread = document["eta"]["latest_utc_s"] - document["eta"]["likely_utc_s"]
    assert spread == pytest.approx(500.0 + 100.0 * SHARE + 0.005 * 130.0 + MARGIN_S)
    told(state, "slip", START_S + 1125.0, {"step": 2, "seconds": 120.0, "reason": "soak"})
    document = state.document(START_S + 1125.0)
    assert document["step"]["what"] == "settle channel 1"
    assert document["eta"]["likely_utc_s"] == pytest.approx(START_S + 1125.0 + 130.0)
    share = 0.12  # this run's soak was late by so much
    assert document["eta"]["latest_utc_s"] - document["eta"]["likely_utc_s"] == pytest.approx(
        100.0 * share + 0.005 * 130.0 + MARGIN_S
    )


def test_standing_still_tells_no_end_and_shifts_it() -> None:
    state = in_campaign()
    told(state, "hold", START_S + 5.0 + 1025.0, {"step": 5, "by": "link port_a", "reason": "no good frame"})
    document = state.document(START_S + 5.0 + 1325.0)
    assert document["state"] == "holding"
    assert document["holds"] == {"link port_a": "no good frame"}
    assert document["wait"]["reason"] == "no good frame"
    assert document["wait"]["since_utc_s"] == START_S + 5.0 + 1025.0
    assert document["eta"] is None
    told(state, "release", START_S + 5.0 + 1325.0, {"step": 5, "seconds": 300.0})
    document = state.document(START_S + 5.0 + 1326.0)
    assert (document["state"], document["step"]["what"]) == ("running", "settle channel 1")  # the point from its start
    assert document["eta"]["likely_utc_s"] == pytest.approx(START_S + 5.0 + 1325.0 + 130.0)


def test_a_release_says_which_step_stood_still_whatever_the_plan_has_now() -> None:
    state = in_campaign()
    assert what(state, 990.0) == "soak 50 degC"
    told(state, "hold", START_S + 5.0 + 990.0, {"step": 5, "by": "operator", "reason": "door"})
    told(state, "release", START_S + 5.0 + 1200.0, {"step": 5, "seconds": 210.0})
    assert what(state, 1201.0) == "settle channel 1"


def test_a_record_that_is_taken_back_does_not_count() -> None:
    state = in_campaign()
    told(state, "record", START_S + 1035.0, RECORD)
    state.on_record(1, START_S + 1035.0, {"channel": 1}, {"frames": 990, "lost": 10, "bad": 3, "flags": ["over range"]})
    records = state.document(START_S + 1035.0)["records"]
    assert (records["done"], records["flagged"], len(records["last"])) == (1, 1, 1)
    assert records["last"][0]["lost"] == 10
    told(state, "retake", START_S + 1036.0, {"record": 1, "reason": "10 of 1000 frames lost"})
    records = state.document(START_S + 1036.0)["records"]
    assert (records["done"], records["retaken"], records["flagged"], records["last"]) == (0, 1, 0, [])
    wiring = {**RECORD, "number": 2, "conditions": {"purpose": "wiring"}}
    told(state, "record", START_S + 1037.0, wiring)
    assert state.document(START_S + 1037.0)["records"]["done"] == 0


def test_a_living_run_says_where_it_is_and_one_gone_on_with_what_it_has() -> None:
    state = RunState(small_plan(), MANIFEST)
    state.on_timeline(START_S)
    state.on_step(6, START_S + 1030.0)
    document = state.document(START_S + 1030.5)
    assert (document["state"], document["records"]["done"]) == ("running", 1)
    assert document["progress"] == pytest.approx(1035.0 / 1135.0)
    assert document["eta"]["earliest_utc_s"] == pytest.approx(START_S + 1030.5 + 100.0)
    state.on_step(3, START_S + 1040.0)
    assert state.document(START_S + 1041.0)["wait"] is None
    wait = state.document(START_S + 1043.0)["wait"]
    assert (wait["reason"], wait["since_utc_s"]) == ("source.operate", START_S + 1040.0)


def test_a_prompt_is_a_wait_in_a_living_run_and_in_a_recording() -> None:
    asked = dict.fromkeys(("low", "high")) | {"id": "1", "text": "door closed?", "confirm": "operator", "unit": ""}
    asked |= {"presence": "bench", "arms": False}
    live = RunState(small_plan(), MANIFEST)
    live.on_step(0, START_S)
    live.on_prompt({**asked, "since_utc_s": START_S})
    recorded = replayed()
    told(recorded, "alarm", START_S, {"what": "prompt", **asked})
    for state in (live, recorded):
        document = state.document(START_S + 60.0)
        assert document["prompt"] == {**asked, "since_utc_s": START_S}
        assert document["wait"]["reason"] == "answer: door closed?"
    told(recorded, "prompt", START_S + 61.0, {"step": 0, **asked, "by": "kim", "value": None})
    document = recorded.document(START_S + 61.0)
    assert (document["prompt"], document["alarms"][0]["active"]) == (None, False)


def test_how_a_run_ends_and_goes_on() -> None:
    state = in_campaign()
    told(state, "control", START_S + 20.0, {"what": "abort", "by": "kim", "reason": "enough", "ok": False})
    assert state.document(START_S + 20.0)["state"] == "running"
    told(state, "control", START_S + 20.0, {"what": "abort", "by": "kim", "reason": "enough", "ok": True})
    document = state.document(START_S + 20.0)
    assert (document["state"], document["eta"]) == ("ending", None)
    told(state, "error", START_S + 21.0, {"code": "B-RUN-010", "text": "error B-RUN-010: stopped", "step": 2})
    told(state, "end", START_S + 22.0, {"error": "B-RUN-010"})
    document = state.document(START_S + 22.0)
    assert document["state"] == "ended"
    assert document["outcome"] == {"error": "B-RUN-010", "text": "error B-RUN-010: stopped"}
    assert document["wait"] is None
    told(state, "resume", START_S + 100.0, {"start": 3, "reason": "B-RUN-010", "segment": 2})
    told(state, "phase", START_S + 110.0, {"name": "campaign"})
    document = state.document(START_S + 111.0)
    assert (document["state"], document["step"]["what"]) == ("running", "settle channel 1")
    assert document["outcome"] is None
    told(state, "end", START_S + 300.0, {"error": None})
    document = state.document(START_S + 300.0)
    assert (document["outcome"], document["progress"]) == ({"error": None, "text": "done"}, 1.0)


def test_the_instrument_panel() -> None:
    state = RunState(small_plan(), MANIFEST, places={"source": ("fluke_5720a", "GPIB0::4::INSTR")})
    for direction, text, moment in (
        ("tx", "OUT 1 A", 0.0), ("tx", "FAULT?", 1.0), ("rx", "515\r", 1.25), ("tx", "ISR?", 2.0), ("rx", "4096", 2.5)
    ):  # fmt: skip
        state.on_traffic("source", direction, text, START_S + moment)
    line = state.document(START_S + 3.0)["instruments"]["source"]
    assert line == {
        "driver": "fluke_5720a", "resource": "GPIB0::4::INSTR", "identity": "FLUKE 5720A 1 A", "command": "ISR?",
        "reply": "4096", "t_utc_s": START_S + 2.5, "answer_ms": 500.0, "error": "515", "errors": 1, "state": "error",
    }  # fmt: skip
    state.on_traffic("source", "tx", "FAULT?", START_S + 4.0)
    state.on_traffic("source", "rx", "0", START_S + 4.1)
    state.on_traffic("chamber", "tx", "RUN", START_S + 5.0)  # not in the manifest, for whatever reason
    panel = state.document(START_S + 5.0)["instruments"]
    assert (panel["source"]["state"], panel["source"]["errors"]) == ("ok", 1)
    assert (panel["chamber"]["reply"], panel["chamber"]["answer_ms"]) == (None, None)
    state.on_holds({"instrument source": "B-INST-001: no answer"}, frozenset({"source"}))
    assert state.document(START_S + 6.0)["instruments"]["source"]["state"] == "away"


@pytest.mark.parametrize("reply", ['+0,"No error"', '0,"NO ERROR"', "0", '-222,"Data out of range"', "nonsense"])
def test_error_queues_as_the_drivers_ask_them(reply: str) -> None:
    state = RunState(small_plan(), MANIFEST)
    state.on_traffic("source", "tx", "SYST:ERR?", START_S)
    state.on_traffic("source", "rx", reply, START_S)
    assert state.document(START_S)["instruments"]["source"]["errors"] == int(reply.startswith("-222"))


def test_the_log_and_the_timetable() -> None:
    state = in_campaign()
    for number in range(500):
        told(state, "clock_step", START_S + number, {"step_s": 1.0})
    told(state, "environment", START_S + 500.0, {"air_degC": 22.0, "unit_degC": None})
    document = state.document(START_S + 500.0)
    assert len(document["log"]) == 200
    assert document["log"][0]["t_utc_s"] == START_S + 499.0
    table = document["timetable"]
    assert [band[2:] for band in table["bands"]] == [[49.0, 51.0]]
    assert table["bands"][0][0] >= table["t_utc_s"][1]  # not before the ramp is over
    assert len(table["t_utc_s"]) == len(table["temperature_degC"])
    assert table["t_utc_s"] == sorted(table["t_utc_s"])
    assert table["t_utc_s"][-1] == pytest.approx(START_S + 5.0 + 1030.0 + 100.0)


def test_the_planned_temperature_is_a_ramp_then_flat() -> None:
    state = replayed()
    told(state, "environment", START_S, {"air_degC": 20.0, "unit_degC": 20.0})
    told(state, "prompt", START_S, {"step": 0, "text": "door closed?", "by": "operator"})
    told(state, "phase", START_S + 5.0, {"name": "campaign"})
    table = state.document(START_S + 6.0)["timetable"]
    began = START_S + 5.0
    reached = pytest.approx(20.0 + 1030.0 / 60.0)  # at 1 degC/min until the next set-point
    assert table["temperature_degC"][:4] == [20.0, reached, reached, reached]
    assert table["t_utc_s"][:3] == [began, began + 1030.0, began + 1030.0]


def test_events_of_a_foreign_session_break_nothing() -> None:
    state = in_campaign()
    assert PlannedRun(small_plan()).step_at("nowhere", 0.0) is None
    for kind in ("hold", "release", "alarm", "interlock", "link", "guard", "verdict", "error", "end", "slip", "late",
                 "overrun", "skip", "resume", "phase", "reentry", "prompt", "environment", "control", "gap", "closed",
                 "something"):  # fmt: skip
        told(state, kind, START_S, {})
        json.dumps(state.document(START_S), allow_nan=False)


def test_the_range_of_the_end() -> None:
    first = end_of_run(0.0, Remaining(1000.0, 400.0), ())
    assert first == {"earliest_utc_s": 1000.0, "likely_utc_s": 1000.0, "latest_utc_s": 1000.0 + 40.0 + 5.0 + MARGIN_S}
    known = end_of_run(0.0, Remaining(1000.0, 400.0), (0.0, 0.0, 0.25))
    assert known["latest_utc_s"] == 1000.0 + 100.0 + 5.0 + MARGIN_S
    calm = end_of_run(0.0, Remaining(1000.0, 400.0, 60.0), (0.0,) * 9)
    assert calm["latest_utc_s"] == 1000.0 + 4.0 + 60.0 + 5.0 + MARGIN_S


LEAST_s = 400.0


def by_lag() -> RunState:
    """Second 0 of the campaign is START_S; its first step is a soak of 1000 s that may end after 400 s."""
    steps = [
        replace(step, residual_degC=0.1, least_s=LEAST_s) if isinstance(step, PlannedSoak) else step
        for step in small_plan()
    ]
    state = RunState(steps, MANIFEST, source="replay")
    state.on_event(Phase(name="campaign", t_start_ns=0), START_S)
    return state


def noted(saved_s: float, step: int) -> ThermalLag:
    return ThermalLag(step=step, lag_s=1500.0, share=0.01, residual_degC=0.05, bound_degC=0.09, saved_s=saved_s)


def test_what_a_soak_may_leave_out_makes_the_earliest_end() -> None:
    state = by_lag()
    for seconds, early in ((10.0, 600.0), (300.0, 600.0), (700.0, 300.0)):
        state.at_planned("campaign", seconds)
        eta = state.document(START_S + seconds)["eta"]
        assert eta["likely_utc_s"] - eta["earliest_utc_s"] == pytest.approx(early)
    state.at_planned("campaign", 1020.0)
    eta = state.document(START_S + 1020.0)["eta"]
    assert eta["likely_utc_s"] == eta["earliest_utc_s"]
    soaks = [step for step in small_plan() if isinstance(step, PlannedSoak)]
    assert early_s(soaks, soaks[0], 0.0) == 0.0  # without 'done'


def test_the_end_comes_nearer_by_what_was_left_out() -> None:
    state = by_lag()
    state.at_planned("campaign", 500.0)
    before = state.document(START_S + 500.0)
    soak = next(step.number for step in small_plan() if isinstance(step, PlannedSoak))
    state.on_event(noted(500.0, soak + 3), START_S + 500.0)  # of a soak that is done again, on the way back
    assert state.document(START_S + 500.0)["eta"] == before["eta"]
    state.on_event(noted(500.0, soak), START_S + 500.0)
    after = state.document(START_S + 500.5)
    assert after["eta"]["likely_utc_s"] == pytest.approx(before["eta"]["likely_utc_s"] - 500.0)
    assert "the last 8 min of the slot are left out" in after["log"][0]["text"]


TRIPPED = {
    "name": "air", "signal": "chamber_air", "of": "", "value": 64.0, "limit": 63.0, "unit": "degC", "action": "hold",
    "state": "tripped",
}  # fmt: skip
DEVIATION = {
    "what": "deviation", "name": "air", "of": "chamber", "state": "begun", "value": 53.0, "set_point": 50.0,
    "limit": 2.0, "unit": "degC", "by": "its own sensor", "door": None, "action": "look at it",
}  # fmt: skip


def raised(kind: str, **fields: Any) -> list[dict[str, Any]]:
    alarms = Alarms()
    alarms.on_event(event_of(kind, fields), 5.0)
    return alarms.documents(9.0)


LOST = {"link": "port_a", "state": "lost", "reason": "unplugged"}
HELD = {"by": "operator", "reason": "door (kim)", "step": 3}
STIMULUS = {"what": "stimulus", "step": 3, "role": "switch", "code": "B-INST-001", "text": "mute"}
LONG = {"what": "hold", "step": 3, "seconds": 600.0, "reasons": {"a": "b"}}


@pytest.mark.parametrize(
    ("kind", "fields", "severity", "active", "words"),
    [
        ("interlock", TRIPPED, "alarm", True, "chamber_air is 64 degC, limit 63 degC: hold"),
        ("interlock", TRIPPED | {"action": "warn"}, "warning", True, "warn"),
        ("interlock", TRIPPED | {"action": "abort", "state": "lasting"}, "fault", True, "abort"),
        ("interlock", TRIPPED | {"state": "stale", "value": None}, "alarm", True, "no reading of chamber_air"),
        ("link", LOST, "alarm", True, "link port_a is lost: unplugged"),
        ("link", LOST | {"state": "silent"}, "alarm", True, "silent"),
        ("link", {"link": "port_a", "state": "kernel errors", "overrun": 3}, "warning", False, "overrun 3"),
        ("hold", HELD, "warning", True, "holding at step 3: door (kim)"),
        ("hold", HELD | {"by": "link port_a"}, "alarm", True, "holding at step 3"),
        ("alarm", LONG, "alarm", True, "after 600 s: b"),
        ("alarm", STIMULUS, "fault", True, "switch"),
        ("alarm", {"what": "prompt", "text": "door closed?"}, "alarm", True, "door closed?"),
        ("guard", {"state": "acted", "reason": "limit", "text": "too hot"}, "fault", False, "too hot"),
        ("error", {"code": "B-INST-001", "text": "error B-INST-001: x: mute"}, "warning", False, "mute"),
        ("clock_step", {"step_s": 300.0, "t_utc_ns": 0}, "warning", False, "+300.000 s"),
        ("verdict", {"ok": False, "checks": [{"ok": False, "text": "drift"}]}, "alarm", False, "drift"),
        ("alarm", DEVIATION, "warning", True, "air is 53 degC, 2 degC or more outside its set-point of 50 degC"),
        ("alarm", DEVIATION | {"name": "runaway", "unit": "degC/min"}, "alarm", True, "set-point"),
        ("alarm", DEVIATION | {"name": "runaway", "door": True}, "warning", True, "door"),
        ("alarm", DEVIATION | {"name": "sensors", "unit": "K"}, "alarm", True, "53 K apart, limit 2 K"),
        ("alarm", DEVIATION | {"name": "voltage", "unit": "V"}, "warning", True, "53 V, set to 50 V within 2 V"),
        ("disk", {"code": "B-REC-001", "text": "no space"}, "fault", False, "no space"),
        ("safe", {"failures": ["switch: not confirmed safe"]}, "fault", False, "not confirmed"),
        ("end", {"error": "B-RUN-071"}, "fault", False, "B-RUN-071"),
    ],
)
def test_what_raises_an_alarm(kind: str, fields: dict[str, Any], severity: str, active: bool, words: str) -> None:
    (alarm,) = raised(kind, **fields)
    assert (alarm["severity"], alarm["active"], alarm["t_utc_s"]) == (severity, active, 5.0)
    assert words in alarm["text"]
    assert (alarm["acknowledged"], alarm["code"]) == (None, fields.get("code", fields.get("error")))


@pytest.mark.parametrize(
    ("kind", "fields"),
    [
        ("record", {"number": 1}), ("verdict", {"ok": True, "checks": []}), ("verdict", {"ok": None}),
        ("link", {"link": "port_a", "state": "open"}), ("guard", {"state": "ready"}), ("safe", {"failures": []}),
        ("end", {"error": None}), ("interlock", {**TRIPPED, "state": "released"}),
        ("alarm", {**DEVIATION, "state": "over"}),
    ],
)  # fmt: skip
def test_what_raises_none(kind: str, fields: dict[str, Any]) -> None:
    assert raised(kind, **fields) == []


@pytest.mark.parametrize(
    ("begin", "over"),
    [
        (("interlock", TRIPPED), ("interlock", TRIPPED | {"state": "released"})),
        (("alarm", DEVIATION), ("alarm", DEVIATION | {"state": "over"})),
        (("link", LOST), ("link", LOST | {"state": "back"})),
        (("hold", HELD), ("release", {"seconds": 3.0})),
        (("alarm", STIMULUS), ("release", {"seconds": 3.0})),
        (("alarm", {"what": "prompt", "text": "?"}), ("prompt", {"text": "?"})),
        (("hold", HELD), ("end", {"error": None})),
    ],
)
@pytest.mark.parametrize("first", ["over", "acknowledged"])
def test_an_alarm_stays_until_it_is_over_and_acknowledged(begin: Any, over: Any, first: str) -> None:
    alarms = Alarms()
    alarms.on_event(event_of(*begin), 1.0)
    (alarm,) = alarms.documents(9.0)
    if first == "over":
        alarms.on_event(event_of(*over), 2.0)
        assert [one["active"] for one in alarms.documents(9.0)] == [False]
    assert alarms.acknowledge(alarm["id"], "kim", 3.0)
    if first == "acknowledged":
        assert alarms.documents(9.0)[0]["acknowledged"] == {"by": "kim", "t_utc_s": 3.0}
        assert not alarms.acknowledge(alarm["id"], "lee", 4.0)
        alarms.on_event(event_of(*over), 5.0)
    assert alarms.documents(9.0) == []


def test_the_same_trouble_again_is_the_same_alarm_until_somebody_has_seen_it() -> None:
    alarms = Alarms()
    error = {"code": "B-INST-001", "where": "GPIB0::14", "text": "error B-INST-001: GPIB0::14: no answer in 3 s"}
    seen = {"what": "acknowledge", "by": "kim", "reason": ""}
    for moment in (1.0, 2.0, 3.0):
        alarms.on_event(event_of("error", error), moment)
    alarms.on_event(event_of("error", {**error, "where": "GPIB0::4"}), 4.0)
    assert [(one["id"], one["t_utc_s"]) for one in alarms.documents(9.0)] == [("2", 4.0), ("1", 3.0)]
    alarms.on_event(event_of("control", {**seen, "alarm": "1", "ok": True}), 5.0)
    assert [one["id"] for one in alarms.documents(9.0)] == ["2"]
    alarms.on_event(event_of("control", {**seen, "alarm": "2", "ok": False}), 5.0)
    assert alarms.waits("2")
    alarms.on_event(event_of("error", error), 6.0)
    assert [one["id"] for one in alarms.documents(9.0)] == ["3", "2"]


def test_the_error_that_ends_a_run_is_a_fault() -> None:
    alarms = Alarms()
    alarms.on_event(event_of("error", {"code": "B-RUN-031", "text": "error B-RUN-031: not reached", "step": 3}), 1.0)
    alarms.on_event(event_of("end", {"error": "B-RUN-031"}), 2.0)
    assert [(one["severity"], one["code"]) for one in alarms.documents(9.0)] == [("fault", "B-RUN-031")]


def test_there_are_never_too_many_and_what_lasts_goes_last() -> None:
    alarms = Alarms()
    alarms.on_event(event_of("interlock", TRIPPED), 0.0)
    for number in range(3 * MOST):
        alarms.on_event(event_of("error", {"code": "B-X", "where": f"place {number}", "text": "bad"}), float(number))
    found = alarms.documents(9.0)
    assert len(found) == MOST
    assert found[-1]["active"]
    assert found[0]["t_utc_s"] == 3 * MOST - 1


def test_what_is_shelved_stays_so_for_its_time_also_when_it_comes_again() -> None:
    alarms = Alarms()
    alarms.on_event(event_of("alarm", DEVIATION), 10.0)
    shelve = {"what": "shelve", "alarm": "1", "by": "kim", "reason": "door is being mended", "until_utc_s": 100.0}
    alarms.on_event(event_of("control", {**shelve, "ok": False}), 11.0)
    assert alarms.documents(12.0)[0]["shelved"] is None
    alarms.on_event(event_of("control", {**shelve, "ok": True}), 11.0)
    shelved = {"by": "kim", "reason": "door is being mended", "until_utc_s": 100.0}
    assert alarms.documents(12.0)[0]["shelved"] == shelved
    assert alarms.acknowledge("1", "kim", 13.0)
    alarms.on_event(event_of("alarm", {**DEVIATION, "state": "over"}), 14.0)
    assert alarms.documents(15.0) == []
    alarms.on_event(event_of("alarm", DEVIATION), 20.0)
    assert alarms.documents(99.9)[0]["shelved"] == shelved
    assert alarms.documents(100.0)[0]["shelved"] is None
