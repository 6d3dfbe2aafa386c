"""A flight that was broken off: nothing of it is joined to another one, and going on flies the whole of it again."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from rehearsal import Crashes, crashed_at, go_on, nobody, watch_worlds

from bench.plan import compile_sequence
from bench.session.service import read_view
from bench.session.view import analyse_view
from sim_instruments.worlds.time_sync.unit import SyncUnit

TURN = {"warm_up": "12 s", "straight": "5 s", "manoeuvre": "6 s", "rate": "15 deg/s"}
ACCELERATION = {"warm_up": "12 s", "straight": "6 s", "manoeuvre": "6 s"}
SAR = {"warm_up": "12 s", "transit": "5 s"}


def gone_on(killed: Crashes, number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Resume a copy: all records are of one flight of units that were switched on again, and the offset is theirs."""
    source = killed.at(number)
    folder = Path(shutil.copytree(source, tmp_path / str(number) / source.name))
    watch_worlds(monkeypatch, watched := nobody())
    run = go_on(folder, watched)
    assert run.outcome.error is None
    view = read_view(folder)
    assert [row.window.number for row in view.rows] == list(range(1, killed.plan.record_count + 1))
    first = [row.window.first_counter for row in view.rows]
    assert first[1:] == [row.window.first_counter + row.window.frames for row in view.rows[:-1]]
    results, _ = analyse_view(view)
    (found,) = (
        one for one in results["estimates"]
        if one["quantity"] == "time_offset" and one["conditions"]["method"] == "augmented_loose"
    )  # fmt: skip
    units = watched.worlds[-1].unit
    assert isinstance(units, SyncUnit)
    due_s = units.powers[-1].offset_s((view.rows[0].window.t_start_ns + view.rows[-1].window.t_end_ns) // 2)
    print(f"step {number}: {1e3 * found['value']:.3f} ms, due {1e3 * due_s:.3f} ms")
    assert found["conditions"]["observable"] is True
    assert abs(found["value"] - due_s) < 3.0 * found["std_uncertainty"]
    assert not watched.worlds[-1].instruments["supply"].on


def broken_off(sequence: str, settings: dict[str, str], folder: Path, number: int) -> Crashes:
    return crashed_at(compile_sequence(sequence, None, settings), folder, {number})


def test_a_turn_that_was_broken_off_is_flown_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    killed = broken_off("time_sync_turn", TURN, tmp_path, 12)
    assert killed.plan.steps[12].conditions["phase"] == "manoeuvre"
    gone_on(killed, 12, tmp_path, monkeypatch)


@pytest.mark.sweep
@pytest.mark.parametrize("number", [7, 8, 9])
def test_an_acceleration_that_was_broken_off(number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the manoeuvre, where a person is asked, in what comes behind it."""
    gone_on(broken_off("time_sync_acceleration", ACCELERATION, tmp_path, number), number, tmp_path, monkeypatch)


@pytest.mark.sweep
@pytest.mark.parametrize("number", [13, 18, 19])
def test_a_flight_of_an_image_that_was_broken_off(number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before the turn, where the radar is to be switched on, in the aperture."""
    gone_on(broken_off("time_sync_sar", SAR, tmp_path, number), number, tmp_path, monkeypatch)
