"""Before a session exists: the bench is known, safe, and has room; whatever is wrong, nothing stays switched on."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rehearsal import Rehearsal, Watched, tiny_plan

from bench.model.errors import BenchError
from bench.record import RecordError, SessionWriter
from sim_instruments.worlds.common.world import World

Start = Callable[..., Rehearsal]


def left_on(world: World) -> None:
    """As after a controller that was killed: 100 mA through channel 1."""
    switch, calibrator = world.instruments["switch"], world.instruments["calibrator"]
    switch.execute(":CLOS (@1!1!1)")
    for text in ("OUT 1.0E-01 A, 0 HZ", "OPER"):
        calibrator.execute(text)
    assert calibrator.operating


def refused(tmp_path: Path, rehearse: Start, change: Callable[[World], object]) -> tuple[BenchError, World]:
    """Return why a run does not begin on a bench that was left on and changed, and its world."""
    watched = Watched()
    with pytest.raises(BenchError) as caught:
        rehearse(tiny_plan(tmp_path), arrange=lambda world: (left_on(world), change(world)), watched=watched)
    world = watched.worlds[0]
    assert world.wiring.closed == frozenset()
    return caught.value, world


def no_space(*_: object, **__: object) -> Any:
    raise RecordError("B-REC-001", "cannot be written: No space left on device")


def test_a_bench_that_was_left_on_is_made_safe_before_the_first_prompt(tmp_path: Path, rehearse: Start) -> None:
    seen: list[bool] = []
    found = rehearse(
        tiny_plan(tmp_path),
        arrange=left_on,
        act=lambda world, step: seen.append(bool(world.instruments["calibrator"].operating)),
    )
    assert found.run.outcome.error is None
    assert seen[0] is False


@pytest.mark.parametrize("role", ["logger", "calibrator"])
def test_a_silent_instrument_at_the_start_leaves_nothing_on(tmp_path: Path, rehearse: Start, role: str) -> None:
    error, world = refused(tmp_path, rehearse, lambda world: setattr(world.faults.instrument(role), "mute", True))
    assert error.code == "B-INST-001"
    assert any("B-RUN-060" in note and role in note for note in error.__notes__)
    assert role == "calibrator" or not world.instruments["calibrator"].operating


def test_an_instrument_with_another_serial_number_is_refused(tmp_path: Path, rehearse: Start) -> None:
    def other(world: World) -> None:
        world.faults.instrument("calibrator").identity = "FLUKE,5720A,OTHER99,1.0"

    error, world = refused(tmp_path, rehearse, other)
    assert error.code == "B-RUN-006"
    assert "OTHER99" in error.message
    assert not world.instruments["calibrator"].operating
    assert not (tmp_path / "out").exists()


def test_a_disk_without_room_is_refused_before_anything_is_opened(
    tmp_path: Path, rehearse: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda place: SimpleNamespace(free=1_000_000))
    with pytest.raises(BenchError, match="B-RUN-005"):
        rehearse(tiny_plan(tmp_path), arrange=lambda world: pytest.fail("the bench was opened"))


def test_a_session_that_cannot_be_created_leaves_nothing_on(
    tmp_path: Path, rehearse: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SessionWriter, "create", no_space)
    error, world = refused(tmp_path, rehearse, lambda world: None)
    assert error.code == "B-REC-001"
    assert not world.instruments["calibrator"].operating


def test_a_session_that_cannot_be_closed_still_tells_how_the_run_ended(
    tmp_path: Path, rehearse: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SessionWriter, "close", no_space)
    outcome = rehearse(tiny_plan(tmp_path)).run.outcome
    assert outcome.error.code == "B-RUN-061"
    assert outcome.unsafe == ()
    assert len(outcome.rows) == 15
