"""Analysis radar_image: points of one formula on an arc of 4 deg, and the Gotcha data of the AFRL against the exact
matched filter (Gorham and Moore, Proc. SPIE 7699 (2010) 769906, the sum over pulses and frequencies) and its nominal
widths. The filter of the time offset on short flights: tags off the grid, lost samples, nothing to see or to use.
"""

import re
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import h5py
import numpy as np
import pytest
from imported_logs import MAPPINGS, estimates_of, imported, of_mirror, parsed
from numpy.typing import NDArray
from one_estimate import one
from scipy.io import loadmat, savemat
from sync_rig import BASE, END_S, LEVEL_UNTIL_S, TURN_UNTIL_S, Flight, flight, setup

from bench.analysis import Analysis, Material
from bench.analysis.doubt import weigh
from bench.commands.guess import guess
from bench.model.errors import FitError, InputErrors
from bench.systems.time_sync import phase_history
from bench.systems.time_sync.estimators.kalman.filter import run_filter
from bench.systems.time_sync.estimators.kalman.innovation import filled_noise, nis_summary
from bench.systems.time_sync.estimators.kalman.setup import LOOSE, TIGHT, FilterRun, ImuSamples
from bench.systems.time_sync.estimators.sar.response import compressed, impulse_response, scene_of
from sim_instruments.worlds.time_sync.flight.egi import EgiRuns
from sim_instruments.worlds.time_sync.flight.imu import imu_runs
from sim_instruments.worlds.time_sync.flight.path import FlightPath

Array = NDArray[np.float64]
C_m_s = 299_792_458.0
BAND_Hz = (9.5e9, 9.7e9)
COUNT, LENGTH = 96, 64
PLACES_m = np.array([[8.0, -5.0, 0.0], [-9.0, -6.0, 0.0]])
MAPPING = """\
mapping: radar
uut: {model: radar, serial: S-1}
analysis: radar_image
frequencies: {first: 9.5 GHz, last: 9.7 GHz}
columns:
  t: {role: time, format: rows, rate: 100 Hz, start: 2024-01-01T00:00:00Z}
  x: {role: antenna, axis: x, unit: m}
  y: {role: antenna, axis: y, unit: m}
  z: {role: antenna, axis: z, unit: m}
  'NAME[{0..63}].real': {role: in_phase}
  'NAME[{0..63}].imag': {role: quadrature}
"""


def arc(angle_deg: float = 4.0, count: int = COUNT) -> Array:
    """Antenna 5 km away and 4 km up, on a part of a circle about the scene."""
    turn = np.radians(30.0 + angle_deg * (np.arange(count) / (count - 1) - 0.5))
    return np.column_stack((5000.0 * np.cos(turn), 5000.0 * np.sin(turn), np.full(count, 4000.0)))


def echoes(
    antenna_m: Array, places_m: Array = PLACES_m, noise: float = 0.0, seed: int = 1, off_m: Array | float = 0.0
) -> NDArray[np.complex128]:
    """Samples of points of amplitude 1 and 0.5, phase -4 pi f (R - R0) / c; R0 by navigation, which is ``off_m``."""
    frequency_Hz = np.linspace(*BAND_Hz, LENGTH)
    made = np.zeros((len(antenna_m), LENGTH), np.complex128)
    for amplitude, place_m in zip((1.0, 0.5), places_m, strict=False):
        far_m = np.linalg.norm(antenna_m - place_m, axis=1) - np.linalg.norm(antenna_m + off_m, axis=1)
        made += amplitude * np.exp(-4j * np.pi * np.outer(far_m, frequency_Hz) / C_m_s)
    rng = np.random.default_rng(seed)
    return made + noise * (rng.standard_normal(made.shape) + 1j * rng.standard_normal(made.shape)) / np.sqrt(2.0)


def material(samples: NDArray[np.complex128], antenna_m: Array) -> Material:
    series = {f"antenna_{axis}": antenna_m[:, at] for at, axis in enumerate("xyz")}
    for at in range(samples.shape[1]):
        series |= {f"in_phase_{at}": samples[:, at].real.copy(), f"quadrature_{at}": samples[:, at].imag.copy()}
    campaign = {"uut": {"model": "m", "serial": "1"}, "frequencies": {"first_Hz": BAND_Hz[0], "last_Hz": BAND_Hz[1]}}
    return Material((), campaign, {}, series=series)


def found(analysis: Analysis, quantity: str, **where: str) -> tuple[float, float]:
    entry = one(analysis, quantity, **where)
    return entry.value, entry.std_uncertainty


def test_points_of_a_formula_stand_where_they_are_as_sharp_as_they_may_be() -> None:
    """Widths 0.8859 lambda / 2 dsin and 0.8859 c / 2B, first side lobe of sin(x) / x."""
    antenna_m = arc()
    analysis = phase_history.analyse(material(echoes(antenna_m), antenna_m))
    ideal_m = 0.885893 * C_m_s / (2.0 * (BAND_Hz[1] - BAND_Hz[0]) * LENGTH / (LENGTH - 1))
    assert found(analysis, "place_x")[0] == pytest.approx(PLACES_m[0, 0], abs=0.02)
    assert found(analysis, "place_y")[0] == pytest.approx(PLACES_m[0, 1], abs=0.02)
    assert found(analysis, "resolution", axis="range")[0] == pytest.approx(ideal_m, rel=0.01)
    assert found(analysis, "resolution_over_ideal", axis="azimuth")[0] == pytest.approx(1.0, abs=0.01)
    lobes = {axis: found(analysis, "pslr", axis=axis) for axis in ("azimuth", "range")}
    assert all(value == pytest.approx(-13.26, abs=4.0 * std + 0.1) for value, std in lobes.values())
    assert weigh(analysis.evidence).against == []
    table = [row[1:3] for row in analysis.tables[0].rows]
    assert table == [["+8.00", "-5.00"], ["-9.00", "-6.00"]]


def test_intervals_hold_what_noise_does() -> None:
    """Forty draws: root mean square of errors over stated standard uncertainties 0.7 to 1.4 (chi squared, 99.8 %)."""
    antenna_m, place_m = arc(), PLACES_m[:1]

    def values(seed: int, noise: float = 1.0) -> list[tuple[float, float]]:
        pulses = compressed(echoes(antenna_m, place_m, noise, seed), antenna_m, *BAND_Hz)
        target = impulse_response(pulses, antenna_m, scene.targets_m[0], (1.0, 2.0))
        return [(each.value, each.std_uncertainty) for each in phase_history._estimates(scene, target, COUNT, 0)]

    scene = scene_of(compressed(echoes(antenna_m, place_m, 1.0), antenna_m, *BAND_Hz), antenna_m)
    truth = [value for value, _ in values(0, noise=0.0)]
    scores = [
        [(value - true) / std for (value, std), true in zip(values(seed), truth, strict=True)] for seed in range(40)
    ]
    assert np.sqrt(np.mean(np.square(scores), axis=0)) == pytest.approx(np.full(len(truth), 1.05), abs=0.35)


def test_positions_that_are_off_along_the_track_are_seen() -> None:
    antenna_m = arc()

    def image(off_m: Array) -> Analysis:
        return phase_history.analyse(material(echoes(antenna_m, off_m=off_m), antenna_m + off_m))

    bent_m = np.linspace(-1.0, 1.0, COUNT)[:, None] ** 2 * np.array([0.01, 0.0, 0.0])
    analysis = image(bent_m)
    assert found(analysis, "resolution_over_ideal", axis="azimuth")[0] > 1.2
    assert [one.code for one in weigh(analysis.evidence).against] == ["not_focused"]
    with pytest.raises(FitError, match="B-FIT-122: the strongest place"):
        image(10.0 * bent_m)
    shifted = image(np.array([0.3, 0.5, 0.0]))
    assert found(shifted, "place_x")[0] == pytest.approx(PLACES_m[0, 0] + 0.3, abs=0.01)
    assert found(shifted, "place_y")[0] == pytest.approx(PLACES_m[0, 1] + 0.5, abs=0.01)


def test_pulses_that_are_not_whole_are_left_out_and_counted() -> None:
    antenna_m = arc()
    log = material(echoes(antenna_m), antenna_m)
    log.series["quadrature_5"][[4, 9]] = np.nan
    analysis = phase_history.analyse(log)
    assert {(entry.n, entry.dropped) for entry in analysis.estimates} == {(COUNT - 2, 2)}


@pytest.mark.parametrize(
    ("antenna_m", "noise", "said"),
    [
        (arc(count=12), 0.0, "B-SYNC-013: .*12 whole pulses of 64 samples"),
        (arc(angle_deg=30.0), 0.0, r"B-SYNC-013: .*goes 23\..* deg"),
        (arc() * [0.001, 0.001, 1.0], 0.0, "B-SYNC-013: .*above the ground"),
        (arc(angle_deg=0.0), 0.0, "B-FIT-120: .*never change"),
        (arc(), 1e3, "B-SYNC-010: no point target"),
    ],
)
def test_what_is_no_phase_history_is_refused(antenna_m: Array, noise: float, said: str) -> None:
    with pytest.raises(FitError, match=said):
        phase_history.analyse(material(echoes(antenna_m, noise=noise), antenna_m))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("role: quadrature", "role: in_phase", "two columns have the quantity 'in_phase_0'"),
        ("{0..63}].imag", "{0..62}].imag", "as many columns"),
        ("{0..63}].imag", "{63..0}].imag", "needs the numbers of its columns"),
        ("'NAME[{0..63}].imag'", "Q", "needs the numbers of its columns"),
        ("axis: z, unit: m", "axis: z, unit: s", "unit of length"),
        ("last: 9.7 GHz", "last: 9.4 GHz", "above the first"),
        ("frequencies: {first: 9.5 GHz, last: 9.7 GHz}\n", "", "and 'frequencies'"),
        ("role: in_phase", "role: samples", "'time', 'antenna', 'in_phase', 'quadrature', 'temperature', 'ignore'"),
    ],
)
def test_mistakes_of_a_mapping_are_named(old: str, new: str, said: str) -> None:
    with pytest.raises(InputErrors, match=said):
        parsed(MAPPING.replace(old, new))


@pytest.mark.parametrize("form", ["mat", "npz", "matlab_hdf5", "csv"])
def test_a_phase_history_of_every_form(form: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The rows of the matrix are frequencies in MATLAB, as in the Gotcha data, pulses in NumPy and in text."""
    antenna_m, log, name = arc(), BytesIO(), "fp.T"
    samples = echoes(antenna_m)
    columns = dict(zip("xyz", antenna_m.T, strict=True))
    if form == "mat":
        savemat(log, {"fp": samples.T, **columns})
    elif form == "npz":
        name = "fp"
        np.savez(log, fp=samples, **columns)
    elif form == "matlab_hdf5":
        with h5py.File(log, "w") as file:
            parts = np.empty(samples.shape, [("real", "f8"), ("imag", "f8")])
            parts["real"], parts["imag"] = samples.real, samples.imag
            for key, array in {"fp": parts, **{key: value[None] for key, value in columns.items()}}.items():
                file[key] = array
                file[key].attrs["MATLAB_class"] = np.bytes_("double")
    else:
        name = "s"
        header = ",".join([*"xyz", *(f"s[{k}].{part}" for k in range(LENGTH) for part in ("real", "imag"))])
        table = np.column_stack((antenna_m, samples.view(np.float64)))
        np.savetxt(log, table, delimiter=",", header=header, comments="", fmt="%.17g")
    entries = estimates_of(imported(tmp_path, MAPPING.replace("NAME", name), log.getvalue()))
    assert entries[0].value == pytest.approx(PLACES_m[0, 0], abs=0.02)
    capsys.readouterr()
    guess(tmp_path / "log")
    assert re.search(r"\[\{0\.\.\d+\}\]\.imag': \{role: quadrature\}", capsys.readouterr().out)


@pytest.mark.real
def test_the_gotcha_scene_is_as_sharp_as_its_band_and_aperture(tmp_path: Path) -> None:
    """Its strongest reflector: 0.8859 c / 2B in range to 3 % (the band is not quite flat), in azimuth to 1 %."""
    capture = of_mirror("dm6718+RITSAR", "examples/data/AFRL/pass1/HH/data_3dsar_pass1_az001_HH.mat")
    entries = estimates_of(imported(tmp_path, MAPPINGS / "gotcha_phase_history.yaml", capture))
    found = {(entry.quantity, entry.conditions.get("axis")): entry.value for entry in entries}
    log = loadmat(BytesIO(capture), squeeze_me=True, struct_as_record=False)["data"]
    antenna_m, frequency_Hz = np.column_stack((log.x, log.y, log.z)).astype(float), log.freq.astype(float)
    cosine = np.mean(np.hypot(log.x, log.y) / np.linalg.norm(antenna_m, axis=1))
    turned = np.radians(log.th[-1] - log.th[0]) * len(antenna_m) / (len(antenna_m) - 1) * cosine
    assert found["resolution", "azimuth"] == pytest.approx(
        0.885893 * C_m_s / frequency_Hz.mean() / (2.0 * turned), rel=0.01
    )
    assert found["resolution", "range"] == pytest.approx(0.885893 * C_m_s / (2.0 * 424 / 423 * 622.361e6), rel=0.03)
    assert found["pslr", "azimuth"] == pytest.approx(-13.26, abs=1.0)
    scene = scene_of(compressed(log.fp.T.astype(complex), antenna_m, 9.28808e9, 9.910441e9), antenna_m)
    highest = np.abs(scene.chip.value).max()
    picked = np.random.default_rng(1).integers(0, scene.chip.value.shape, (40, 2))
    for row, column in picked:
        point_m = scene.axes.points(scene.chip.azimuth_m[row], scene.chip.range_m[column])
        far_m = np.linalg.norm(antenna_m - point_m, axis=1) - np.linalg.norm(antenna_m, axis=1)
        exact = np.mean(log.fp.T * np.exp(4j * np.pi * np.outer(far_m, frequency_Hz) / C_m_s))
        assert abs(abs(exact) - abs(scene.chip.value[row, column])) < 5e-4 * highest


OFFSETS_S = (-0.020, 0.0137, 0.020)  # early, no whole number of samples, late
OFFSET_S = 0.0137  # of one unit on a bench
SETTLED_S = LEVEL_UNTIL_S + 0.5  # the offset is known, innovations are those of the EGI's errors


def at(run: FilterRun, t_s: float) -> int:
    return int(np.searchsorted(run.t_s, t_s))


def rms(x: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(x**2, axis=-1)))


def test_late_early_and_fractional_offsets_are_found_with_their_sign() -> None:
    """EGI errors as an EGI has them, R = BASE."""
    sound = run_filter(flight(6).imu, flight(6).egi(OFFSETS_S), setup(3, BASE, keep_every=5))
    true, level = np.array(OFFSETS_S)[:, None], at(sound, LEVEL_UNTIL_S - 0.1)
    errors = sound.offset_s - true
    assert np.all(rms(errors[level]) >= 0.9 * np.abs(true[:, 0]))  # level flight cannot tell the offset
    assert np.all(np.abs(errors[-1].mean(axis=-1)) < 0.5e-3)
    assert np.all(rms(errors[-1]) < 1e-3)
    assert np.all(nis_summary(sound, SETTLED_S).ratio[:, 0] < 0.03)  # EGI errors change slowly, innovations are small
    assert np.all(sound.sigma[-1, :, 15] < 0.3e-3)
    assert np.all(sound.sigma[level, :, 15] > 0.9 * 0.03)
    assert np.all(sound.offset_s[-1].std(axis=-1) > 1e-6)  # lanes are not copies of each other


def test_without_the_state_the_errors_lag_by_the_offset() -> None:
    trip = flight(6)
    run = run_filter(trip.imu, trip.egi((0.0, 0.020)), setup(2, BASE, augmented=False))
    assert np.all(run.offset_s == 0.0)
    assert np.all(run.sigma[..., 15] == 0.0)
    level, turn = at(run, LEVEL_UNTIL_S - 0.5), at(run, TURN_UNTIL_S - 0.1)
    lag_m = (run.p[level, 1] - run.p[level, 0])[:, 0].mean()
    assert lag_m == pytest.approx(-100.0 * 0.020, rel=0.01)  # equation (1): minus v T_d
    yaw = np.arctan2(run.C[turn, :, :, 1, 0], run.C[turn, :, :, 0, 0])
    lag_deg = np.rad2deg(yaw[1] - yaw[0]).mean()
    assert lag_deg == pytest.approx(-9.0 * 0.020, rel=0.25)  # equation (3): minus w T_d, not settled yet


def test_while_the_position_is_held_only_the_attitude_is_used() -> None:
    trip = flight(6)
    held = TURN_UNTIL_S + 0.5
    free = setup(1, TIGHT, fine_from_s=held)
    biggest_m = []
    for changes in (free, replace(free, hold_position_from_s=held)):
        run = run_filter(trip.imu, EgiRuns(trip.path, trip.errors, np.array([0.0])), changes)
        assert run.fine.t_s[0] >= held
        assert run.fine.t_s[-1] == pytest.approx(END_S)
        steps = np.diff(run.fine.p, axis=0) - 0.0025 * (run.fine.v[1:] + run.fine.v[:-1])
        biggest_m.append(np.abs(steps).max())
        late = run.nis_count[run.t_s >= held]
        assert np.all(late[..., 3] > 0)  # the attitude goes on
        assert np.all((late[..., 1:3] > 0) == (changes is free))
    assert biggest_m[0] > 3e-4
    assert biggest_m[1] < 0.5 * biggest_m[0]


def test_an_offset_of_a_tenth_is_found_and_half_a_second_from_a_rough_value() -> None:
    trip = flight(6)

    def found(offset_s: float, **begin: float) -> float:
        return float(run_filter(trip.imu, trip.egi((offset_s,)), setup(1, LOOSE, **begin)).offset_s[-1].mean())

    rough_s = found(0.1)
    assert rough_s == pytest.approx(0.1, abs=3.4e-3)
    assert found(0.1, offset0_s=rough_s) == pytest.approx(0.1, abs=0.5e-3)
    for offset_s in (0.5, -0.5):
        begin = {"offset0_s": offset_s - 0.02, "look_ahead_s": 0.6, "reach_s": 1.3}
        assert found(offset_s, **begin) == pytest.approx(offset_s, abs=1e-3)


class Samples:
    """An EGI of stored samples."""

    def __init__(self, t_s: Array, p: Array, v: Array, C: Array) -> None:
        self.t_s, self.p, self.v, self.C = t_s, p, v, C

    def block(self, k0: int, k1: int) -> tuple[Array, Array, Array]:
        return self.p[k0:k1], self.v[k0:k1], self.C[k0:k1]


def stored(trip: Flight, offsets_s: tuple[float, ...] = (OFFSET_S,)) -> Samples:
    """All samples of a flight, in arrays of their own."""
    egi = trip.egi(offsets_s)
    return Samples(egi.t_s.copy(), *(x.copy() for x in egi.block(0, egi.t_s.size)))


def ends(run: FilterRun) -> tuple[float, float]:
    return float(run.offset_s[-1, 0, 0]), float(run.sigma[-1, 0, 15])


@pytest.fixture(scope="module")
def whole() -> tuple[float, float]:
    trip = flight(1)
    offset_s, sigma_s = ends(run_filter(trip.imu, stored(trip), setup(1, BASE)))
    assert offset_s == pytest.approx(OFFSET_S, abs=0.5e-3)
    return offset_s, sigma_s


@pytest.mark.parametrize("absent", [True, False], ids=["absent", "nan"])
def test_lost_egi_samples_cost_little(whole: tuple[float, float], absent: bool) -> None:
    trip = flight(1)
    egi = stored(trip)
    lost = np.random.default_rng(3).random(egi.t_s.size) < 0.05
    lost[:4] = True  # the first ones among them
    lost[60:85] = True  # half a second before the turn
    if absent:
        egi = Samples(egi.t_s[~lost], egi.p[~lost], egi.v[~lost], egi.C[~lost])
    else:
        egi.p[lost] = np.nan
        egi.v[np.flatnonzero(lost)[::2]] = np.nan
    run = run_filter(trip.imu, egi, setup(1, BASE))
    offset_s, sigma_s = ends(run)
    assert np.isfinite(run.p).all()
    assert abs(offset_s - whole[0]) < 0.5 * whole[1]
    assert sigma_s == pytest.approx(whole[1], rel=0.1)


def test_filled_imu_samples_cost_little(whole: tuple[float, float]) -> None:
    """2 % lost and filled with the mean of their neighbours."""
    trip = flight(1)
    filled = np.random.default_rng(5).random(trip.imu.t_s.size) < 0.02
    filled[[0, -1]] = False
    good = np.flatnonzero(~filled)
    dv, dtheta = trip.imu.dv.copy(), trip.imu.dtheta.copy()
    for x in (dv, dtheta):
        for axis in range(3):
            x[filled, 0, axis] = np.interp(np.flatnonzero(filled), good, x[good, 0, axis])
    imu = ImuSamples(trip.imu.t_s, dv, dtheta, filled)
    offset_s, sigma_s = ends(run_filter(imu, stored(trip), setup(1, BASE)))
    assert abs(offset_s - whole[0]) < whole[1]
    assert sigma_s > whole[1]  # wider process noise


def test_a_filled_sample_is_trusted_by_what_changed_across_it() -> None:
    dv = np.zeros((6, 1, 3))
    dv[4:, 0, 1] = 0.04
    filled = np.array([False, True, False, True, False, False])
    sums = filled_noise(ImuSamples(np.arange(6) * 0.005, dv, np.zeros((6, 1, 3)), filled))
    assert sums[2, :3] == pytest.approx(0.0)  # nothing changed across the first
    assert sums[-1, :3] == pytest.approx(0.02**2)
    assert sums[-1, 3:] == pytest.approx(0.0)
    filled[2] = True  # three in a row: what they are off by they are off by together
    sums = filled_noise(ImuSamples(np.arange(6) * 0.005, np.zeros((6, 1, 3)), dv, filled))
    assert sums[-1, 3:] == pytest.approx((3 * 0.02) ** 2)


def test_one_lane_without_its_sample_takes_it_from_its_group_only() -> None:
    trip = flight(3, end_s=3.0)
    egi, other = stored(trip, (0.0, 0.02)), stored(trip, (0.0, 0.02))
    egi.p[80:100, 0, 1, 2] = np.nan
    run, whole_run = (run_filter(trip.imu, x, setup(2, BASE, keep_every=10)) for x in (egi, other))
    assert np.array_equal(run.p[:, 1], whole_run.p[:, 1])
    assert not np.array_equal(run.p[:, 0], whole_run.p[:, 0])
    assert whole_run.nis_count[:, 0].sum() - run.nis_count[:, 0].sum() == 20 * 3 * 4  # samples, lanes, blocks


def test_what_does_not_move_tells_nothing() -> None:
    """One lane at rest with a tight attitude: noise of the gyros must not pass for motion."""
    path = FlightPath(((0.0, 0.0, 0.0),), speed_m_s=0.0)
    still = replace(flight(1), path=path, unit=imu_runs(path, END_S, 1, 7))
    run = run_filter(still.imu, still.egi((0.02,)), setup(1, TIGHT))
    assert run.sigma[-1, 0, 15] > 0.97 * 0.03
    assert abs(run.offset_s[-1, 0, 0] - 0.02) > 0.9 * 0.02


@pytest.mark.parametrize("what", ["apart", "nan", "at the end"])
def test_an_egi_that_cannot_be_held_against_the_imu_is_refused(what: str) -> None:
    trip = flight(1)
    egi = stored(trip)
    if what == "apart":
        egi.t_s += 1000.0
    elif what == "nan":
        egi.p[:] = np.nan
    else:
        egi.t_s += trip.imu.t_s[-1] - 0.04  # one sample, and none behind it that could be used
    with pytest.raises(FitError, match="B-FIT-116"):
        run_filter(trip.imu, egi, setup(1, LOOSE))
