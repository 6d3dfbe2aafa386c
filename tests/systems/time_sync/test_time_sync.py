"""Time offset through ports, frames and records, against the direct simulation; flights that were broken off."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from one_estimate import every, value
from rehearsal import Crashes, Rehearsal, crashed_at, go_on, nobody, rehearsed, watch_worlds
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from bench.analysis import analyse
from bench.analysis.estimates import Estimate, estimates_of
from bench.cli import app
from bench.model.lab import find_shipped
from bench.plan import compile_sequence
from bench.session.service import read_view
from bench.session.view import analyse_view, material_of
from bench.systems.time_sync.estimators.kalman.filter import run_filter
from bench.systems.time_sync.estimators.kalman.setup import LOOSE, TIGHT, FilterSetup, ImuSamples
from bench.systems.time_sync.image import first_pulse_s
from bench.systems.time_sync.records import recording
from sim_instruments.worlds.common.world import World
from sim_instruments.worlds.time_sync.flight.imu import exact_increments
from sim_instruments.worlds.time_sync.world import SyncUnit, SyncWorld

pytestmark = pytest.mark.usefixtures("without_pictures")

SHORT = {"warm_up": "5 s", "straight": "5 s", "manoeuvre": "6 s", "rate": "15 deg/s"}
TABLE = SHORT | {"warm_up": "30 s", "speed": "0 m/s"}
EXACT = {"world.drift_ppm": "0", "world.tag_noise_s": "0", "world.imu_clock_ppm": "0"}
METHODS = ("augmented_loose", "augmented_tight")
IMU_s, EGI_s = 0.005, 0.02


def offsets(found: Any) -> dict[str, Estimate]:
    """The time offset by every method."""
    return {entry.conditions["method"]: entry for entry in every(found, "time_offset")}


def of_session(folder: Path) -> dict[str, Estimate]:
    """The time offset of a session as it is analysed now."""
    return offsets(analyse(material_of(read_view(folder))))


def run(out: Path, sequence: str, *settings: str, seed: int = 5) -> tuple[Path, list[Estimate], float]:
    """Folder, estimates and true offset of a campaign by the command line, whatever its verdicts are."""
    words = ["run", sequence, "--seed", str(seed), "--truth", "--out", str(out)]
    result = CliRunner().invoke(app, [*words, *(word for text in settings for word in ("--set", text))])
    assert result.exit_code in (0, 1), result.output
    (folder,) = (path for path in out.iterdir() if path.is_dir())
    results, truth = (json.loads(path.read_text()) for path in (folder / "results.json", Path(f"{folder}.truth.json")))
    return folder, estimates_of(results), value(truth, "time_offset", at="middle")


def short_turn(out: Path, arrange: Callable[[World], None] | None = None) -> Rehearsal:
    """Fly a turn of 90 deg in 6 s between 5 s straight on, through ports."""
    plan = compile_sequence(find_shipped("sequences", "time_sync_turn"), None, {**SHORT, **EXACT})
    return rehearsed(out, plan, arrange)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Rehearsal:
    return short_turn(tmp_path_factory.mktemp("undisturbed"))


@pytest.fixture(scope="module")
def sound(undisturbed: Rehearsal) -> dict[str, Estimate]:
    """The time offset of the undisturbed turn."""
    return of_session(undisturbed.run.folder)


class Direct:
    """The EGI of the world without a port: true path and drawn errors at the instants of its clock."""

    def __init__(self, world: SyncWorld, begin_s: float, end_s: float) -> None:
        clock = world.units.powers[-1].egi
        solution = world.units.solutions[-1].solutions[world.flight.number]
        flight_s = solution.first_s + np.arange(len(solution.rows)) * EGI_s / clock.rate
        self.t_s = clock.start_s + (flight_s - world.flight.seconds(clock.on_ns)) * clock.rate
        keep = (self.t_s > begin_s) & (self.t_s < end_s)
        self.t_s, true, errors = self.t_s[keep], world.flight.path.state(flight_s[keep]), np.array(solution.rows)[keep]
        self._p, self._v = true.p + errors[:, :3], true.v + errors[:, 3:6]
        yaw = Rotation.from_euler("Z", true.yaw[:, None])
        self._C = (Rotation.from_rotvec(errors[:, 6:9]) * yaw).as_matrix()

    def block(self, k0: int, k1: int) -> Any:
        return tuple(np.repeat(one[k0:k1, None, None], 2, axis=1) for one in (self._p, self._v, self._C))


def direct_offsets_s(
    world: SyncWorld, first: int, count: int, hold_s: float = np.inf, near_s: float = 0.0
) -> dict[str, float]:
    """What the filter finds in the arrays of the direct simulation, on path and draws of the world.

    ``first``: number of the first sample of the IMU by its clock, which samples at whole multiples of 5 ms.
    ``hold_s``: from then on, by that clock, only the attitude is corrected.   ``near_s``: taken out of the tags first.
    """
    clock, flight = world.units.powers[-1].imu, world.flight
    number = np.arange(first - 1, first + count)
    flight_s = clock.since_on_s(number * IMU_s) + flight.seconds(clock.on_ns)
    dv, dtheta = exact_increments(flight.path, flight_s)
    drawn = flight.imu.noise(first - int(np.ceil(clock.reading_s(flight.begin_ns) / IMU_s)), count)
    dv += flight.imu.accel_bias * IMU_s + drawn[:, :3]
    dtheta += flight.imu.gyro_bias * IMU_s + drawn[:, 3:]
    t_s = number[1:] * IMU_s
    imu = ImuSamples(t_s, dv[:, None], dtheta[:, None], np.zeros(count, bool))
    setup = FilterSetup(augmented=(True, True), sigma_r=(LOOSE, TIGHT), hold_position_from_s=hold_s)
    egi = Direct(world, float(t_s[0]), float(t_s[-1]))
    egi.t_s = egi.t_s - near_s - 1e-6 * world.units.powers[-1].drift_ppm * (egi.t_s - 0.5 * (t_s[0] + t_s[-1]))
    found = run_filter(imu, egi, setup)
    return dict(zip(METHODS, (found.offset_s[-1, :, 0] + near_s).tolist(), strict=True))


def test_session_is_the_direct_simulation(undisturbed: Rehearsal, sound: dict[str, Estimate]) -> None:
    done = undisturbed
    assert isinstance(done.world, SyncWorld)
    material = material_of(read_view(done.run.folder))
    session, taken = sound, recording(material)
    first = round(int(material.rows[0].samples.columns["tick"][0]) * 1e-7 / IMU_s)
    truth = value(done.run.truth, "time_offset", at="middle")
    direct_s = direct_offsets_s(done.world, first, len(taken.imu))
    for method in METHODS:
        assert session[method].value == pytest.approx(direct_s[method], abs=5e-5)
        assert session[method].conditions["at_s"] == 8.0  # middle of 16 s; a history compares by it
        assert abs(session[method].value - truth) < 3.0 * session[method].std_uncertainty


@pytest.mark.sweep
@pytest.mark.parametrize("drift_ppm", ["0", "20"])
@pytest.mark.parametrize("offset_s", ["-0.02", "0.0137", "0.02", "0.1"])
@pytest.mark.parametrize("manoeuvre", ["turn", "acceleration", "sar"])
def test_whole_sessions_are_the_direct_simulation(
    rehearse: Callable[..., Rehearsal], manoeuvre: str, offset_s: str, drift_ppm: str
) -> None:
    """Within 0.05 ms, whatever offset and drift."""
    settings = EXACT | {"warm_up": "20 s", "world.offset_s": offset_s, "world.drift_ppm": drift_ppm}
    done = rehearse(compile_sequence(find_shipped("sequences", f"time_sync_{manoeuvre}"), None, settings))
    assert isinstance(done.world, SyncWorld)
    material = material_of(read_view(done.run.folder))
    session, taken = offsets(analyse(material)), recording(material)
    tick_s = float(material.rows[0].samples.columns["tick"][0]) * 1e-7
    hold_s = np.inf if taken.radar is None else tick_s + first_pulse_s(taken.radar) - 0.1
    near_s = 0.09 if offset_s == "0.1" else 0.0  # what the delays are apart, in steps of 10 ms: taken out beforehand
    direct_s = direct_offsets_s(done.world, round(tick_s / IMU_s), len(taken.imu), hold_s, near_s)
    for method in METHODS:
        assert session[method].value == pytest.approx(direct_s[method], abs=5e-5)


def test_a_bad_link_changes_less_than_the_interval(sound: dict[str, Estimate], tmp_path: Path) -> None:
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
        assert one.conditions["observable"] is False
        assert (one.value, one.quality) == (None, "refused")
        assert [reason.code for reason in one.reasons] == ["not_observable"]
    intervals_s = [one.value for one in found if one.quantity == "time_offset_uncertainty"]
    assert min(intervals_s) > 1.95 * 0.03  # what was assumed beforehand


@pytest.mark.slow
def test_table_in_a_laboratory_and_replay(tmp_path: Path) -> None:
    """Nothing flies; the turn of the table shows the offset by the attitude. Replayed, every number is the same."""
    folder, found, due = run(tmp_path, "time_sync_turn", *(f"{k}={v}" for k, v in TABLE.items()))
    one = offsets(found)["augmented_tight"]
    assert one.conditions["observable"] is True
    assert abs(one.value - due) < 3.0 * one.std_uncertainty
    again = CliRunner().invoke(app, ["replay", str(folder)])
    assert again.exit_code in (0, 1)
    assert "identical" in again.output


TURN = {"warm_up": "12 s", "straight": "5 s", "manoeuvre": "6 s", "rate": "15 deg/s"}
ACCELERATION = {"warm_up": "12 s", "straight": "6 s", "manoeuvre": "6 s"}
SAR = {"warm_up": "12 s", "transit": "5 s"}


def gone_on(killed: Crashes, number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Resume a copy: all records are of one flight of units that were switched on again, and the offset is theirs."""
    source = killed.at(number)
    folder = Path(shutil.copytree(source, tmp_path / str(number) / source.name))
    watch_worlds(monkeypatch, watched := nobody())
    assert go_on(folder, watched).outcome.error is None
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


@pytest.mark.parametrize(
    ("name", "settings", "number"),
    [
        ("turn", TURN, 12),
        *(pytest.param("acceleration", ACCELERATION, number, marks=pytest.mark.sweep) for number in (7, 8, 9)),
        *(pytest.param("sar", SAR, number, marks=pytest.mark.sweep) for number in (13, 18, 19)),
    ],
)
def test_a_flight_that_was_broken_off_is_flown_again(
    name: str, settings: dict[str, str], number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a manoeuvre, where a person is asked, behind it; before the turn, the radar and in the aperture."""
    killed = crashed_at(compile_sequence(f"time_sync_{name}", None, settings), tmp_path, {number})
    assert name != "turn" or killed.plan.steps[12].conditions["phase"] == "manoeuvre"
    gone_on(killed, number, tmp_path, monkeypatch)
