"""Numbers of the analysis of a north finder against plain arithmetic, and what it refuses."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fog_material import AZIMUTH_DEG, LATITUDE_DEG, Gyro, NorthRig, campaign
from one_estimate import every as of
from one_estimate import table_of
from scipy import stats

from bench.analysis import Analysis, Series, with_uncertainty
from bench.model.errors import FitError
from bench.model.quantities import Quality
from bench.systems.north.analysis import AZIMUTH_ERROR, analyse, north_estimates
from bench.systems.north.declaration import DECLARATION
from bench.systems.north.sets import NorthSet, north_sets
from bench.systems.north.solution import METHODS, Azimuths, Site, Solution, accuracies

SEED = 705
GYRO = Gyro(noise_V=0.2, placement_deg=(4.0, -7.0), gains=(1.1, 0.9), lock_in_offset_V=(0.01, -0.02))
SAMPLES = 20_000  # of a set
ERROR_SEED = 703


@pytest.fixture(scope="module")
def clockwise() -> Analysis:
    return analyse(campaign(NorthRig(SEED, GYRO), (0.0, 90.0), 2, -360.0).material())


def drawn(analysis: Analysis, title: str) -> dict[str, Series]:
    (found,) = (one for one in analysis.figures if one.title == title)
    return {one.label: one for one in found.series}


def known_errors(errors_deg: np.ndarray, noise_deg: float, common_deg: float) -> Solution:
    """Tests with these errors by every method, 5 s of records each, bounds of 0.3 and 0.4 degrees by turns."""
    n = len(errors_deg)
    window = SimpleNamespace(t_start_ns=1_000_000_000, t_end_ns=6_000_000_000)
    sets = [NorthSet("test", "mark", 0.0, k, 360.0, rows={1: SimpleNamespace(window=window)}) for k in range(n)]  # type: ignore[dict-item]
    raw: Any = [SimpleNamespace(bound_deg=0.3 if k % 2 else 0.4, std_deg=0.3, dof=5000.0) for k in range(n)]
    known_deg, nothing = np.full(n, 170.0), np.full((n, 4), np.nan)
    found = Solution(sets, Site(37.0, 170.0), known_deg, np.zeros(n), np.ones(n, bool), nothing, nothing, raw)
    azimuths = Azimuths(known_deg + errors_deg, noise_deg, 4.0, common_deg, 10.0)
    found.by_method = dict.fromkeys(METHODS, azimuths)
    return found


def test_accuracy_of_known_errors() -> None:
    errors_deg = np.array([0.6, 0.1, -0.2, 0.5, 0.3, 0.05])
    (one, *_) = accuracies(known_errors(errors_deg, 0.2, 0.1), 0.5)
    assert one.rms_deg == pytest.approx(np.sqrt(np.mean(errors_deg**2)))
    assert (one.used, one.gross) == (6, 0)
    assert one.mean_deg == pytest.approx(errors_deg.mean())
    assert one.scatter_deg == pytest.approx(np.std(errors_deg, ddof=1))
    assert one.ratio == pytest.approx(np.std(errors_deg, ddof=1) / np.sqrt((0.3**2 + 0.4**2) / 2.0))
    left_deg2 = (0.5 / 1.96) ** 2 - 0.1**2
    assert one.time_s == pytest.approx(5.0 * 0.2**2 / left_deg2)
    rng = np.random.default_rng(SEED)
    noise, common = (rng.chisquare(dof, 400_000) / dof for dof in (4.0, 10.0))
    drawn_s, true_s = (
        5.0 * 0.2**2 * of_noise / ((0.5 / 1.96) ** 2 - 0.1**2 * of_common)
        for of_noise, of_common in ((noise, common), (1.0 / noise, 1.0 / common))
    )
    assert one.time_std_s == pytest.approx(np.std(drawn_s), rel=0.01)
    assert one.time_within_s == pytest.approx(np.quantile(np.abs(true_s - one.time_s), 0.95), rel=0.02)
    (wrong, *_) = accuracies(known_errors(np.array([0.1, -0.1, 91.0]), 0.2, 0.0), 0.5)
    assert (wrong.gross, wrong.time_s) == (1, np.inf), "no time turns a branch that is wrong once"
    mean = Azimuths(np.zeros(4), 0.4, 8.0, 0.1, 2.0)  # Welch and Satterthwaite by hand: four repeats, one in common
    assert mean.dof_of_mean(4) == pytest.approx((0.2**2 + 0.1**2) ** 2 / (0.2**4 / 8.0 + 0.1**4 / 2.0))


@pytest.mark.parametrize("turned_deg", [180.0, -180.0])
def test_errors_in_two_heaps_have_no_mean_between_them(turned_deg: float) -> None:
    """Half of them half a turn off: once the mean was 90 deg and the scatter 92 deg, and both said nothing."""
    near_deg = np.array([-0.3, 0.2, -0.5, 0.1, -0.4, 0.3])
    off_deg = near_deg + turned_deg * np.array([0, 1, 0, 1, 1, 0])
    folded_deg = np.remainder(off_deg + 180.0, 360.0) - 180.0
    (one, *_) = accuracies(known_errors(off_deg, 0.2, 0.1), 0.5)
    assert one.gross == 3
    assert one.mean_deg == pytest.approx(near_deg.mean(), abs=1e-9)
    assert one.scatter_deg == pytest.approx(np.std(near_deg, ddof=1), rel=1e-6)
    assert one.rms_deg == pytest.approx(np.sqrt(np.mean(folded_deg**2)), abs=1e-6)
    drawn_deg = np.where(np.random.default_rng(5).random((4000, 6)) < 0.5, turned_deg, 0.0) + near_deg
    spread = np.std(np.sqrt(np.mean(drawn_deg**2, axis=1)))
    assert one.rms_std_deg == pytest.approx(spread, rel=0.35)  # 6 errors tell their spread to a third


def test_the_swing_of_the_table_is_a_floor_for_the_lock_ins_alone() -> None:
    """At the index of the calibration and at that of the test; the encoder sees it."""
    found = known_errors(np.array([0.1, -0.1, 0.2, -0.2]), 0.2, 0.1)
    found.swing_deg = 0.06
    by_samples, by_waveform, *_ = accuracies(found, 0.5)
    assert by_samples.time_s == pytest.approx(5.0 * 0.2**2 / ((0.5 / 1.96) ** 2 - 0.1**2 - 2.0 * 0.06**2))
    assert by_waveform.time_s == pytest.approx(5.0 * 0.2**2 / ((0.5 / 1.96) ** 2 - 0.1**2))


def test_no_time_is_stated_where_the_calibration_may_be_too_little() -> None:
    """0.2 of 0.255 deg: with 10 degrees of freedom the next campaign may have no time, one in 11 of them."""
    found = known_errors(np.array([0.1, -0.1, 0.2, -0.2]), 0.1, 0.2)
    assert stats.chi2.sf(10.0 * (0.5 / 1.96 / 0.2) ** 2, 10.0) == pytest.approx(1.0 / 11.0, rel=0.05)
    accuracy = accuracies(found, 0.5)
    assert accuracy[0].time_s == pytest.approx(5.0 * 0.1**2 / ((0.5 / 1.96) ** 2 - 0.2**2))
    assert accuracy[0].time_within_s == np.inf
    found.raw = ()
    stated = {entry.quantity for entry in north_estimates(found, METHODS[0], accuracy, 0.5)}
    assert "azimuth_rms_error" in stated
    assert "time_to_accuracy" not in stated


def test_calibration_of_a_table_that_turns_clockwise(clockwise: Analysis) -> None:
    for letter, role, placement_deg, gain, offset_mV in (
        ("a", "lock_in_2", 4.0, 0.9, -20.0), ("b", "lock_in_1", -7.0, 1.1, 10.0),
    ):  # fmt: skip
        (place,) = of(clockwise, "index_placement", index=letter, rotation="clockwise")
        assert place.value == pytest.approx(placement_deg, abs=4.0 * place.std_uncertainty)
        (scale,) = of(clockwise, "scale", source=role)
        assert scale.value == pytest.approx(gain, abs=4.0 * scale.std_uncertainty)
        (row,) = (
            one for one in table_of(clockwise, "Calibration of the index").rows if one[1].lower().startswith(letter)
        )
        factor = stats.t.ppf(0.975, place.dof)
        assert row[2] == with_uncertainty(place.value, factor * place.std_uncertainty)
        volts_rms, std = scale.value / np.sqrt(2.0), scale.std_uncertainty / np.sqrt(2.0)
        assert row[3] == with_uncertainty(volts_rms, factor * std)
        assert float(row[4].replace("−", "-")) == pytest.approx(
            offset_mV, abs=4.0
        )  # of the lock-in, whichever way it turns
    stds = [of(clockwise, "index_placement", index=letter)[0].std_uncertainty for letter in "ab"]
    assert stds[0] / stds[1] == pytest.approx(1.1 / 0.9, rel=0.05)


def test_noise_amplitude_and_time_know_how_well_they_are_known(clockwise: Analysis) -> None:
    used = 6 * SAMPLES  # two calibrations, four tests, and the searches
    (noise,), (scale,) = of(clockwise, "noise"), of(clockwise, "scale", source="waveform")
    assert noise.n >= used
    assert noise.value == pytest.approx(0.2, abs=4.0 * noise.std_uncertainty)
    assert noise.std_uncertainty == pytest.approx(0.2 / np.sqrt(2.0 * noise.n), rel=0.01)
    assert scale.std_uncertainty == pytest.approx(0.2 * np.sqrt(2.0 / scale.n), rel=0.01)
    (time,) = of(clockwise, "time_to_accuracy", method="likelihood")
    assert time.n == 4
    due = np.sqrt(2.0 / noise.n + 4.0 * (scale.std_uncertainty / scale.value) ** 2)  # noise over amplitude
    assert time.std_uncertainty == pytest.approx(time.value * due, rel=0.02)
    dof = 2.0 / due**2  # of a variance
    ends = dof / (1.0 + np.array([1.0, -1.0]) * time.expanded_uncertainty / time.value)
    assert np.diff(stats.chi2.cdf(ends, dof))[0] == pytest.approx(0.95, abs=3e-3)


def test_nothing_is_claimed_of_harmonics_that_noise_explains(clockwise: Analysis) -> None:
    """One table in a hundred: a gamma distribution with as many sets, four orders; 4 sigma^2/n in the mean."""
    sets = of(clockwise, "noise")[0].n // SAMPLES
    limit = 100.0 * np.sqrt(4.0 * 0.2**2 / SAMPLES * stats.gamma.ppf(0.99**0.25, sets) / sets)
    below = [row for row in table_of(clockwise, "Harmonics of the waveform").rows if row[1].startswith("below ")]
    assert len(below) == 4
    for _, part, error in below:
        assert float(part.removeprefix("below ")) == pytest.approx(limit, rel=0.05)
        assert error == "–"
    (literal,) = (row for row in table_of(clockwise, "Methods").rows if row[0] == "literal")
    assert literal[-1] == "never"


def test_readings_lie_on_the_curves_that_are_drawn_through_them(clockwise: Analysis) -> None:
    for title in ("Lock-in 1, reference: index B", "Lock-in 2, reference: index A"):
        parts = drawn(clockwise, title)
        curve_V = np.interp(parts["read"].x, parts["calibration"].x, parts["calibration"].y)
        assert np.abs(curve_V - parts["read"].y).max() < 0.02  # of 0.7; one output scatters by 0.003
    parts = drawn(clockwise, "Earth signal")
    curve_V = np.interp(parts["mean of 5 deg"].x, parts["fit"].x, parts["fit"].y)
    assert np.abs(curve_V - parts["mean of 5 deg"].y).max() < 0.06
    parts = drawn(clockwise, "Residual of the waveform")
    mean_mV, reach_mV = np.array(parts["mean of 5 deg"].y), np.array(parts["95 % of the noise"].high)
    samples = of(clockwise, "noise")[0].n
    np.testing.assert_allclose(reach_mV, 1e3 * 1.96 * 0.2 / np.sqrt(samples / 72), rtol=0.1)
    assert np.mean(np.abs(mean_mV) < reach_mV) > 0.8
    parts = drawn(clockwise, "Phasors")
    mean_V = np.array(parts["mean of the four"].x) + 1j * np.array(parts["mean of the four"].y)
    for k in range(1, 5):
        each_V = np.array(parts[f"k = {k}"].x) + 1j * np.array(parts[f"k = {k}"].y)
        assert np.abs(each_V - mean_V).max() < 0.2  # placements and gains are not taken out here


def test_errors_over_time_and_their_lines(clockwise: Analysis) -> None:
    parts = drawn(clockwise, "Errors over time")
    bound_deg = of(clockwise, "azimuth_bound")[0].value
    x, y = np.array(parts["bound"].x), np.array(parts["bound"].y)
    np.testing.assert_allclose(y, bound_deg * np.sqrt(20.0 / x), rtol=1e-3)
    np.testing.assert_allclose(parts["limit / 1.96"].y, 0.5 / 1.96)
    assert parts["least squares"].x == pytest.approx([20.0, 40.0], rel=1e-3)
    assert parts["least squares"].y[0] != parts["least squares"].y[1]
    means_deg = [one.value for one in of(clockwise, "azimuth_error")]
    assert parts["least squares"].y[1] == pytest.approx(np.sqrt(np.mean(np.square(means_deg))), rel=1e-6)
    band = drawn(clockwise, "Errors")["95 % at the bound"]
    assert band.high[0] == pytest.approx(1.96 * bound_deg, rel=1e-6)


def test_repeats_are_counted_and_those_that_fell_out() -> None:
    rig = campaign(NorthRig(SEED, Gyro(noise_V=0.05)), (0.0,), 2)
    rig.set("test", AZIMUTH_DEG, repeat=3, overload=True)
    (found,) = of(analyse(rig.material()), "azimuth_error")
    assert (found.n, found.dropped) == (2, 1)


@pytest.mark.parametrize(
    ("quality", "word", "by_samples", "by_waveform"),
    [(Quality.SUSPECT, "suspect", 2, 1), (Quality.OVER_RANGE, "over range", 1, 1), (Quality.STALE, "", 2, 2)],
)
def test_a_flagged_record_is_left_out(quality: Quality, word: str, by_samples: int, by_waveform: int) -> None:
    """Frames in doubt cost the waveform; a signal out of range is the lock-ins' too; links may lose."""
    rig = campaign(NorthRig(SEED, Gyro(noise_V=0.05)), (0.0, 90.0), 1)
    rig.rows[5] = replace(rig.rows[5], quality=quality)
    analysis = analyse(rig.material())
    assert len(of(analysis, "azimuth_error")) == by_samples
    assert len(of(analyse(rig.material(), "likelihood"), "azimuth_error")) == by_waveform
    told = [one for one in analysis.missing if "flagged" in one]
    assert bool(told) == bool(word)
    assert all(f"record at index position 2 flagged {word}" in one for one in told)


def test_the_level_of_the_same_head_next_in_time_counts() -> None:
    rig = NorthRig(SEED)
    rig.readings.clear()
    rig.gyro = replace(rig.gyro, tilt_mrad=(1.0, 2.0))
    rig.level(item="test", head_deg=0.0)
    rig.t_s += 500.0
    rig.gyro = replace(rig.gyro, tilt_mrad=(3.0, 4.0))
    rig.level(item="test", head_deg=0.0)
    rig.gyro = replace(rig.gyro, tilt_mrad=(5.0, 6.0))
    rig.level(item="test", head_deg=90.0)
    rig.set("test", AZIMUTH_DEG)
    (one,) = north_sets(rig.material())
    assert one.tilt_mrad == (3.0, 4.0)


def test_tilt_about_the_axis_of_the_bench() -> None:
    """Heading 110: the y axis points to 200 degrees; a tilt about it leans by -cos(20) about north."""
    rig = NorthRig(SEED, Gyro(tilt_mrad=(0.0, 1.0)))
    rig.level(item="test", head_deg=90.0)
    rig.set("test", AZIMUTH_DEG + 90.0, head_deg=90.0)
    (row,) = table_of(analyse(rig.material(), "likelihood"), "Tilt").rows
    due_deg = np.rad2deg(1e-3) * np.cos(np.deg2rad(20.0)) * np.tan(np.deg2rad(LATITUDE_DEG))
    assert row[2:4] == ["0.000", "1.000"]
    assert float(row[4]) == pytest.approx(due_deg, abs=1e-4)


@pytest.fixture
def rig() -> NorthRig:
    return campaign(NorthRig(ERROR_SEED), (0.0,), 1)


def refused(code: str, rig: NorthRig, method: str = "least_squares", **more: object) -> FitError:
    with pytest.raises(FitError) as caught:
        analyse(rig.material(**more), method)
    assert caught.value.code == code
    assert caught.value.next_step
    return caught.value


@pytest.mark.parametrize(
    "limits",
    [
        {"roll_error": {"value": 1.0, "unit": "deg"}},
        {"azimuth_error": {"value": 1.0, "unit": "m"}},
        {"azimuth_error": {}},
        {"azimuth_error": {"value": 0.0, "unit": "deg"}},
    ],
)
def test_a_limit_that_is_none_of_a_north_finder(rig: NorthRig, limits: dict[str, object]) -> None:
    assert next(iter(limits)) in refused("B-FOG-001", rig, limits=limits).message
    known = DECLARATION.analysis("fog_north").limits
    assert {name: limit.dimension for name, limit in known.items()} == {AZIMUTH_ERROR: "deg"}


def test_what_cannot_be_analysed_is_refused(rig: NorthRig) -> None:
    for site in ({}, {"latitude_deg": 37.0}, {"azimuth_deg": 20.0}):
        refused("B-FOG-003", rig, site=site)
    rig.readings = [one for one in rig.readings if one.role == "level"]
    refused("B-FOG-002", rig)
    warm_up, overloaded, unstated = (NorthRig(ERROR_SEED) for _ in range(3))
    warm_up.set("warm_up", AZIMUTH_DEG)
    refused("B-FOG-002", warm_up)
    overloaded.set("test", AZIMUTH_DEG, overload=True)
    overloaded.rows = [replace(row, samples=None) for row in overloaded.rows]
    assert "overload" in refused("B-FOG-004", overloaded).message
    unstated.set("test", AZIMUTH_DEG)
    for row in unstated.rows:
        del row.window.conditions["rate_deg_s"]
    assert "which sense" in refused("B-FOG-005", unstated).message


def test_lock_ins_without_samples_and_samples_without_lock_ins(rig: NorthRig) -> None:
    with_samples, rig.rows = rig.rows, [replace(row, samples=None) for row in rig.rows]
    analysis = analyse(rig.material())
    assert [one.value for one in of(analysis, "azimuth_error")] == [pytest.approx(0.0, abs=1e-3)]
    assert not {"Earth signal", "Residual of the waveform", "Errors over time"} <= {
        one.title for one in analysis.figures
    }
    assert "no samples" in refused("B-FOG-005", rig, "likelihood").message
    rig.rows = with_samples
    for one in rig.readings:
        if one.role == "lock_in_1":
            one.value["overload"] = True
    assert "overload" in refused("B-FOG-005", rig).message
    assert analyse(rig.material(), "likelihood").missing
