"""North from eight samples, the printed formulas, uncertainties against scatter, constants by another program."""

from collections.abc import Callable
from dataclasses import replace

import fog_material as sim
import numpy as np
import pytest
from fog_material import single_north
from scipy import optimize

from bench.model.errors import FitError
from bench.systems.north.estimators import phasors
from bench.systems.north.estimators.formulas import literal_north, quadrant_north
from bench.systems.north.estimators.phasors import IDEAL, North, heading_deg, oriented, phase_deg, wrapped_deg

EVERY = np.concatenate((np.arange(-179.5, 180.0, 0.5), [0.0, 90.0, 180.0, -90.0]))
STEPS = np.arange(4) * 90.0
PHI_deg = 33.0
TRUE = (1.6, 1.5, 0.3, 0.7, -2.0, -0.2)  # f1, f2 deg, f3, f4, f5 deg, f6


def samples(
    phi_deg: np.ndarray, f1: float = 1.0, f2: float = 0.0, f4: float = 1.0, f5: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """(13a-d) and (14a-d) as printed, with offsets."""
    phi = np.asarray(phi_deg)[..., None] + STEPS
    return f1 * np.sin(np.deg2rad(phi + f2)) + 0.3, f4 * np.cos(np.deg2rad(phi + f5)) - 0.2


@pytest.mark.parametrize("method", [phasors.eight_sample_north, quadrant_north, single_north])
def test_exact_at_every_azimuth(method: Callable[..., North]) -> None:
    found = method(*samples(EVERY))
    assert np.abs(wrapped_deg(found.phi_deg - EVERY)).max() < 1e-9
    assert np.all((found.phi_deg > -180.0) & (found.phi_deg <= 180.0))
    np.testing.assert_allclose(np.abs(found.phasor), 1.0, atol=1e-12)
    assert found.std_deg.max() < 1e-9


@pytest.mark.validates(
    "north without noise at every azimuth, swing of the table included: below 0.001 degrees",
    against="the azimuth put into the sampled waveform of a second simulation, 0, 90, 180 and 270 degrees among them",
)
def test_sampled_waveform_without_noise(record_property: Callable[[str, object], None]) -> None:
    found = {name: np.abs(one).max() for name, one in sim.errors_deg("constant", 72, noise=0.0).items()}
    record_property("obtained", ", ".join(f"{name} {found[name]:.1e} deg" for name in ("least_squares", "likelihood")))
    for name in ("quadrant", "least_squares", "single", "likelihood"):
        assert found[name] < 1e-3, name


@pytest.mark.validates(
    "FOG paper (15) to (21) as printed miss half of the circle by 180 degrees",
    against="the azimuth of 720 sets of eight samples without noise, and of 600 with the paper's",
)
def test_printed_formulas_fail_on_half_of_the_circle(record_property: Callable[[str, object], None]) -> None:
    azimuth = np.arange(-179.75, 180.0, 0.5)
    phi_deg, failures = literal_north(*samples(azimuth))
    error = wrapped_deg(phi_deg - azimuth)
    wrong = np.abs(azimuth) > 90.0
    np.testing.assert_allclose(np.abs(error[wrong]), 180.0, atol=1e-6)
    np.testing.assert_allclose(error[~wrong], 0.0, atol=1e-6)
    np.testing.assert_array_equal(failures["half_turn"], wrong)
    np.testing.assert_array_equal(np.any(list(failures.values()), axis=0), wrong)
    assert sim.rms(error) == pytest.approx(180.0 / np.sqrt(2.0), abs=0.1)
    noisy = sim.rms(sim.errors_deg("constant", 600, fs=100, noise=sim.SIGMA_V / np.sqrt(10.0), seed=3)["literal"])
    record_property("obtained", f"rms {sim.rms(error):.1f} deg, with noise {noisy:.1f} deg")
    assert 124.5 < noisy < 128.5


def test_printed_formulas_at_the_cardinal_directions() -> None:
    """Nothing over nothing in (19) and (20), U2 = 0 in (21), branches of (17) and (18)."""
    _, failures = literal_north(*samples(np.array([0.0, 90.0, 180.0, -90.0, 37.0])))
    np.testing.assert_array_equal(failures["amplitude_19"], [True, True, True, True, False])
    np.testing.assert_array_equal(failures["amplitude_20"], [True, True, True, True, False])
    np.testing.assert_array_equal(failures["u2_zero"], [False, True, False, True, False])


def test_noise_near_a_cardinal_direction_throws_terms_to_other_branches() -> None:
    """(17) is then the mean of +90, +90, -90 and -90 degrees: 0, and (19) divides by its sine."""
    rng = np.random.default_rng(7)
    u1, u2 = (one + 0.02 * rng.normal(size=one.shape) for one in samples(np.full(2000, 90.0)))
    phi_deg, failures = literal_north(u1, u2)
    assert set(failures["flipped_17"]) == {0, 2}
    flipped = failures["flipped_17"] == 2
    assert 0.3 < flipped.mean() < 0.5
    np.testing.assert_array_equal(failures["amplitude_19"][flipped], True)
    worst = np.abs(wrapped_deg(2.0 * (phi_deg - 90.0)) / 2.0).max()  # half turns forgiven
    assert worst > 30.0
    assert np.abs(wrapped_deg(quadrant_north(u1, u2).phi_deg - 90.0)).max() < 6.0
    assert np.abs(wrapped_deg(phasors.eight_sample_north(u1, u2).phi_deg - 90.0)).max() < 3.0


def pulses_and_averages(
    heading: np.ndarray, sense: int, a_deg: float = 0.0, b_deg: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Lock-ins as the bench wires them, from pulse times on: X of each lock-in at each phase setting."""
    t = np.arange(4000) / 1000.0 + 0.0005
    theta = sense * 360.0 * t
    u = np.cos(np.deg2rad(np.asarray(heading)[..., None] - theta))
    outputs = []
    for place in (270.0 + b_deg, 0.0 + a_deg):
        pulse_s = np.mod(sense * place / 360.0, 1.0)
        setting = -STEPS[:, None]
        reference = np.sin(np.deg2rad(360.0 * (t - pulse_s) + setting))
        outputs.append(np.sqrt(2.0) * (u[..., None, :] * reference).mean(-1))
    return outputs[0], outputs[1]


@pytest.mark.parametrize("sense", [1, -1])
def test_heading_from_the_pulses_of_a_table_turning_either_way(sense: int) -> None:
    heading = np.arange(0.0, 360.0, 7.5)
    u1, u2 = oriented(*pulses_and_averages(heading, sense), sense)
    for method in (phasors.eight_sample_north, quadrant_north, single_north):
        found = heading_deg(method(u1, u2).phi_deg, sense)
        assert np.abs(wrapped_deg(found - heading)).max() < 1e-9
    np.testing.assert_allclose(
        wrapped_deg(phase_deg(heading, sense) - phasors.eight_sample_north(u1, u2).phi_deg), 0, atol=1e-9
    )
    with pytest.raises(ValueError, match=r"neither \+1 nor -1"):
        oriented(u1, u2, 0)


@pytest.mark.parametrize("sense", [1, -1])
def test_misplaced_pulses_are_calibrated(sense: int) -> None:
    at_mark = oriented(*pulses_and_averages(np.array([20.0, 110.0]), sense, a_deg=0.4, b_deg=-1.1), sense)
    known = phasors.calibrate_index(*at_mark, phase_deg(np.array([20.0, 110.0]), sense))
    assert known.f5_deg == pytest.approx(sense * 0.4, abs=1e-9)
    assert known.f2_deg == pytest.approx(sense * -1.1, abs=1e-9)
    heading = np.arange(0.0, 360.0, 7.5)
    u1, u2 = oriented(*pulses_and_averages(heading, sense, a_deg=0.4, b_deg=-1.1), sense)
    for found in (
        phasors.eight_sample_north(u1, u2, known),
        quadrant_north(u1, u2, f5_deg=known.f5_deg),
        single_north(u1, u2, f2_deg=known.f2_deg),
    ):
        assert np.abs(wrapped_deg(heading_deg(found.phi_deg, sense) - heading)).max() < 1e-9
    ignored = wrapped_deg(heading_deg(phasors.eight_sample_north(u1, u2).phi_deg, sense) - heading)
    np.testing.assert_allclose(np.abs(ignored), 0.35, atol=1e-3)  # mean of both placements


def test_the_eight_samples_do_not_tell_a_turn_of_both_pulses() -> None:
    """(21)'s own f5 is not in them: phi + f2 and phi + f5 is all there is, until a placement is known."""
    u1, u2 = samples(np.array([30.0]), f2=2.0, f5=2.0)
    by_quadrant, by_eight = quadrant_north(u1, u2).phi_deg, phasors.eight_sample_north(u1, u2).phi_deg
    for phi_deg in (literal_north(u1, u2)[0], by_quadrant, by_eight):
        assert phi_deg[0] == pytest.approx(32.0, abs=1e-9)
    assert literal_north(u1, u2, f5_deg=2.0)[0] == pytest.approx(30.0, abs=1e-6)


def test_gains_and_an_amplitude_that_changes_between_positions() -> None:
    """Unlike gains turn nothing in the paper's formulas; an amplitude that changes does."""
    grown = np.array([0.8, 0.95, 1.1, 1.2])
    phi = np.arange(-180.0, 180.0, 11.0)
    unlike = quadrant_north(*samples(phi, f1=1.3, f4=0.8))
    assert np.abs(wrapped_deg(unlike.phi_deg - phi)).max() < 1e-9
    u1, u2 = samples(phi, f1=1.1, f2=1.5, f4=0.9, f5=-2.0)
    u1, u2 = grown * (u1 - 0.3), grown * (u2 + 0.2)
    right = phasors.eight_sample_north(u1, u2, replace(IDEAL, f1=1.1, f2_deg=1.5, f4=0.9, f5_deg=-2.0))
    np.testing.assert_allclose(wrapped_deg(right.phi_deg - phi), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.abs(right.phasor), np.sqrt(1.1 * 0.9) * grown.mean(), rtol=1e-9)
    paper = quadrant_north(u1, u2, f5_deg=-2.0)
    assert np.abs(wrapped_deg(paper.phi_deg - phi)).max() > 5.0


def test_pulses_near_or_beyond_ninety_degrees() -> None:
    u1, u2 = samples(np.array([10.0, 20.0, np.nan]), f2=100.0)
    beyond = quadrant_north(u1, u2)
    assert np.isnan([beyond.phi_deg, beyond.std_deg]).all()
    assert np.isfinite(quadrant_north(*samples(np.array([10.0]), f2=85.0)).phi_deg).all()
    with pytest.raises(FitError, match=r"B-FIT-111.*100\.0 degrees"):
        phasors.calibrate_index(u1[:2], u2[:2], np.array([10.0, 20.0]))
    with pytest.raises(FitError, match="B-FIT-111"):  # lock-in 1 has the wrong sign: the sense was not told
        phasors.calibrate_index(*pulses_and_averages(np.array([20.0]), -1), phase_deg(np.array([20.0]), -1))


def test_wrong_shapes_and_lost_values() -> None:
    with pytest.raises(FitError, match=r"B-FIT-110.*\(3,\)"):
        oriented(np.ones(3), np.ones(3), 1)
    with pytest.raises(FitError, match="B-FIT-110"):
        oriented(np.ones((2, 4)), np.ones(4), 1)
    with pytest.raises(FitError, match="B-FIT-113"):
        phasors.calibrate_index(np.zeros((2, 4)), np.zeros((2, 4)), 20.0)
    u1, u2 = samples(np.array([10.0, 20.0, 30.0]))
    u1[1, 2] = np.nan
    for method in (phasors.eight_sample_north, quadrant_north):
        found = method(u1, u2)
        np.testing.assert_array_equal(np.isfinite(found.phi_deg), [True, False, True])
        np.testing.assert_array_equal(np.isfinite(found.std_deg), [True, False, True])
    silent = phasors.eight_sample_north(np.zeros(4), np.zeros(4))
    assert np.isnan(silent.phi_deg)


def test_stated_noise_and_uncertainty_are_the_scatter_of_many_sets() -> None:
    rng = np.random.default_rng(91)
    phi_deg = rng.uniform(-180.0, 180.0, 4000)
    u1, u2 = (one + 0.01 * rng.normal(size=one.shape) for one in samples(phi_deg))
    found = quadrant_north(u1, u2)
    scatter_deg = np.sqrt(np.mean(np.square(wrapped_deg(found.phi_deg - phi_deg))))
    assert np.sqrt(np.mean(found.noise**2)) == pytest.approx(0.01, rel=0.03)
    assert np.sqrt(np.mean(found.std_deg**2)) == pytest.approx(scatter_deg, rel=0.05)


def test_failures_are_told_of_the_lock_in_that_has_them() -> None:
    """Noise in lock-in 2 alone, 2 degrees from where its first and third sample vanish."""
    rng = np.random.default_rng(92)
    u1, u2 = samples(np.full(400, 88.0))
    _, failures = literal_north(u1, u2 + 0.05 * rng.normal(size=u2.shape))
    assert not failures["flipped_17"].any()
    assert not failures["amplitude_19"].any()
    flipped = failures["flipped_18"] > 0
    assert 0.2 < flipped.mean() < 0.8
    assert failures["amplitude_20"][flipped].all()


def model(_: object, f1: float, f2: float, f3: float, f4: float, f5: float, f6: float) -> np.ndarray:
    """(13a-d) and (14a-d) at the known phase."""
    phi = np.deg2rad(PHI_deg + STEPS)
    return np.concatenate((f1 * np.sin(phi + np.deg2rad(f2)) + f3, f4 * np.cos(phi + np.deg2rad(f5)) + f6))


@pytest.fixture(scope="module")
def noisy() -> np.ndarray:
    return model(None, *TRUE) + 0.01 * np.random.default_rng(81).normal(size=8)


def known(samples: np.ndarray) -> phasors.IndexCalibration:
    return phasors.calibrate_index(samples[None, :4], samples[None, 4:], PHI_deg)


def test_every_constant_and_its_uncertainty_are_those_of_a_non_linear_fit(noisy: np.ndarray) -> None:
    values, covariance = optimize.curve_fit(model, np.arange(8.0), noisy, p0=TRUE)
    found = known(noisy)
    ours = (found.f1, found.f2_deg, found.f3, found.f4, found.f5_deg, found.f6)
    np.testing.assert_allclose(ours, values, rtol=1e-5)
    np.testing.assert_allclose(found.covariance, covariance[np.ix_([0, 1, 3, 4], [0, 1, 3, 4])], rtol=1e-4, atol=1e-8)
    assert found.dof == 2.0
    np.testing.assert_allclose(found.gains, np.array([1.6, 0.7]) / np.sqrt(1.12), rtol=0.02)


@pytest.mark.parametrize("method", ["least_squares", "quadrant", "literal"])
def test_what_the_calibration_adds_is_what_a_wrong_placement_does(noisy: np.ndarray, method: str) -> None:
    """Each placement is put wrong by its own standard uncertainty, and the azimuths are found again."""
    found = known(noisy)
    exact = model(None, *TRUE)
    parts = []
    for place, std in ((1, found.covariance[1, 1]), (4, found.covariance[3, 3])):
        wrong = np.array(TRUE)
        wrong[place] += np.sqrt(std)
        phi_deg = azimuth(method, exact, wrong) - azimuth(method, exact, np.array(TRUE))
        parts.append(float(wrapped_deg(phi_deg)))
    assert found.std_deg(method) == pytest.approx(np.hypot(*parts), rel=1e-3)
    assert found.covariance[3, 3] > 4.0 * found.covariance[1, 1]  # so that the two cannot stand for each other


def azimuth(method: str, samples: np.ndarray, constants: np.ndarray) -> float:
    index = constants_of(constants)
    if method == "least_squares":
        return float(phasors.eight_sample_north(samples[:4], samples[4:], index).phi_deg)
    return float(quadrant_north(samples[:4], samples[4:], f5_deg=index.f5_deg).phi_deg)


def constants_of(values: np.ndarray) -> phasors.IndexCalibration:
    return replace(IDEAL, **dict(zip(("f1", "f2_deg", "f3", "f4", "f5_deg", "f6"), values.tolist(), strict=True)))


def test_noise_and_uncertainty_with_known_constants(noisy: np.ndarray) -> None:
    """Noise: what numpy's least squares with these gains and placements leave. Uncertainty: by steps of each sample."""
    f1, f2, _, f4, f5, _ = np.array(TRUE)
    gains, index = (f1 / np.sqrt(f1 * f4), f4 / np.sqrt(f1 * f4)), constants_of(np.array(TRUE))

    def phi_deg(samples: np.ndarray) -> float:
        return float(phasors.eight_sample_north(samples[:4], samples[4:], index).phi_deg)

    at_1, at_2, ones = np.deg2rad(STEPS + f2), np.deg2rad(STEPS + f5), np.ones(4)
    design = np.block([
        [gains[0] * np.column_stack((np.sin(at_1), np.cos(at_1))), np.outer(ones, (1.0, 0.0))],
        [gains[1] * np.column_stack((np.cos(at_2), -np.sin(at_2))), np.outer(ones, (0.0, 1.0))],
    ])  # fmt: skip
    left = np.linalg.lstsq(design, noisy)[1]
    found = phasors.eight_sample_north(noisy[:4], noisy[4:], index)
    assert found.noise == pytest.approx(np.sqrt(left[0] / 4.0), rel=1e-9)
    steps = [(phi_deg(noisy + 1e-5 * one) - phi_deg(noisy - 1e-5 * one)) / 2e-5 for one in np.eye(8)]
    assert found.std_deg == pytest.approx(float(found.noise) * np.linalg.norm(steps), rel=0.02)


@pytest.mark.parametrize("silent", [slice(0, 4), slice(4, 8)])
def test_one_lock_in_without_a_signal_is_no_calibration(noisy: np.ndarray, silent: slice) -> None:
    noisy = noisy.copy()
    noisy[silent] = 0.0
    with pytest.raises(FitError, match="B-FIT-113"):
        known(noisy)
