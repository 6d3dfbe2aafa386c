"""A point with a decision inside: held, taken again, skipped and gone on with, the decision stands."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from probe_bench import AtMeter, at_reading
from probe_decisions import HEAD, deciding_plan, events_of
from rehearsal import Crashes, crashed_at, go_on, rehearsed

from bench.model.clock import NS
from bench.model.events import event_of
from bench.record import SessionReader
from bench.replay import replay_rows
from bench.run.context import RunContext
from bench.run.control.channel import OPERATOR
from bench.run.feed.state import RunState
from bench.run.session import Conducted
from bench.run.stop import Wish
from instruments.thermotron_3800 import Thermotron3800

RECORD = """\
          - record:
              seconds: 60 s
              readings: [meter.measure_resistance: {range: 1 kohm, cycles: 10}]
              conditions: {temperature: DEGC degC}
"""
WARM, HOT = RECORD.replace("DEGC", "40"), RECORD.replace("DEGC", "60")
SEQUENCE = f"""\
{HEAD}\
  - chamber.set_temperature: {{temperature: 40 degC, ramp: 1 degC/min}}
  - chamber.run
  - settle: 10 s
  - point
procedures:
  point:
    do:
      - chamber.measure_air
      - settle: 10 s
      - if: {{reading: chamber.measure_air, below: 30 degC}}
        then:
{WARM}\
          - settle: 10 s
{WARM}\
        else:
          - chamber.set_temperature: {{temperature: 60 degC, ramp: 1 degC/min}}
          - settle: 1 h
{HOT}"""
FIRST, DECISION, LAST = 3, 5, 8  # steps of the point: its first, its decision, the last record of 'then'
LEFT_OUT = (9, 12)
HELD_S = 100.0
pytestmark = pytest.mark.usefixtures("probes")


def conducted(tmp_path: Path, beside: AtMeter) -> Conducted:
    return rehearsed(tmp_path / "out", deciding_plan(tmp_path, SEQUENCE), beside=[beside]).run


def pause(context: RunContext) -> None:
    context.stop.holds.hold(OPERATOR, "coffee")


def again(context: RunContext) -> None:
    context.stop.holds.wish(Wish("retake", "interlock air", "too warm"))


def test_the_plan(tmp_path: Path) -> None:
    plan = deciding_plan(tmp_path, SEQUENCE)
    assert [step.kind for step in plan.steps] == [
        "call", "call", "settle", "call", "settle", "decide", "record", "settle", "record", "call", "settle", "record",
    ]  # fmt: skip
    assert plan.duration_s == 20.0 + 3660.0


@pytest.mark.parametrize("act", [pause, again])
def test_a_point_that_is_taken_again_keeps_its_decision(tmp_path: Path, act: Callable[[RunContext], None]) -> None:
    """Both records of the branch are taken again from the first step of the point, and decided is only once."""
    done = conducted(tmp_path, at_reading(2, act, HELD_S))
    assert done.outcome.error is None
    assert [(one["step"], one["outcome"]) for one in events_of(done.folder, "decision")] == [(DECISION, "then")]
    assert len(events_of(done.folder, "reading")) == 2 + 2 + 2
    assert [row.window.number for row in done.outcome.rows] == [1, 2]
    assert [row.window.step for row in replay_rows(done.folder).rows] == [6, LAST]
    assert [(one["first"], one["stop"]) for one in events_of(done.folder, "skip")] == [LEFT_OUT]


def test_time_goes_on_as_planned_behind_a_hold(tmp_path: Path) -> None:
    """The run lasts as long as the way that was taken, and the slip: not the hour of the other branch."""
    done = conducted(tmp_path, at_reading(2, pause, HELD_S))
    assert events_of(done.folder, "release")[0]["seconds"] == pytest.approx(100.0, abs=1.0)
    assert 100.0 < done.outcome.slip_s < 300.0
    last_ns = max(message.t_ns for message in SessionReader(done.folder).messages())
    assert last_ns / NS == pytest.approx(10.0 + 10.0 + 60.0 + 10.0 + 60.0 + done.outcome.slip_s, abs=0.1)


def test_a_point_that_is_skipped_does_not_jump_over_a_decision(tmp_path: Path) -> None:
    """Skipped in its first record; the rest of the branch is done, and the other branch is not."""
    skip = at_reading(1, lambda context: context.stop.holds.wish(Wish("skip", "interlock air", "too warm")), HELD_S)
    done = conducted(tmp_path, skip)
    assert done.outcome.error is None
    assert [row.window.step for row in done.outcome.rows] == [LAST]
    assert [(one["by"], one["first"], one["stop"]) for one in events_of(done.folder, "skip")] == [
        ("interlock air", FIRST, 7), ("decision", *LEFT_OUT),
    ]  # fmt: skip


@pytest.fixture(scope="module")
def crashes(tmp_path_factory: pytest.TempPathFactory, probes: None) -> Crashes:
    folder = tmp_path_factory.mktemp("held")
    return crashed_at(deciding_plan(folder, SEQUENCE), folder, {4, DECISION, 6, LAST})


@pytest.mark.parametrize("number", [4, DECISION, 6, LAST])
def test_a_killed_point_is_taken_again_on_the_same_way(crashes: Crashes, number: int, tmp_path: Path) -> None:
    """The chamber goes back to the temperature that the run had sent it to, not to that of the branch left out."""
    folder = Path(shutil.copytree(crashes.at(number), tmp_path / crashes.whole.name))
    assert go_on(folder).outcome.error is None
    assert [one["outcome"] for one in events_of(folder, "decision")] == ["then"]
    assert {one["target_degC"] for one in events_of(folder, "reentry")} == {40.0}
    assert [row.window.step for row in replay_rows(folder).rows] == [6, LAST]


def test_a_decision_stands_though_the_reading_is_another_now(
    crashes: Crashes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The point is taken again from its reading on, which says 50 degC by now: 'then' is done all the same."""
    folder = Path(shutil.copytree(crashes.at(LAST), tmp_path / crashes.whole.name))
    assert [one["outcome"] for one in events_of(folder, "decision")] == ["then"]
    monkeypatch.setattr(Thermotron3800, "measure_air", lambda chamber: 50.0)
    assert go_on(folder).outcome.error is None
    assert [one["value"] for one in events_of(folder, "reading") if one["name"] == "measure_air"][-1] == 50.0
    assert [one["outcome"] for one in events_of(folder, "decision")] == ["then"]
    assert [row.window.step for row in replay_rows(folder).rows] == [6, LAST]


def test_a_recording_is_followed_on_the_way_that_was_taken(crashes: Crashes) -> None:
    """Its page stands at a step of the branch that was done, and counts the records of this way."""
    state = RunState(crashes.plan.steps, {}, source="replay")
    stood: set[int] = set()
    for message in SessionReader(crashes.whole).messages():
        t_s = message.t_ns / NS
        if message.topic.endswith("event"):
            state.on_event(event_of(*message.event()), t_s)
        step = state.document(t_s)["step"]
        if step is not None:
            stood.add(step["number"] - 1)
    assert not stood & set(range(*LEFT_OUT))
    assert {6, 7, LAST} <= stood
