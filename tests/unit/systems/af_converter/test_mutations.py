"""Mistakes the fit must not make: each mutant breaks an acceptance figure that the right code holds."""

import dataclasses
from collections.abc import Callable

import fit_simulation as sim
import numpy as np
import pytest
from stated_estimates import entries_of

from bench.systems.af_converter import group_fit
from bench.systems.af_converter.estimators import readings
from bench.systems.af_converter.estimators import scale_factor as code
from bench.systems.af_converter.estimators.readings import Bias, Converter, RangeSpecification, Readings
from bench.systems.af_converter.estimators.scale_factor import fit_scale_factor
from bench.systems.af_converter.groups import group_rows

STANDARD = {full: RangeSpecification(20e-6, floor) for full, floor in sim.FLOOR_A.items()}
GYRO = Converter(sim.KIND["gyro"]["k0_C"], sim.F_AF0_Hz, **sim.NOISE)
NOISE_FREE = sim.Switches(gain=False, calibrator_errors=False, noise=False, quantised=False, lag=False)
GAIN_OFF_LIMIT_ppm = 8.0


def group(seed: int, switches: sim.Switches) -> tuple[Readings, np.ndarray]:
    campaign = sim.simulate(seed, switches, {1: "gyro"}, temperatures=(20.0,))
    closed = group_rows(campaign.rows, sim.MASTER_Hz)[0].closed
    return closed, campaign.units[1].dsf(float(closed.unit_temperature_degC.mean()))


def worst_ppm(rows: Readings, truth: np.ndarray, method: str = "gls") -> float:
    return float(np.max(np.abs(fit_scale_factor(rows, GYRO, STANDARD, method).dsf_ppm - truth)))


@pytest.mark.validates(
    "misprint of AF paper (7): the positive zero taken for the negative one is noticed",
    against="counts made from the physics, no noise, offset 6 nA",
)
def test_positive_zero_used_as_negative_zero(
    record_property: Callable[[str, object], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Equation (7) as printed: design figure right < 0.01 ppm, mutant > 40 ppm at an offset of 6 nA."""
    switches = dataclasses.replace(NOISE_FREE, offset_A=6e-9, zero_in_every_range=True)
    rows, truth = group(7, switches)
    assert worst_ppm(rows, truth, "paper") < 0.01
    assert worst_ppm(rows, truth) < 0.01
    right = code.zero_difference

    def mutant(rows: Readings) -> np.ndarray:
        difference = right(rows)
        for zero in np.flatnonzero((rows.level_A == 0) & (rows.polarity < 0)):
            positive = np.flatnonzero((rows.level_A == 0) & (rows.polarity > 0) & (rows.range_A == rows.range_A[zero]))
            difference[:, positive[0]] += difference[:, zero]
            difference[:, zero] = 0.0
        return difference

    good_ppm = worst_ppm(rows, truth, "paper")
    monkeypatch.setattr(code, "zero_difference", mutant)
    as_printed_ppm = worst_ppm(rows, truth, "paper")
    record_property("obtained", f"corrected {good_ppm:.1e} ppm off, as printed {as_printed_ppm:.0f} ppm")
    assert as_printed_ppm > 40.0


@pytest.mark.validates(
    "AF paper (1): clock ratio r applied to every count",
    against="counts made with both clocks off by 50 ppm; without r the error must show",
)
@pytest.mark.parametrize("clock", ["af_error", "master_error"])
@pytest.mark.parametrize("error", [50e-6, -50e-6])
def test_clock_ratio_left_out(monkeypatch: pytest.MonkeyPatch, clock: str, error: float) -> None:
    """Acceptance: 50 ppm of clock error changes DSF by less than 0.1 ppm; without r by about 50 ppm."""
    exact, truth = group(12, NOISE_FREE)
    off, _ = group(12, dataclasses.replace(NOISE_FREE, **{clock: error + getattr(NOISE_FREE, clock)}))

    def change_ppm() -> float:
        fits = [fit_scale_factor(rows, GYRO, STANDARD).dsf_ppm for rows in (off, exact)]
        return float(np.max(np.abs(fits[0] - fits[1])))

    assert change_ppm() < 0.1
    assert worst_ppm(off, truth) < GAIN_OFF_LIMIT_ppm
    monkeypatch.setattr(readings, "clock_ratio", lambda af_count, _gate_s, _nominal_Hz: np.ones(af_count.size))
    assert change_ppm() == pytest.approx(50.0, abs=1.0)
    assert worst_ppm(off, truth) > GAIN_OFF_LIMIT_ppm


def test_clock_error_has_no_mean_effect_on_quantised_counts() -> None:
    """Other clocks cut the pulses elsewhere, which scatters each gyro result by 0.45 ppm, but the mean stays."""
    gated = dataclasses.replace(NOISE_FREE, quantised=True)
    faster = dataclasses.replace(gated, af_error=70e-6, master_error=-48.5e-6)
    pairs = [(group(seed, faster), group(seed + 5000, gated)) for seed in range(300)]
    errors = [[fit_scale_factor(rows, GYRO, STANDARD).dsf_ppm - truth for rows, truth in pair] for pair in pairs]
    changes = np.array([now - then for now, then in errors])
    assert abs(changes.mean()) < 0.1
    assert changes.std() == pytest.approx(0.45, abs=0.05)


def test_bias_sign_flipped(monkeypatch: pytest.MonkeyPatch) -> None:
    campaign = sim.simulate(13, sim.Switches(), {1: "gyro", 2: "accelerometer"})

    def worst_score() -> float:
        biases = entries_of(sim.analysed(campaign), "bias")
        assert len(biases) == 10
        return max(abs(one["value"] - campaign.truth(one)) / one["std_uncertainty"] for one in biases)

    assert worst_score() < 4.0
    right: Callable[..., Bias] = group_fit.open_input_bias

    def mutant(*arguments: object) -> Bias:
        bias = right(*arguments)
        return Bias(-bias.value_A, bias.std_uncertainty_A, bias.unit_temperature_degC)

    monkeypatch.setattr(group_fit, "open_input_bias", mutant)
    assert worst_score() > 100.0
