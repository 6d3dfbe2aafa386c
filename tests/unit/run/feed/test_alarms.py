"""Alarms of the feed: what raises one, what ends it, who has seen it, and that there are never too many."""

from __future__ import annotations

from typing import Any

import pytest

from bench.model.events import event_of
from bench.run.feed.alarms import MOST, Alarms

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
