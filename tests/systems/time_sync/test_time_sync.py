"""Time offset through ports, frames and records: against the simulated truth, with a bad link, on a table at rest."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from one_estimate import every, value
from rehearsal import Rehearsal, rehearsed
from typer.testing import CliRunner

from bench.analysis import analyse
from bench.cli import app
from bench.model.shipped import find_shipped
from bench.plan import compile_sequence
from bench.session.service import read_view
from bench.session.view import material_of
from sim_instruments.worlds.common.world import World

SHORT = {"warm_up": "5 s", "straight": "5 s", "manoeuvre": "6 s", "rate": "15 deg/s"}
TABLE = SHORT | {"warm_up": "30 s", "speed": "0 m/s"}
EXACT = {"world.drift_ppm": "0", "world.tag_noise_s": "0", "world.imu_clock_ppm": "0"}
METHODS = ("augmented_loose", "augmented_tight")


def offsets(found: Any) -> dict[str, dict[str, Any]]:
    """The time offset by every method."""
    return {entry.conditions["method"]: entry for entry in every(found, "time_offset")}


def of_session(folder: Path) -> dict[str, dict[str, Any]]:
    """The time offset of a session as it is analysed now."""
    return offsets(analyse(material_of(read_view(folder))))


def run(out: Path, sequence: str, *settings: str, seed: int = 5) -> tuple[Path, list[dict[str, Any]], float]:
    """Folder, estimates and true offset of a campaign by the command line, whatever its verdicts are."""
    words = ["run", sequence, "--seed", str(seed), "--truth", "--out", str(out)]
    result = CliRunner().invoke(app, [*words, *(word for text in settings for word in ("--set", text))])
    assert result.exit_code in (0, 1), result.output
    (folder,) = (path for path in out.iterdir() if path.is_dir())
    found, truth = (
        json.loads(path.read_text())["estimates"] for path in (folder / "results.json", Path(f"{folder}.truth.json"))
    )
    return folder, found, value(truth, "time_offset", at="middle")


def short_turn(out: Path, arrange: Callable[[World], None] | None = None) -> Rehearsal:
    """Fly a turn of 90 deg in 6 s between 5 s straight on, through ports."""
    plan = compile_sequence(find_shipped("sequences", "time_sync_turn"), None, {**SHORT, **EXACT})
    return rehearsed(out, plan, arrange)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Rehearsal:
    return short_turn(tmp_path_factory.mktemp("undisturbed"))


@pytest.fixture(scope="module")
def sound(undisturbed: Rehearsal) -> dict[str, dict[str, Any]]:
    """The time offset of the undisturbed turn."""
    return of_session(undisturbed.run.folder)


def test_a_session_gives_the_offset_of_the_world(undisturbed: Rehearsal, sound: dict[str, dict[str, Any]]) -> None:
    truth = value(undisturbed.run.truth, "time_offset", at="middle")
    for entry in sound.values():
        assert entry.conditions["at_s"] == 8.0  # middle of 16 s; a history compares by it
        assert abs(entry.value - truth) < 3.0 * entry.std_uncertainty


@pytest.mark.sweep
@pytest.mark.parametrize("drift_ppm", ["0", "20"])
@pytest.mark.parametrize("offset_s", ["-0.02", "0.0137", "0.02", "0.1"])
@pytest.mark.parametrize("manoeuvre", ["turn", "acceleration", "sar"])
def test_whole_sessions_give_the_offset_of_the_world(
    manoeuvre: str, offset_s: str, drift_ppm: str, tmp_path: Path
) -> None:
    """Whatever offset and drift; how often intervals hold it is told by the rows of tests/coverage."""
    words = ("warm_up=20 s", f"world.offset_s={offset_s}", f"world.drift_ppm={drift_ppm}")
    _, found, due = run(tmp_path, f"time_sync_{manoeuvre}", *words)
    for entry in offsets(found).values():
        assert abs(entry["value"] - due) < 3.0 * entry["std_uncertainty"]


def test_a_bad_link_changes_less_than_the_interval(sound: dict[str, dict[str, Any]], tmp_path: Path) -> None:
    """One frame in a hundred dropped and one damaged, on both ports."""

    def spoil(world: World) -> None:
        for link, frame_bytes in (("imu", 46), ("egi", 98)):
            faults = world.faults.link(link)
            faults.drop_rate, faults.bit_error_rate = 0.01, 0.01 / (8 * frame_bytes)

    bad = of_session(short_turn(tmp_path, spoil).run.folder)
    for method in METHODS:
        assert bad[method].dropped > sound[method].dropped == 0
        assert abs(bad[method].value - sound[method].value) < sound[method].expanded_uncertainty


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sequence", "time"),
    [
        ("time_sync_linear", "16 s"),
        pytest.param("time_sync_linear", "60 s", marks=pytest.mark.sweep),
        pytest.param("time_sync_stationary", "60 s", marks=pytest.mark.sweep),
    ],
)
def test_what_the_motion_does_not_show_is_no_result(sequence: str, time: str, tmp_path: Path) -> None:
    _, found, _ = run(tmp_path, sequence, "warm_up=1 s", f"time={time}")
    for one in offsets(found).values():
        assert one["conditions"]["observable"] is False
        assert (one["value"], one["quality"]) == (None, "refused")
        assert [reason["code"] for reason in one["reasons"]] == ["not_observable"]
    intervals_s = [one["value"] for one in found if one["quantity"] == "time_offset_uncertainty"]
    assert min(intervals_s) > 1.95 * 0.03  # what was assumed beforehand


@pytest.mark.slow
def test_table_in_a_laboratory_and_replay(tmp_path: Path) -> None:
    """Nothing flies; the turn of the table shows the offset by the attitude. Replayed, every number is the same."""
    folder, found, due = run(tmp_path, "time_sync_turn", *(f"{k}={v}" for k, v in TABLE.items()))
    one = offsets(found)["augmented_tight"]
    assert one["conditions"]["observable"] is True
    assert abs(one["value"] - due) < 3.0 * one["std_uncertainty"]
    again = CliRunner().invoke(app, ["replay", str(folder)])
    assert again.exit_code in (0, 1)
    assert "identical" in again.output


@pytest.mark.sweep
def test_image_of_a_session_is_where_the_offset_puts_it(tmp_path: Path) -> None:
    """Not compensated: behind by 1.00 to 1.15 times speed times offset; compensated: in place.

    How sharp one flight's image is depends on its drawn errors of tilt; the study judges that by the mean of 50.
    """
    _, found, due_s = run(tmp_path, "time_sync_sar", "warm_up=20 s", "world.offset_s=0.02")
    shift_m = every(found, "image_shift")[0]["value"]
    assert -1.15 < shift_m / (250.0 * due_s) < -1.0
    assert abs(offsets(found)["augmented_tight"]["value"] - due_s) * 250.0 < 0.25
