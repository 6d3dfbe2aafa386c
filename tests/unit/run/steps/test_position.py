"""Where a stopped run goes on, from a journal and events of which either may have lost its end."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from run_rig import Rig

from bench.model.events import Event, Resume, Retake, Skip, event_of
from bench.plan.station import driver_actions
from bench.record import JournalEntry
from bench.run.position import Position, in_point, point_start, point_stop, readings_of, stopped_at


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
    return plan_of(rig)


def plan_of(rig: Rig) -> Any:
    steps = tuple(rig.steps)
    drivers = {"calibrator": "fluke_5720a", "supply": "hp_6632b", "chamber": "thermotron_3800"}
    instruments = {role: SimpleNamespace(driver=driver) for role, driver in drivers.items()}
    station = SimpleNamespace(instruments=instruments)
    return SimpleNamespace(
        steps=steps, station=station, phase=lambda name: tuple(one for one in steps if one.phase == name)
    )


def journal(stop: int) -> list[JournalEntry]:
    return [JournalEntry(number, "campaign", number, {}) for number in range(stop)]


def taken(*steps: int) -> list[Event]:
    return [event_of("record", {"number": number, "step": step}) for number, step in enumerate(steps, 1)]


FIRST, SECOND, THIRD = 3, 7, 11  # the record steps
BOTH = taken(FIRST, SECOND)
SKIPPED: list[Event] = [*taken(FIRST), Skip(first=5, stop=9, reason="x", by="kim")]
RESUMED: list[Event] = [BOTH[0], event_of("end", {"error": "B-RUN-010"}), Resume(reason="x"), BOTH[1]]


@pytest.mark.parametrize(
    ("done", "events", "expected"),
    [
        (0, taken(), Position(0, 0, ())),  # nothing was finished
        (1, taken(), Position(1, 0, ())),  # soaked: the first point
        (3, taken(), Position(1, 0, ())),  # inside the first point: from its beginning
        (4, taken(FIRST), Position(1, 0, (1,))),  # recorded, not verified: again
        (5, taken(FIRST), Position(5, 1, ())),  # verified: the second point
        (8, taken(FIRST, SECOND), Position(5, 1, (2,))),
        (9, taken(FIRST, SECOND), Position(9, 2, ())),
        (13, taken(FIRST, SECOND, THIRD), Position(13, 3, ())),  # everything measured: the end
        (14, taken(FIRST, SECOND, THIRD), Position(13, 3, ())),  # inside the end: from its beginning
        (15, taken(FIRST, SECOND, THIRD), Position(15, 3, ())),  # every step
        (9, taken(FIRST), Position(5, 1, ())),  # the session lost the second record, the journal did not
        (13, taken(FIRST), Position(5, 1, ())),  # and two of them
        (3, taken(FIRST), Position(1, 0, (1,))),  # the journal lost the line of the record: not verified
        (3, taken(FIRST, SECOND), Position(5, 1, (2,))),  # the journal lost more
        (0, taken(FIRST), Position(1, 0, (1,))),  # no journal at all
        (8, [*BOTH, Retake(record=2, reason="x")], Position(5, 1, ())),  # a record taken back does not count
        (6, SKIPPED, Position(9, 1, ())),  # skipped steps are done
        (11, SKIPPED, Position(9, 1, ())),
        (7, [*BOTH, event_of("end", {"error": "B-RUN-021"})], Position(5, 1, (2,))),  # no frame came: not accepted
        (7, RESUMED, Position(5, 1, (2,))),  # an end before a resume says nothing about the journal
        (9, [*BOTH, event_of("end", {"error": None})], Position(15, 2, ())),
        (9, [*BOTH, event_of("end", {})], Position(9, 2, ())),  # it does not say that there was no error
    ],
)
def test_position(tmp_path: Path, done: int, events: list[Event], expected: Position) -> None:
    assert stopped_at(plan(tmp_path), journal(done), events) == expected


def two_units(folder: Path) -> Any:
    """Of each of two units a prompt (0, 7), its supply (1 to 3, 8 to 10) and three tests (4 to 6, 11 to 13)."""
    rig = Rig(folder, "supply")
    for unit in ("A", "B"):
        rig.step("prompt", text=f"put in {unit}", sets={"unit": unit})
        rig.step("call", "supply", "output_on")
        rig.step("call", "supply", "measure_voltage")
        rig.step("call", "supply", "measure_current")
        for item in ("cpu", "memory", "memory"):
            rig.step("unit", "rs422", item, conditions={"unit": unit}, command=16, payload=(), item=item)
    return plan_of(rig)


def noted(stop: int) -> list[Event]:
    """What the steps before ``stop`` have noted in the session."""
    kinds = {0: "prompt", 2: "reading", 3: "reading", 4: "exchange", 5: "exchange", 6: "exchange"}
    return [event_of(kinds[number % 7], {"step": number}) for number in range(stop) if number % 7 in kinds]


@pytest.mark.parametrize(
    ("done", "in_session", "start"),
    [
        (5, 5, 5),  # nothing is lost: the next item
        (6, 6, 5),  # inside an item: from its beginning
        (13, 13, 12),
        (7, 7, 7),  # behind an item
        (11, 11, 11),  # the first test of the second unit is no test of the item before
        (5, 4, 4),  # the journal has a test that the session has lost
        (7, 5, 5),  # and two of them
        (6, 3, 3),  # and a reading
        (8, 7, 7),  # and what a person has said
        (9, 7, 7),
        (9, 8, 9),  # the supply is switched on again anyway
    ],
)
def test_what_the_session_has_lost_is_done_again(tmp_path: Path, done: int, in_session: int, start: int) -> None:
    assert stopped_at(two_units(tmp_path), journal(done), noted(in_session)) == Position(start, 0, ())


@pytest.mark.parametrize(
    "step", [("send", "supply", {"text": "*IDN?"}), ("unit", "port_b", {"command": 1, "payload": ()})]
)
def test_a_reply_of_which_something_is_expected_and_that_is_lost_is_asked_for_again(tmp_path: Path, step: Any) -> None:
    kind, role, arguments = step
    for expected in (True, False):
        rig = Rig(tmp_path)
        rig.step(kind, role, "x", conditions={"quantity": "version"} if expected else {}, **arguments)
        rig.step("settle", duration_s=1.0)
        assert stopped_at(plan_of(rig), journal(2), []) == Position(0 if expected else 2, 0, ())


def test_a_test_of_a_skipped_stretch_is_not_missed(tmp_path: Path) -> None:
    events = [*noted(4), Skip(first=4, stop=7, reason="x", by="kim")]
    assert stopped_at(two_units(tmp_path), journal(4), events) == Position(7, 0, ())


def test_windows_without_a_gap_go_on_with_the_interrupted_one(tmp_path: Path) -> None:
    rig = Rig(tmp_path, "chamber")
    for follows in (False, True, True, True):
        rig.step("record", "port_a", seconds=1.0, retry_step=0, **({"follows": True} if follows else {}))
    assert stopped_at(plan_of(rig), journal(2), taken(0, 1)) == Position(2, 2, ())


def test_a_recording_with_acts_of_a_person_begins_anew_with_what_was_asked_before_it(tmp_path: Path) -> None:
    """Half a flight is none: whoever stopped in it, or between its records, is asked for the whole of it again."""
    rig = Rig(tmp_path)
    for text, follows in (("fly", False), ("accelerate", True), ("no more", True)):
        rig.step("prompt", text=text, sets={"x": text})
        rig.step("record", "imu", seconds=1.0, retry_step=0, **({"follows": True} if follows else {}))
    rig.step("prompt", text="radar off", sets={"radar": "off"})
    rig.step("prompt", text="another vehicle", sets={"x": 0})
    rig.step("record", "imu", seconds=1.0, retry_step=7)
    assert [point_start(rig.steps, index) for index in range(9)] == [0, 0, 0, 0, 0, 0, 6, 7, 7]


def north(folder: Path) -> Any:
    """Points as those of the north finder: set, settle, record, two readings; then a reading before the next point."""
    rig = Rig(folder)
    for _ in range(2):
        rig.step("call", "level", "measure")
        first = len(rig.steps)
        rig.step("call", "lock_in_1", "set_phase", phase=0.0)
        rig.step("settle", duration_s=5.0)
        rig.step("record", "fog", seconds=1.0, retry=0, max_lost=0.0, retry_step=first)
        rig.step("call", "lock_in_1", "measure")
        rig.step("verify", "lock_in_1", "locked")
        rig.step("call", "lock_in_2", "measure")
    steps = tuple(rig.steps)
    drivers = {"level": "leica_nivel_220", "lock_in_1": "srs_sr830", "lock_in_2": "srs_sr830"}
    station = SimpleNamespace(instruments={role: SimpleNamespace(driver=driver) for role, driver in drivers.items()})
    return SimpleNamespace(steps=steps, station=station, phase=lambda _: steps)


def test_readings_right_behind_a_record_belong_to_its_point(tmp_path: Path) -> None:
    """After a hold between them the lock-in amplifiers would be read when their table has only just come to speed."""
    steps = north(tmp_path).steps
    readings = readings_of(steps, {role: driver_actions("srs_sr830") for role in ("lock_in_1", "lock_in_2")})
    assert readings == {4, 6, 11, 13}
    assert [point_start(steps, index, readings) for index in range(8)] == [0, 1, 1, 1, 1, 1, 1, 7]
    assert [in_point(steps, index, readings) for index in range(8)] == [False, *[True] * 6, False]
    assert [point_stop(steps, index, readings) for index in range(1, 7)] == [7] * 6
    assert point_start(steps, 7, readings | {0, 7}) == 1  # the level is read with it, as far as anybody can tell


def test_a_reading_that_begins_the_next_point_does_not_belong_to_the_record_before_it(tmp_path: Path) -> None:
    steps = [one if one.kind != "record" else replace(one, retry_step=one.number - 3) for one in north(tmp_path).steps]
    readings = frozenset({0, 4, 6, 7, 11, 13})
    assert [point_start(steps, index, readings) for index in (4, 6, 7, 8)] == [0, 0, 7, 7]
    assert point_stop(steps, 2, readings) == 7


@pytest.mark.parametrize("done", [4, 5, 6])
def test_a_run_that_stopped_before_the_readings_of_its_record_takes_the_record_again(tmp_path: Path, done: int) -> None:
    events = [*taken(3), *(event_of("reading", {"step": step}) for step in (0, 4) if step < done)]
    stopped = [*events, event_of("end", {"error": "B-RUN-001"})]
    assert stopped_at(north(tmp_path), journal(done), stopped) == Position(1, 0, (1,))
