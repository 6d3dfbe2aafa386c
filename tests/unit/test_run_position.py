"""Where a stopped run goes on, from a journal and events of which either may have lost its end."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from run_rig import Rig

from bench.record import JournalEntry
from bench.run.position import Position, stopped_at

POINT = 4  # steps of a point: set, settle, record, verify


def plan(folder: Path, points: int = 3) -> Any:
    """A soak, points of four steps each, and a call at the end."""
    rig = Rig(folder, "calibrator", "chamber")
    rig.step("soak", "chamber", slot=60.0)
    for _ in range(points):
        first = len(rig.steps)
        rig.step("call", "calibrator", "output", current=1.0)
        rig.step("settle", duration_s=5.0)
        rig.step("record", "port_a", seconds=1.0, retry=1, max_lost=0.0, retry_step=first)
        rig.step("verify", "calibrator", "operating")
    rig.step("call", "calibrator", "output", current=0.0, phase="finally")
    rig.step("call", "calibrator", "output", current=0.0, phase="finally")
    steps = tuple(rig.steps)
    return SimpleNamespace(steps=steps, phase=lambda name: tuple(one for one in steps if one.phase == name))


def journal(stop: int) -> list[JournalEntry]:
    return [JournalEntry(number, "campaign", number, {}) for number in range(stop)]


def taken(*steps: int) -> list[tuple[str, int, Mapping[str, Any]]]:
    return [("record", 0, {"number": number, "step": step}) for number, step in enumerate(steps, 1)]


FIRST, SECOND, THIRD = 3, 7, 11  # the record steps


@pytest.mark.parametrize(
    ("done", "records", "expected"),
    [
        (0, (), Position(0, 0, ())),  # nothing was finished
        (1, (), Position(1, 0, ())),  # soaked: the first point
        (3, (), Position(1, 0, ())),  # inside the first point: from its beginning
        (4, (FIRST,), Position(1, 0, (1,))),  # recorded, not verified: again
        (5, (FIRST,), Position(5, 1, ())),  # verified: the second point
        (8, (FIRST, SECOND), Position(5, 1, (2,))),
        (9, (FIRST, SECOND), Position(9, 2, ())),
        (13, (FIRST, SECOND, THIRD), Position(13, 3, ())),  # everything measured: the end
        (14, (FIRST, SECOND, THIRD), Position(13, 3, ())),  # inside the end: from its beginning
        (15, (FIRST, SECOND, THIRD), Position(15, 3, ())),  # every step
        (9, (FIRST,), Position(5, 1, ())),  # the session lost the second record, the journal did not
        (13, (FIRST,), Position(5, 1, ())),  # and two of them
        (3, (FIRST,), Position(1, 0, (1,))),  # the journal lost the line of the record: not verified
        (3, (FIRST, SECOND), Position(5, 1, (2,))),  # the journal lost more
        (0, (FIRST,), Position(1, 0, (1,))),  # no journal at all
    ],
)
def test_position(tmp_path: Path, done: int, records: tuple[int, ...], expected: Position) -> None:
    assert stopped_at(plan(tmp_path), journal(done), taken(*records)) == expected


def test_a_record_taken_back_does_not_count(tmp_path: Path) -> None:
    events = [*taken(FIRST, SECOND), ("retake", 0, {"record": 2})]
    assert stopped_at(plan(tmp_path), journal(8), events) == Position(5, 1, ())


def test_skipped_steps_are_done(tmp_path: Path) -> None:
    events = [*taken(FIRST), ("skip", 0, {"first": 5, "stop": 9, "reason": "x"})]
    assert stopped_at(plan(tmp_path), journal(6), events) == Position(9, 1, ())
    assert stopped_at(plan(tmp_path), journal(11), events) == Position(9, 1, ())


def test_a_record_that_a_run_did_not_accept_before_it_ended_is_taken_again(tmp_path: Path) -> None:
    """No frame came: the event is written, then the run ends by itself; its journal is whole."""
    events = [*taken(FIRST, SECOND), ("end", 0, {"error": "B-RUN-021"})]
    assert stopped_at(plan(tmp_path), journal(7), events) == Position(5, 1, (2,))


def test_an_end_before_a_resume_says_nothing_about_the_journal(tmp_path: Path) -> None:
    end, begun = ("end", 0, {"error": "B-RUN-010"}), ("resume", 0, {})
    events = [*taken(FIRST), end, begun, ("record", 0, {"number": 2, "step": SECOND})]
    assert stopped_at(plan(tmp_path), journal(7), events) == Position(5, 1, (2,))


def test_windows_without_a_gap_go_on_with_the_interrupted_one(tmp_path: Path) -> None:
    rig = Rig(tmp_path, "chamber")
    for follows in (False, True, True, True):
        rig.step("record", "port_a", seconds=1.0, retry_step=0, **({"follows": True} if follows else {}))
    steps = tuple(rig.steps)
    made: Any = SimpleNamespace(steps=steps, phase=lambda name: steps)
    assert stopped_at(made, journal(2), taken(0, 1)) == Position(2, 2, ())
