"""An alarm that is shelved: by whom, why and for how long, and that nobody is called because of it meanwhile."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from test_control import Told, controlled

from bench.commands import control as command
from bench.model.errors import InputError
from bench.model.events import ClockStep, Deviation, Guard
from bench.plan.language.notices import Notify
from bench.run.control.channel import Control
from bench.run.control.notify import Notifier
from bench.run.feed.state import RunState
from bench.run.observers import Following

SHELVE = {"command": "shelve", "alarm": "1", "seconds": 1800.0, "reason": "the clock is being set"}
DEVIATION = Deviation(
    name="air", of="chamber", state="begun", value=53.0, set_point=50.0, limit=2.0, unit="degC", by="its own sensor",
    door=None, action="look",
)  # fmt: skip
START_UTC_S = 946_684_800.0  # of the virtual clock


def shelving(folder: Path) -> tuple[Any, Any, RunState, Control]:
    """Return rig, context, state and control of a run with one alarm."""
    rig, context, _ = controlled(folder)
    state = RunState(rig.steps, {})
    following = Following(context.observers)
    context.observers.add(Told(state))
    context.event(ClockStep(step_s=3.0, t_utc_ns=0))
    return rig, context, state, Control(context, following, dict, state)


def test_it_is_recorded_and_shown_with_who_why_and_until_when(tmp_path: Path) -> None:
    rig, _, state, answering = shelving(tmp_path)
    reply = answering.answer({**SHELVE, "by": "kim"}, "root (process 12)")
    assert reply["text"] == "alarm 1 is shelved until 2000-01-01T00:30:00Z; nobody is notified of it until then"
    (event,) = rig.events("control")
    assert (event["what"], event["alarm"], event["ok"]) == ("shelve", "1", True)
    assert (event["by"], event["reason"]) == ("kim via root (process 12)", SHELVE["reason"])
    (alarm,) = state.document(START_UTC_S + 10.0)["alarms"]
    assert alarm["shelved"] == {"by": event["by"], "reason": SHELVE["reason"], "until_utc_s": START_UTC_S + 1800.0}
    (alarm,) = state.document(START_UTC_S + 1800.0)["alarms"]
    assert alarm["shelved"] is None


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"reason": " "}, "for a reason"),
        ({"alarm": "7"}, "there is no alarm '7'; there are: 1: UTC has jumped"),
        ({"alarm": 1}, "there is no alarm '1'; there are"),
        ({"seconds": 59.0}, "60 s to 8 h"),
        ({"seconds": 28_801.0}, "60 s to 8 h"),
        ({"seconds": 10**400}, "60 s to 8 h"),
        ({"seconds": True}, "60 s to 8 h"),
        ({"seconds": "1800"}, "60 s to 8 h"),
        ({"seconds": None}, "60 s to 8 h"),
    ],
)
def test_what_is_wrong_is_refused_and_shelves_nothing(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    rig, _, state, answering = shelving(tmp_path)
    reply = answering.answer({**SHELVE, **changes}, "me")
    assert said in reply["error"]
    assert rig.events("control")[0]["ok"] is False
    assert state.document(START_UTC_S + 1.0)["alarms"][0]["shelved"] is None


def test_a_fault_is_never_shelved(tmp_path: Path) -> None:
    _, context, _, answering = shelving(tmp_path)
    context.event(Guard(state="acted", reason="limit", text="too hot"))
    assert "never shelved" in answering.answer({**SHELVE, "alarm": "2"}, "me")["error"]


def test_nobody_is_notified_of_what_is_shelved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _, context, state, answering = shelving(tmp_path)
    context.event(DEVIATION)
    sent: list[str] = []
    monkeypatch.setattr(Notifier, "_send", lambda self, name, send, message: sent.append(message["event"]))
    notifier = Notifier(Notify(command=["x"]), context, lambda: "", shelved=state.is_shelved)  # type: ignore[call-arg]
    notifier.event(DEVIATION, 0)
    assert answering.answer({**SHELVE, "alarm": "2"}, "me")["ok"]
    notifier.event(DEVIATION, 0)
    notifier.event(replace(DEVIATION, of="another"), 0)
    context.clock.sleep(SHELVE["seconds"])
    notifier.event(DEVIATION, 0)
    notifier.close()
    assert sent == ["alarm"] * 3


def test_a_time_without_its_unit_is_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="B-CTRL-004"):
        command.shelve(tmp_path, "1", "30", "door")
