"""North from eight samples without noise: every azimuth, what the printed formulas do, senses, placements, errors."""

from __future__ import annotations

from collections.abc import Callable

import north_simulation as sim
import numpy as np
import pytest
from single_north import single_north

from bench.model.errors import FitError
from bench.systems.north.estimators.calibration import calibrate_index
from bench.systems.north.estimators.eight_samples import eight_sample_north
from bench.systems.north.estimators.literal import literal_north
from bench.systems.north.estimators.phasors import North, heading_deg, oriented, phase_deg, wrapped_deg
from bench.systems.north.estimators.quadrant import quadrant_north

EVERY = np.concatenate((np.arange(-179.5, 180.0, 0.5), [0.0, 90.0, 180.0, -90.0]))
STEPS = np.arange(4) * 90.0


def samples(
    phi_deg: np.ndarray, f1: float = 1.0, f2: float = 0.0, f4: float = 1.0, f5: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """(13a-d) and (14a-d) as printed, with offsets."""
    phi = np.asarray(phi_deg)[..., None] + STEPS
    return f1 * np.sin(np.deg2rad(phi + f2)) + 0.3, f4 * np.cos(np.deg2rad(phi + f5)) - 0.2


@pytest.mark.parametrize("method", [eight_sample_north, quadrant_north, single_north])
def test_exact_at_every_azimuth(method: Callable[..., North]) -> None:
    found = method(*samples(EVERY))
    assert np.abs(wrapped_deg(found.phi_deg - EVERY)).max() < 1e-9
    assert np.all((found.phi_deg > -180.0) & (found.phi_deg <= 180.0))
    np.testing.assert_allclose(found.amplitude, 1.0, atol=1e-12)
    np.testing.assert_allclose(found.offset_1, 0.3, atol=1e-12)
    np.testing.assert_allclose(found.offset_2, -0.2, atol=1e-12)
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
    found = literal_north(*samples(azimuth))
    error = wrapped_deg(found.north.phi_deg - azimuth)
    wrong = np.abs(azimuth) > 90.0
    np.testing.assert_allclose(np.abs(error[wrong]), 180.0, atol=1e-6)
    np.testing.assert_allclose(error[~wrong], 0.0, atol=1e-6)
    np.testing.assert_array_equal(found.failures.half_turn, wrong)
    np.testing.assert_array_equal(found.failures.any, wrong)
    assert sim.rms(error) == pytest.approx(180.0 / np.sqrt(2.0), abs=0.1)
    noisy = sim.rms(sim.errors_deg("constant", 600, fs=100, noise=sim.SIGMA_V / np.sqrt(10.0), seed=3)["literal"])
    record_property("obtained", f"rms {sim.rms(error):.1f} deg, with noise {noisy:.1f} deg")
    assert 124.5 < noisy < 128.5


def test_printed_formulas_at_the_cardinal_directions() -> None:
    """Nothing over nothing in (19) and (20), U2 = 0 in (21), branches of (17) and (18)."""
    failures = literal_north(*samples(np.array([0.0, 90.0, 180.0, -90.0, 37.0]))).failures
    np.testing.assert_array_equal(failures.amplitude_19, [True, True, True, True, False])
    np.testing.assert_array_equal(failures.amplitude_20, [True, True, True, True, False])
    np.testing.assert_array_equal(failures.u2_zero, [False, True, False, True, False])


def test_noise_near_a_cardinal_direction_throws_terms_to_other_branches() -> None:
    """(17) is then the mean of +90, +90, -90 and -90 degrees: 0, and (19) divides by its sine."""
    rng = np.random.default_rng(7)
    u1, u2 = (one + 0.02 * rng.normal(size=one.shape) for one in samples(np.full(2000, 90.0)))
    found = literal_north(u1, u2)
    assert set(found.failures.flipped_17) == {0, 2}
    flipped = found.failures.flipped_17 == 2
    assert 0.3 < flipped.mean() < 0.5
    np.testing.assert_array_equal(found.failures.amplitude_19[flipped], True)
    worst = np.abs(wrapped_deg(2.0 * (found.north.phi_deg - 90.0)) / 2.0).max()  # half turns forgiven
    assert worst > 30.0
    assert np.abs(wrapped_deg(quadrant_north(u1, u2).phi_deg - 90.0)).max() < 6.0
    assert np.abs(wrapped_deg(eight_sample_north(u1, u2).phi_deg - 90.0)).max() < 3.0


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
    for method in (eight_sample_north, quadrant_north, single_north):
        found = heading_deg(method(u1, u2).phi_deg, sense)
        assert np.abs(wrapped_deg(found - heading)).max() < 1e-9
    np.testing.assert_allclose(
        wrapped_deg(phase_deg(heading, sense) - eight_sample_north(u1, u2).phi_deg), 0, atol=1e-9
    )
    with pytest.raises(ValueError, match=r"neither \+1 nor -1"):
        oriented(u1, u2, 0)


@pytest.mark.parametrize("sense", [1, -1])
def test_misplaced_pulses_are_calibrated(sense: int) -> None:
    at_mark = oriented(*pulses_and_averages(np.array([20.0, 110.0]), sense, a_deg=0.4, b_deg=-1.1), sense)
    known = calibrate_index(*at_mark, phase_deg(np.array([20.0, 110.0]), sense))
    assert known.f5_deg == pytest.approx(sense * 0.4, abs=1e-9)
    assert known.f2_deg == pytest.approx(sense * -1.1, abs=1e-9)
    heading = np.arange(0.0, 360.0, 7.5)
    u1, u2 = oriented(*pulses_and_averages(heading, sense, a_deg=0.4, b_deg=-1.1), sense)
    for found in (
        eight_sample_north(u1, u2, gains=known.gains, f2_deg=known.f2_deg, f5_deg=known.f5_deg),
        quadrant_north(u1, u2, f5_deg=known.f5_deg),
        single_north(u1, u2, f2_deg=known.f2_deg),
    ):
        assert np.abs(wrapped_deg(heading_deg(found.phi_deg, sense) - heading)).max() < 1e-9
    ignored = wrapped_deg(heading_deg(eight_sample_north(u1, u2).phi_deg, sense) - heading)
    np.testing.assert_allclose(np.abs(ignored), 0.35, atol=1e-3)  # mean of both placements


def test_the_eight_samples_do_not_tell_a_turn_of_both_pulses() -> None:
    """(21)'s own f5 is not in them: phi + f2 and phi + f5 is all there is."""
    u1, u2 = samples(np.array([30.0]), f2=2.0, f5=2.0)
    for found in (literal_north(u1, u2).north, quadrant_north(u1, u2), eight_sample_north(u1, u2)):
        assert found.phi_deg[0] == pytest.approx(32.0, abs=1e-9)


def test_gains_and_an_amplitude_that_changes_between_positions() -> None:
    grown = np.array([0.8, 0.95, 1.1, 1.2])
    phi = np.arange(-180.0, 180.0, 11.0)
    u1, u2 = samples(phi, f1=1.1, f2=1.5, f4=0.9, f5=-2.0)
    u1, u2 = grown * (u1 - 0.3), grown * (u2 + 0.2)
    right = eight_sample_north(u1, u2, gains=(1.1, 0.9), f2_deg=1.5, f5_deg=-2.0)
    np.testing.assert_allclose(wrapped_deg(right.phi_deg - phi), 0.0, atol=1e-9)
    np.testing.assert_allclose(right.amplitude, grown.mean(), rtol=1e-9)
    paper = quadrant_north(u1, u2, f5_deg=-2.0)
    assert np.abs(wrapped_deg(paper.phi_deg - phi)).max() > 5.0


def test_pulses_near_or_beyond_ninety_degrees() -> None:
    u1, u2 = samples(np.array([10.0, 20.0, np.nan]), f2=100.0)
    assert np.isnan(quadrant_north(u1, u2).phi_deg).all()
    assert np.isfinite(quadrant_north(*samples(np.array([10.0]), f2=85.0)).phi_deg).all()
    with pytest.raises(FitError, match=r"B-FIT-111.*100\.0 degrees"):
        eight_sample_north(u1, u2, f2_deg=100.0)
    with pytest.raises(FitError, match="B-FIT-111"):  # lock-in 1 has the wrong sign: the sense was not told
        calibrate_index(*pulses_and_averages(np.array([20.0]), -1), phase_deg(np.array([20.0]), -1))


def test_wrong_shapes_and_lost_values() -> None:
    with pytest.raises(FitError, match=r"B-FIT-110.*\(3,\)"):
        eight_sample_north(np.ones(3), np.ones(3))
    with pytest.raises(FitError, match="B-FIT-110"):
        quadrant_north(np.ones((2, 4)), np.ones(4))
    with pytest.raises(FitError, match="B-FIT-113"):
        calibrate_index(np.zeros((2, 4)), np.zeros((2, 4)), 20.0)
    u1, u2 = samples(np.array([10.0, 20.0, 30.0]))
    u1[1, 2] = np.nan
    for method in (eight_sample_north, quadrant_north):
        found = method(u1, u2)
        np.testing.assert_array_equal(np.isfinite(found.phi_deg), [True, False, True])
        np.testing.assert_array_equal(np.isfinite(found.std_deg), [True, False, True])
    silent = eight_sample_north(np.zeros(4), np.zeros(4))
    assert np.isnan(silent.phi_deg)
