"""Time offset from recordings of ``sync_physics``: value, interval, what may lack; the track on the ellipsoid."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from one_estimate import every, one, value
from spoken import english_left
from sync_physics import DRIFT, IMU_CLOCK, STRAIGHT, OFFSET_s, Path, Recording, on_the_ellipsoid, part

from bench.analysis import Analysis, Figure, Floats, Material, Series, analyse, with_uncertainty
from bench.analysis.doubt import stated, weigh
from bench.maths.geodesy import TangentFrame
from bench.model.errors import BenchError
from bench.report.plots.graphs import analysis_pictures
from bench.systems.time_sync import analysis as time_sync_tables
from bench.systems.time_sync.analysis import METHODS
from bench.systems.time_sync.declaration import DECLARATION
from bench.systems.time_sync.estimators.kalman.setup import EgiSamples, EgiSpread
from bench.systems.time_sync.estimators.sar.image import point_targets
from bench.systems.time_sync.estimators.sar.pulses import Pulses
from bench.systems.time_sync.filtering import COMPENSATED, trajectory_figures
from bench.systems.time_sync.limits import SPECIFIED_s, demands_of, densities_of, latency_of, spread_of
from bench.systems.time_sync.records import Stream, recording
from bench.systems.time_sync.samples import prepared


@cache
def analysed(**kinds: Any) -> Analysis:
    """Result of one drive with other clocks or links."""
    return analyse(Recording(1, **kinds).material())


def test_offset_clocks_and_verdicts() -> None:
    found = analysed()
    against = weigh(found.evidence).against
    for method, row in zip(METHODS, found.tables[0].rows, strict=False):
        entry = one(found, "time_offset", method=method)
        assert abs(entry.value - OFFSET_s) < 3.0 * entry.std_uncertainty
        assert entry.std_uncertainty < 2e-3
        assert entry.conditions["observable"] is True
        assert stated(entry, against).quality == "sound"
        assert row[1] == with_uncertainty(1e3 * entry.value, 1e3 * entry.expanded_uncertainty)
    stamps, drift = one(found, "time_offset_from_stamps"), one(found, "time_offset_drift")
    assert stamps.value == pytest.approx(OFFSET_s, abs=2e-4)  # latencies are as stated
    assert stamps.std_uncertainty == pytest.approx(np.sqrt(2.0) * 1e-3, rel=0.02)
    assert drift.value == pytest.approx(1e6 * DRIFT, abs=3.0 * drift.std_uncertainty)
    assert drift.std_uncertainty < 10.0
    rate = one(found, "clock_rate", link="imu")
    assert rate.value == pytest.approx(1e6 * IMU_CLOCK, abs=3.0 * rate.std_uncertainty)
    assert one(found, "stamps_difference").verdict == "pass"
    assert one(found, "time_offset_uncertainty", method=METHODS[0]).limit == 2e-3
    assert one(found, "time_offset_uncertainty", method=METHODS[1]).verdict == "none"
    assert found.missing == []
    assert english_left(found) == set()
    assert all("nan" not in picture.svg.lower() for picture in analysis_pictures(found.figures))
    again = analyse(Recording(1).material())
    assert (again.estimates, again.tables) == (found.estimates, found.tables)  # the same bytes


@pytest.mark.parametrize("offset_s", [-0.0213, pytest.param(0.42, marks=pytest.mark.sweep)])
def test_sound_recording_gives_the_offset_to_a_tenth_of_a_millisecond(offset_s: float) -> None:
    """Without errors nothing but the arithmetic is left: geodesy, ticks, drift, filter; a fraction of a sample old."""
    found = analysed(noise=False, offset_s=offset_s, imu_s=0.005, egi_s=0.02)
    for method in METHODS:
        limit_s = 5e-5 if method == "augmented_tight" and offset_s > 0.1 else 1e-4
        assert value(found, "time_offset", method=method) == pytest.approx(offset_s, abs=limit_s)


def test_clocks_of_any_epoch() -> None:
    """One clock passes through 2^64, the other began a day before: the same offset, on top of the day."""
    day_s = 86_400.0
    found = analysed(first_tick=2**64 - 100_000_000, epoch_s=day_s)
    near = one(analysed(), "time_offset", method="augmented_tight")
    far = one(found, "time_offset", method="augmented_tight")
    assert far.value - day_s == pytest.approx(near.value, abs=1e-4)
    assert value(found, "time_offset_from_stamps") == pytest.approx(day_s + OFFSET_s, abs=2e-4)
    assert any("began" in note for note in found.notes)


def test_straight_flight_and_rest_are_no_result() -> None:
    """An offset that the motion does not show keeps the interval of what was assumed, and says so."""
    for path in (STRAIGHT, Path(speed_m_s=0.0, turn_s=(0.0, 0.0))):
        found = analysed(path=path)
        against = weigh(found.evidence).against
        for method in METHODS:
            entry = one(found, "time_offset", method=method)
            assert entry.conditions["observable"] is False
            assert entry.std_uncertainty >= 0.03
            assert value(found, "observability", method=method, of="variance of the offset") > 0.5
            assert stated(entry, against).value is None
            assert [reason.code for reason in stated(entry, against).reasons] == ["not_observable"]
        assert one(found, "time_offset_uncertainty", method=METHODS[0]).verdict == "fail"
        assert every(found, "stamps_difference") == []
    wide = {"limits": {"time_offset_uncertainty": {"value": 1.0, "unit": "s"}}}
    found = analyse(Recording(1, path=STRAIGHT).material(**wide))
    assert one(found, "time_offset_uncertainty", method=METHODS[0]).verdict == "none"  # it keeps no limit


def test_a_steady_turn_from_begin_to_end_is_no_confident_result() -> None:
    """A late solution in it looks like another heading at the begin: whoever is sure of that one is sure of zero."""
    found = analysed(path=Path(turn_s=(-1.0, 30.0)))
    for entry in every(found, "time_offset"):
        assert abs(entry.value - OFFSET_s) < 2.0 * entry.std_uncertainty
    assert one(found, "time_offset", method=METHODS[0]).conditions["observable"] is False


@pytest.mark.parametrize("beforehand_s", [0.0, 86_400.0])
def test_shift_that_is_due_is_that_of_the_offset_left_in_the_tags(beforehand_s: float) -> None:
    """Clocks that began a day apart do not shift an image by the way of a day: that is out of the tags of both."""
    left = SimpleNamespace(offsets={COMPENSATED: SimpleNamespace(offset_s=beforehand_s + 0.01)}, shift_s=beforehand_s)
    image: Any = SimpleNamespace(compensated=[], plain=[], pulses=9000, speed_m_s=250.0, shifts_m=np.zeros(0))
    result: Any = SimpleNamespace(found=left, image=image, chosen=SimpleNamespace(offset_s=beforehand_s + 0.01))
    assert "-2.500 m" in time_sync_tables._image(image, result).caption


def test_lost_increments_are_filled_and_told() -> None:
    ready, sound = (prepared(recording(Recording(1, imu_s=0.005, loss=loss).material())) for loss in (0.01, 0.0))
    assert ready.filled == np.count_nonzero(ready.imu.filled) > 20
    assert ready.imu.t_s.size == sound.imu.t_s.size
    assert np.abs(ready.imu.t_s - sound.imu.t_s).max() < 2e-6
    off_rad = np.abs(ready.imu.dtheta - sound.imu.dtheta)[ready.imu.filled]
    assert np.median(off_rad) < 1e-5
    assert off_rad.max() < 5e-4  # a sample across the begin of the turn


def test_without_latencies_the_stamps_tell_the_drift_only() -> None:
    found = analyse(Recording(1).material(latency=None))
    assert every(found, "time_offset_from_stamps") == every(found, "stamps_difference") == []
    assert one(found, "time_offset_drift").n > 200
    assert any("No latencies are stated" in note for note in found.notes)


FRAME = TangentFrame(37.5, 126.95)
T_s = 7.0 + 0.02 * np.arange(25_000)  # 500 s at 50 Hz
SPEED_m_s, HEIGHT_m = 250.0, 3000.0


def samples(p: Floats) -> EgiSamples:
    shape = (len(p), 3, 3)
    return EgiSamples(T_s[: len(p)], p, np.zeros_like(p), np.broadcast_to(np.eye(3), shape), FRAME, 1.0)


def flight() -> EgiSamples:
    """North at one height over the ellipsoid, along a meridian: 125 km, which leaves the tangent plane by 1.2 km."""
    along_deg = np.degrees(SPEED_m_s * (T_s - T_s[0]) / 6_360_000.0)
    return samples(FRAME.positions_m(37.5 + along_deg, np.full(T_s.size, 126.95), np.full(T_s.size, HEIGHT_m)))


def series_of(figure: Figure, label: str) -> Series:
    (found,) = [series for series in figure.series if series.label == label]
    return found


def test_a_height_is_that_over_the_ellipsoid_and_not_that_over_the_plane() -> None:
    egi = flight()
    track, height = trajectory_figures(egi, None)
    assert -egi.p[-1, 2] - HEIGHT_m == pytest.approx(-1228.0, abs=5.0)  # d^2 / 2R
    assert np.abs(np.array(series_of(height, "height").y) - HEIGHT_m).max() < 1e-3
    assert track.equal
    noise_m = np.random.default_rng(3).normal(0.0, 1.0, (T_s.size, 3))
    assert trajectory_figures(samples(noise_m), None) == []  # a table in a laboratory flies nowhere


@pytest.mark.parametrize("point_m", [(0.0, 0.0, 0.0), (60_000.0, -80_000.0, -2500.0), (-9e4, 4e4, 300.0)])
def test_heights_are_those_of_another_way_down_to_the_ellipsoid(point_m: tuple[float, float, float]) -> None:
    point = np.array([point_m])
    assert FRAME.heights_m(point) == pytest.approx(on_the_ellipsoid(point)[2], abs=1e-5)


def test_times_start_end_and_the_image_stand_on_the_track() -> None:
    pulses = np.linspace(T_s[0] + 490.0, T_s[-1], 100)
    radar = Stream(pulses, np.arange(100), np.arange(100), {})
    track, _ = trajectory_figures(flight(), radar)
    marks = np.array(series_of(track, "each 60 s").y)
    assert marks == pytest.approx(1e-3 * SPEED_m_s * 60.0 * np.arange(1, 9), rel=2e-3)
    assert series_of(track, "start").y == [pytest.approx(0.0, abs=1e-9)]
    assert series_of(track, "end").y[0] == pytest.approx(125.0, rel=3e-3)
    imaged = np.array(series_of(track, "radar image").y)
    assert (imaged[-1] - imaged[0]) == pytest.approx(1e-3 * SPEED_m_s * 10.0, rel=5e-3)


STATED = {
    "accel_bias_g": 2e-4, "velocity_walk_g_rtHz": 2e-5, "gyro_bias_deg_s": 1 / 3600, "angle_walk_deg_rth": 0.07,
}  # fmt: skip
EGI = {"velocity_m_s": 0.05, "level_deg": 0.01, "heading_deg": 0.1, "wander_s": 9.0, "heading_wander_s": 8.0}


@cache
def recorded(duration_s: float) -> Material:
    """Straight flight in two records."""
    return Recording(1, path=STRAIGHT, long_s=duration_s, imu_s=0.005, egi_s=0.02, records=2).material()


def material(edit: Any = None, duration_s: float = 17.0) -> Material:
    """A recording whose rows are edited."""
    found = recorded(duration_s)
    return found if edit is None else replace(found, rows=[edit(row) for row in found.rows])


def without_angles(row: Any) -> Any:
    columns = {name: column for name, column in row.samples.columns.items() if name != "delta_angle"}
    return replace(row, samples=replace(row.samples, columns=columns))


def early(row: Any) -> Any:
    """The EGI is there for the first 4.5 s only."""
    egi = row.beside["egi"]
    keep = egi.t_ns < egi.t_ns[0] + 4_500_000_000 if row.window.number == 1 else np.zeros(len(egi), bool)
    return replace(row, beside={"egi": part(egi, keep)})


def clock_set(link: str) -> Any:
    """The clock of a unit is set in the middle of the second record."""

    def edit(row: Any) -> Any:
        samples = row.samples if link == "imu" else row.beside["egi"]
        tick = samples.columns["tick"].copy()
        tick[len(tick) // 2 :] -= np.uint64(30_000_000 if row.window.number == 2 else 0)
        moved = replace(samples, columns={**samples.columns, "tick": tick})
        return replace(row, samples=moved) if link == "imu" else replace(row, beside={"egi": moved})

    return edit


def holes(*at: int, width: int = 60) -> Any:
    """What takes samples of the inertial unit out of a row, by counter from 70 000 on."""

    def edit(row: Any) -> Any:
        since = row.samples.counter[:, None] - 70_000 - np.array(at)
        return replace(row, samples=part(row.samples, ~((since >= 0) & (since < width)).any(axis=1)))

    return edit


def begun_anew(row: Any) -> Any:
    """The EGI is somewhere else at once in the middle; no interval covers what a filter makes of it."""
    egi = row.beside["egi"]
    north = egi.columns["latitude"] - 0.02 * (np.arange(len(egi)) + (row.window.number == 2) * 1e4 > 300)
    return replace(row, beside={"egi": replace(egi, columns={**egi.columns, "latitude": north})})


def not_navigating(row: Any) -> Any:
    egi = row.beside["egi"]
    return replace(row, beside={"egi": replace(egi, columns={**egi.columns, "mode": 0 * egi.columns["mode"]})})


@pytest.mark.parametrize(
    ("edit", "duration_s", "said"),
    [
        (lambda row: replace(row, samples=None), 17.0, "B-SYNC-001"),
        (lambda row: replace(row, beside={}), 17.0, "B-SYNC-002.*'egi'"),
        (without_angles, 17.0, "B-SYNC-002.*delta_angle"),
        (None, 9.0, "B-SYNC-003.*9.0 s"),
        (early, 17.0, "B-SYNC-003"),
        (clock_set("imu"), 17.0, "B-SYNC-004.*'imu'.*12[.]"),  # seconds behind the first frame
        (clock_set("egi"), 17.0, "B-SYNC-004.*'egi'.*12[.]"),
        (holes(900, 1800, 2700, 3300), 20.0, "B-SYNC-007.*60 samples of the inertial unit are missing 4.495 s after"),
        (holes(1800), 17.0, "B-SYNC-007.*are missing 8.995 s after the first"),  # not named as too short: it was not
        (begun_anew, 17.0, "B-SYNC-011.*do not fit one motion"),
        (not_navigating, 17.0, r"B-SYNC-008.*0 of 840 solutions"),
    ],
)
def test_what_a_recording_lacks_is_named_with_what_to_do(edit: Any, duration_s: float, said: str) -> None:
    with pytest.raises(BenchError, match=said) as caught:
        analyse(material(edit, duration_s))
    assert caught.value.next_step


def test_a_gap_near_the_end_is_cut_and_told() -> None:
    found = analyse(material(holes(3200)))
    assert any("only the longest piece of 16.0 s of 17.0 s is analysed" in note for note in found.notes)


@pytest.mark.parametrize(
    ("sections", "code"),
    [
        *(
            ({"limits": {name: limit}}, "B-SYNC-005")
            for name, limit in (
                ("azimuth_error", {"value": 1.0, "unit": "deg"}),
                ("stamps_difference", {"value": 1.0, "unit": "m"}),
                ("time_offset_uncertainty", {"value": 0.0, "unit": "s"}),
                ("time_offset_uncertainty", {"value": 1.0}),
            )
        ),
        ({"latency": {"egi_s": 0.008}}, "B-SYNC-006"),
        ({"latency": {"egi_s": -0.008, "imu_s": 0.0, "std_s": 1e-3}}, "B-SYNC-006"),
        ({"inertial": {"accel_bias_g": 2e-4}}, "B-SYNC-006"),
        ({"inertial": STATED | {"gyro_bias_deg_s": 0.0}}, "B-SYNC-006"),
        ({"egi": {"velocity_m_s": 0.017}}, "B-SYNC-006"),
        ({"egi": EGI | {"level_deg": 0.0}}, "B-SYNC-006"),
    ],
)
def test_what_a_sequence_may_not_state(sections: dict[str, Any], code: str) -> None:
    with pytest.raises(BenchError, match=code):
        analyse(replace(material(), campaign={**material().campaign, **sections}))


def test_no_rows_and_pulses_without_a_target() -> None:
    with pytest.raises(BenchError, match="B-SYNC-001"):
        analyse(replace(material(), rows=[]))
    rng = np.random.default_rng(1)
    gates = (rng.standard_normal((3000, 64)) + 1j * rng.standard_normal((3000, 64))).astype(np.complex64)
    positions_m = np.stack([np.arange(3000) * 0.25, np.zeros(3000), np.full(3000, -3000.0)], axis=1)
    with pytest.raises(BenchError, match=r"B-SYNC-010.*no point target"):
        point_targets(Pulses(gates, 44_920.0, 2.5, 0.03123), positions_m)


def test_limits_are_those_of_the_plan() -> None:
    declared = DECLARATION.analysis("time_sync")
    assert {name: limit.dimension for name, limit in declared.limits.items()} == dict.fromkeys(SPECIFIED_s, "s")
    found = demands_of({"limits": {"time_offset_uncertainty": {"value": 3.0, "unit": "ms"}}})
    assert (found.uncertainty_s, found.difference_s) == (3e-3, 5e-3)


def test_what_the_sequence_states_of_the_units() -> None:
    found = densities_of({"inertial": STATED})
    assert found.accel_bias_ug == pytest.approx(200.0)
    assert found.gyro_bias_deg_h == pytest.approx(1.0)
    assert densities_of({}) == densities_of({"inertial": None})
    assert latency_of({}) is None
    assert spread_of({"egi": EGI}, 2.0) == EgiSpread(2.0, 0.05, 0.01, 0.1, 9.0, 8.0)
    assert spread_of({}, 2.0) == EgiSpread(position_m=2.0)
    assert spread_of({}, 0.0) == EgiSpread(), "an EGI that does not know how good its position is"
