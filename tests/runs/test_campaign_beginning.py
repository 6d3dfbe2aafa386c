"""Before a session exists: the bench is known, safe, and has room; whatever is wrong, nothing stays switched on."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
from rehearsal import Rehearsal, tiny_plan

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


def assert_off(world: World) -> None:
    assert not world.instruments["calibrator"].operating
    assert world.wiring.closed == frozenset()


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
    worlds: list[World] = []

    def arrange(world: World) -> None:
        worlds.append(world)
        left_on(world)
        world.faults.instrument(role).mute = True

    with pytest.raises(BenchError) as caught:
        rehearse(tiny_plan(tmp_path), arrange=arrange)
    assert caught.value.code == "B-INST-001"
    assert any("B-RUN-060" in note and role in note for note in caught.value.__notes__)
    assert worlds[0].wiring.closed == frozenset()
    if role == "logger":
        assert_off(worlds[0])


def test_an_instrument_with_another_serial_number_is_refused(tmp_path: Path, rehearse: Start) -> None:
    worlds: list[World] = []

    def arrange(world: World) -> None:
        worlds.append(world)
        left_on(world)
        world.faults.instrument("calibrator").identity = "FLUKE,5720A,OTHER99,1.0"

    with pytest.raises(BenchError) as caught:
        rehearse(tiny_plan(tmp_path), arrange=arrange)
    assert caught.value.code == "B-RUN-006"
    assert "OTHER99" in caught.value.message
    assert_off(worlds[0])
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
    worlds: list[World] = []

    def refuse(*_: object, **__: object) -> SessionWriter:
        raise RecordError("B-REC-001", "cannot be written: No space left on device")

    def arrange(world: World) -> None:
        worlds.append(world)
        left_on(world)

    monkeypatch.setattr(SessionWriter, "create", refuse)
    with pytest.raises(BenchError, match="B-REC-001"):
        rehearse(tiny_plan(tmp_path), arrange=arrange)
    assert_off(worlds[0])


def test_a_session_that_cannot_be_closed_still_tells_how_the_run_ended(
    tmp_path: Path, rehearse: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> str:
        raise RecordError("B-REC-001", "cannot be written: No space left on device")

    monkeypatch.setattr(SessionWriter, "close", refuse)
    outcome = rehearse(tiny_plan(tmp_path)).run.outcome
    assert outcome.error.code == "B-RUN-061"
    assert outcome.unsafe == ()
    assert len(outcome.rows) == 15
