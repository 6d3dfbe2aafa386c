"""North from raw samples, its bound and its time against other fits; tilt of the axis against turned vectors."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import fog_material as sim
import numpy as np
import pytest
from fog_material import Gyro, NorthRig, campaign
from scipy import optimize, signal, stats
from scipy.spatial.transform import Rotation

from bench.model.errors import FitError
from bench.systems.north.estimators.likelihood import (
    SQUARE_PENALTY,
    LikelihoodNorth,
    likelihood_north,
    north_bound_deg,
    time_to_accuracy_s,
)
from bench.systems.north.estimators.phasors import (
    heading_deg,
    tilt_correction_deg,
    tilt_std_deg,
    wrapped_deg,
)
from bench.systems.north.report import FALSE_CLAIM, harmonic_table, north_notes
from bench.systems.north.sets import north_sets, waveform_of
from bench.systems.north.solution import LIKELIHOOD, Solution, accuracies
from bench.systems.north.solve import HARMONICS, site_of, solved

FS = 100
T = (np.arange(20 * FS) + 0.5) / FS
THETA = 360.0 * T


def test_the_same_as_a_non_linear_fit_of_amplitude_and_phase() -> None:
    rng = np.random.default_rng(31)
    theta = np.deg2rad(THETA + 3.0 * np.sin(2 * np.pi * 0.3 * T))
    u = 1.3 * np.sin(theta + 2.5) + 0.2 + 0.1 * np.sin(2 * theta + 0.4) + 0.3 * rng.normal(size=T.size)

    def model(angle: np.ndarray, size: float, phi: float, offset: float, second: float, at: float) -> np.ndarray:
        return size * np.sin(angle + phi) + offset + second * np.sin(2 * angle + at)

    values, covariance = optimize.curve_fit(model, theta, u, p0=(1.0, 2.4, 0.0, 0.1, 0.5))
    found = likelihood_north(u, np.mod(np.rad2deg(theta), 360.0), harmonics=(2,))
    assert found.phi_deg == pytest.approx(np.rad2deg(values[1]), abs=1e-5)
    assert found.std_deg == pytest.approx(np.rad2deg(np.sqrt(covariance[1, 1])), rel=1e-4)
    assert found.amplitude == pytest.approx(values[0], rel=1e-6)
    assert found.offset_V == pytest.approx(values[2], abs=1e-6)
    assert abs(found.harmonics[0]) == pytest.approx(values[3], rel=1e-5)
    assert np.angle(found.harmonics[0]) == pytest.approx(values[4], abs=1e-5)
    assert found.bound_deg == pytest.approx(found.std_deg, rel=0.01)
    assert found.dof == T.size - 5
    assert not found.widened


def test_missing_samples_are_left_out_and_counted() -> None:
    rng = np.random.default_rng(32)
    u = np.sin(np.deg2rad(THETA + 77.0)) + 0.1 * rng.normal(size=(2, T.size))
    u[1, rng.choice(T.size, 150, replace=False)] = np.nan
    u[1, 700:960] = np.nan
    found = sim.likelihoods(u, np.mod(THETA, 360.0))
    lost = int(np.isnan(u[1]).sum())
    np.testing.assert_array_equal(found.dropped, [0, lost])
    np.testing.assert_array_equal(found.samples, [T.size, T.size - lost])
    kept = np.isfinite(u[1])
    alone = likelihood_north(u[1, kept], THETA[kept])
    assert found.phi_deg[1] == alone.phi_deg
    assert found.bound_deg[1] == alone.bound_deg
    assert np.all(np.abs(wrapped_deg(found.phi_deg - 77.0)) < sim.half_widths_deg(found.std_deg, found.dof, 0.999))
    assert found.std_deg[1] > found.std_deg[0]


def test_noise_that_is_not_white_widens_the_interval() -> None:
    """Noise that is mostly below 3 Hz: white noise's formula would be 3 times too sure."""
    rng = np.random.default_rng(34)
    white = 0.3 * rng.normal(size=(400, 2 * T.size))
    red = signal.lfilter([1.0], [1.0, -0.9], white, axis=1)[:, T.size :]
    found = sim.likelihoods(np.sin(np.deg2rad(THETA)) + red, THETA)
    errors = wrapped_deg(found.phi_deg)
    assert sim.rms(errors) > 2.5 * sim.rms(found.bound_deg)
    assert found.widened.mean() > 0.99
    assert float(np.mean(np.abs(errors) < sim.half_widths_deg(found.std_deg, found.dof))) == pytest.approx(
        0.95, abs=0.03
    )
    even = sim.likelihoods(np.sin(np.deg2rad(THETA)) + white[:, : T.size], THETA)
    assert even.widened.mean() < 0.03  # 1 % by chance
    assert even.whiteness.mean() == pytest.approx(1.0, abs=0.06)


def test_uncertainty_on_a_part_of_a_turn_is_that_of_the_direction_that_turns_north() -> None:
    """A third of a turn: amplitude and direction are far from equally well known."""
    theta = np.mod(THETA, 120.0)
    u = np.sin(np.deg2rad(theta + 10.0)) + 0.05 * np.random.default_rng(36).normal(size=T.size)

    def model(angle: np.ndarray, size: float, phi: float, offset: float) -> np.ndarray:
        return size * np.sin(angle + phi) + offset

    values, covariance = optimize.curve_fit(model, np.deg2rad(theta), u, p0=(1.0, 0.2, 0.0))
    found = likelihood_north(u, theta)
    assert found.std_deg == pytest.approx(np.rad2deg(np.sqrt(covariance[1, 1])), rel=1e-3)
    assert covariance[0, 0] / values[0] ** 2 > 4.0 * covariance[1, 1]


def test_the_scatter_of_turns_is_seen_behind_an_encoder_that_begins_again_each_turn() -> None:
    """Six turns and a tenth: five degrees of freedom, and the piece of a turn at the end is none of them."""
    theta, rng = THETA[:610], np.random.default_rng(37)
    u = np.sin(np.deg2rad(theta)) + 0.3 * rng.normal(size=(400, theta.size))
    found = sim.likelihoods(u, np.mod(theta, 360.0))
    np.testing.assert_allclose(found.whiteness, sim.likelihoods(u, theta).whiteness)
    assert found.whiteness.mean() == pytest.approx(1.0, abs=0.1)  # standard deviation of the mean 0.03
    swayed = np.repeat([0.1, -0.1, 0.1, -0.1, 0.1, -0.1], 100)
    turned = likelihood_north(np.sin(np.deg2rad(THETA[:600]) + swayed) + 1e-3 * rng.normal(size=600), THETA[:600])
    assert (turned.widened, turned.dof) == (True, 5.0)
    assert turned.std_deg == pytest.approx(np.rad2deg(0.1 / np.sqrt(5.0)), rel=0.02)  # of six values of 0.1 each


def test_few_turns_have_no_scatter_to_look_at_and_weak_signals_may_point_anywhere() -> None:
    found = likelihood_north(np.sin(np.deg2rad(THETA[:350])), THETA[:350])
    assert np.isnan(found.whiteness)
    assert not found.widened
    rng = np.random.default_rng(35)
    weak = sim.likelihoods(1e-3 * np.sin(np.deg2rad(THETA)) + rng.normal(size=(50, T.size)), THETA)
    assert np.mean(sim.half_widths_deg(weak.std_deg, weak.dof) == 180.0) > 0.5


@pytest.mark.parametrize(
    ("kept", "angles_deg", "said"),
    [
        (slice(None), np.mod(THETA, 80.0), r"too little of a turn \(separation"),
        (slice(3), THETA[:3], "3 good samples for 3 unknowns"),
        (slice(None), THETA[:-1], "do not belong together"),
    ],
)
def test_angles_that_do_not_determine_north(kept: slice, angles_deg: np.ndarray, said: str) -> None:
    with pytest.raises(FitError, match=f"B-FIT-112.*{said}"):
        likelihood_north(np.sin(np.deg2rad(THETA))[kept], angles_deg)


STEPS_deg = np.arange(0.0, 360.0, 2.0)


def east_north(heading: float) -> np.ndarray:
    """Level unit vector towards a heading, in east, north, up."""
    return np.array([np.sin(np.deg2rad(heading)), np.cos(np.deg2rad(heading)), 0.0])


def found_heading(heading: float, x_mrad: float, y_mrad: float, latitude_deg: float) -> float:
    """Heading found on a table whose axis is tilted: every vector turned, no angle taken as small."""
    latitude = np.deg2rad(latitude_deg)
    earth = np.array([0.0, np.cos(latitude), np.sin(latitude)])
    tilt = Rotation.from_rotvec(1e-3 * (x_mrad * east_north(heading) + y_mrad * east_north(heading + 90.0)))
    level = np.array(
        [Rotation.from_rotvec([0, 0, np.deg2rad(theta)]).apply(east_north(heading)) for theta in STEPS_deg]
    )
    return float(heading_deg(likelihood_north(tilt.apply(level) @ earth, STEPS_deg).phi_deg, 1))


@pytest.mark.validates(
    "north is corrected for the tilt of the rotation axis, size and sign",
    against="the Earth's rate on a sensing axis turned by scipy's rotations, headings all round, latitudes -60 to 75",
)
def test_tilt_against_turned_vectors(record_property: Callable[[str, object], None]) -> None:
    rng, before, after = np.random.default_rng(41), [], []
    for heading in np.arange(0.0, 360.0, 24.0):
        for latitude in (-60.0, 0.0, 37.0, 75.0):
            x, y = rng.uniform(-2.0, 2.0, 2)
            found = found_heading(heading, x, y, latitude)
            corrected = found + float(tilt_correction_deg(x, y, found, latitude))
            before.append(abs(float(wrapped_deg(found - heading))))
            after.append(abs(float(wrapped_deg(corrected - heading))) / (1.0 + np.tan(np.deg2rad(latitude)) ** 2))
    record_property("obtained", f"up to {max(before):.3f} deg before, {max(after):.1e} (1 + tan^2) deg behind")
    assert max(before) > 0.3
    assert max(after) < 3e-4  # square of 2.8 mrad


def test_one_arcminute_that_nobody_measured() -> None:
    """At 37 degrees 1 arcmin of lean to the east turns north by 0.75 arcmin, on either hemisphere."""
    assert tilt_std_deg(1e3 * np.deg2rad(1.0 / 60.0), -37.0) * 60.0 == pytest.approx(0.7536, abs=1e-4)


@pytest.mark.parametrize("latitude_deg", [89.5, -90.0, float("nan")])
def test_there_is_no_north_at_a_pole(latitude_deg: float) -> None:
    with pytest.raises(FitError, match="B-FIT-115"):
        tilt_correction_deg(0.1, 0.1, 20.0, latitude_deg)


def test_bound_is_the_inverse_of_the_information() -> None:
    """Fisher's matrix of amplitude, phase and offset from differences of the model."""
    theta, at, step = np.deg2rad(np.arange(2000) * 1.8 + 0.9), np.array([0.8, 1.1, 0.3]), 1e-6

    def model(values: np.ndarray) -> np.ndarray:
        return values[0] * np.sin(theta + values[1]) + values[2]

    slopes = np.array([(model(at + step * one) - model(at - step * one)) / (2 * step) for one in np.eye(3)])
    least = np.sqrt(np.linalg.inv(slopes @ slopes.T / 0.6**2)[1, 1])
    assert float(north_bound_deg(0.8, 0.6, 2000)) == pytest.approx(np.rad2deg(least), rel=1e-6)


def test_penalty_of_a_square_reference() -> None:
    """Noise power over the square of the signal, square reference against sine, by sums over a turn."""
    angle = 2 * np.pi * (np.arange(100_000) + 0.5) / 100_000
    square, sine = np.sign(np.sin(angle)), np.sin(angle)
    power = [np.mean(one**2) / np.mean(one * sine) ** 2 for one in (square, sine)]
    assert pytest.approx(np.sqrt(power[0] / power[1]), rel=1e-6) == SQUARE_PENALTY
    assert pytest.approx(1.1107, abs=1e-4) == SQUARE_PENALTY


def test_time_to_reach_an_accuracy() -> None:
    assert float(time_to_accuracy_s(0.45, 20.0, 0.1)) == pytest.approx(405.0)
    np.testing.assert_allclose(time_to_accuracy_s([0.45, 0.9], 20.0, 0.1, factor=2.0), [1620.0, 6480.0])
    assert float(time_to_accuracy_s(0.45, 20.0, 0.1, floor_deg=0.06)) == pytest.approx(405.0 / 0.64)
    assert float(time_to_accuracy_s(0.45, 20.0, 0.1, factor=2.0, floor_deg=0.05)) == np.inf
    with pytest.raises(FitError, match=r"B-FIT-114.*0 deg after 20 s"):
        time_to_accuracy_s(0.45, 20.0, 0.0)


def test_width_of_an_interval() -> None:
    widths = sim.half_widths_deg(np.array([0.01, 1.0, 40.0, np.nan]), np.array([4.0, np.inf, 4.0, 4.0]))
    np.testing.assert_allclose(widths[:2], [0.01 * stats.t.ppf(0.975, 4), 1.96], rtol=1e-3)
    assert widths[2] == 180.0
    assert np.isnan(widths[3])


SEED, HARMONICS_SEED = 41, 51
SAID = "The turns of all waveforms do not scatter as white noise would"


@pytest.fixture(scope="module")
def rig() -> NorthRig:
    return campaign(NorthRig(SEED, Gyro(noise_V=0.2)), (0.0, 90.0), 2)


@pytest.fixture(scope="module")
def fits(rig: NorthRig) -> list[LikelihoodNorth]:
    waveforms = [waveform_of(north_set) for north_set in north_sets(rig.material())]
    return [likelihood_north(each.u_V, each.theta_deg) for each in waveforms if each is not None]


def of_fits(rig: NorthRig, fits: list[LikelihoodNorth]) -> Solution:
    material = rig.material()
    return solved(north_sets(material), site_of(material.campaign), fits, 0.0)


def notes(solution: Solution) -> str:
    return "\n".join(north_notes(solution, LIKELIHOOD, accuracies(solution, 0.5)))


@pytest.mark.parametrize("ratio", [0.6, 1.6])
def test_what_all_turns_say_is_the_noise_of_all_sets(rig: NorthRig, fits: list[LikelihoodNorth], ratio: float) -> None:
    """One set that was widened by itself is not widened twice."""
    white_deg2 = np.array([fit.std_deg**2 for fit in fits])
    said = [replace(fit, whiteness=ratio, widened=False) for fit in fits]
    said[1] = replace(said[1], std_deg=said[1].std_deg * np.sqrt(ratio), widened=True)
    solution = of_fits(rig, said)
    found = solution.by_method[LIKELIHOOD]
    assert found.noise_deg == pytest.approx(np.sqrt(ratio * white_deg2.mean()))
    assert found.dof == pytest.approx(sum(fit.turns - 1 for fit in fits))
    assert f"{SAID} ({np.sqrt(ratio):.2f} times" in notes(solution)
    seconds = accuracies(solution, 0.5)[1]
    relative = np.sqrt(2.0 / found.dof)  # of the turns, not of the samples; the amplitude is known far better
    assert seconds.time_std_s / seconds.time_s == pytest.approx(relative, rel=0.01)


def test_turns_of_white_noise_change_nothing(rig: NorthRig, fits: list[LikelihoodNorth]) -> None:
    solution = of_fits(rig, fits)
    assert not any(fit.widened for fit in fits)
    assert solution.by_method[LIKELIHOOD].noise_deg == pytest.approx(np.sqrt(np.mean([fit.std_deg**2 for fit in fits])))
    assert SAID not in notes(solution)


def test_a_set_is_widened_at_the_significance_asked_for() -> None:
    theta = np.arange(600) * 3.6
    u = np.sin(np.deg2rad(theta)) + 0.3 * np.random.default_rng(SEED).normal(size=(200, theta.size))
    found = sim.likelihoods(u, theta, significance=0.2)
    due = stats.f.sf(found.whiteness, 5, 597) < 0.2
    np.testing.assert_array_equal(found.widened, due)
    assert 20 < due.sum() < 60
    np.testing.assert_allclose(found.white_std_deg[due], (found.std_deg / np.sqrt(found.whiteness))[due])
    np.testing.assert_array_equal(found.white_std_deg[~due], found.std_deg[~due])


@pytest.mark.parametrize(
    ("reports", "least", "most"), [(300, 0, 10), pytest.param(6000, 38, 88, marks=pytest.mark.sweep)]
)  # fmt: skip
def test_noise_alone_claims_a_harmonic_once_in_a_hundred_tables(reports: int, least: int, most: int) -> None:
    """A signal of 1 V in white noise of 0.3 V and nothing else, four waveforms a table."""
    found, theta_deg = 0, 360.0 * 20 * (np.arange(400) + 0.5) / 400
    for report in range(reports):
        rng = np.random.default_rng([HARMONICS_SEED, report])
        u = np.sin(np.deg2rad(theta_deg + 25.0)) + 0.3 * rng.standard_normal((4, 400))
        raw = [likelihood_north(one, theta_deg, harmonics=HARMONICS) for one in u]
        (table,) = harmonic_table(SimpleNamespace(raw=raw))  # type: ignore[arg-type]
        found += any(not str(row[1]).startswith("below") for row in table.rows)
    print(
        f"seed {HARMONICS_SEED}: {found} of {reports} tables of noise claim a harmonic, {100 * FALSE_CLAIM:g} % are due"
    )
    assert least <= found <= most
