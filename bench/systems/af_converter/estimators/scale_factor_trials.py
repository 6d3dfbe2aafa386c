"""Monte Carlo model of one scale-factor group: every input drawn from its distribution, every draw fitted again.

The counts stand in the design matrix of the fit, so the model is not linear; the draws show whether the linear budget
holds all the same. Nothing here uses the sensitivities of the budget.
Source: JCGM 101:2008 section 5; docs/decisions/0004 (model) and 0008 (distributions).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bench.maths.arrays import Floats
from bench.systems.af_converter.estimators.readings import (
    Converter,
    RangeSpecification,
    Readings,
    interpolation_A2,
    noise_parts,
    pulse_currents_A,
    relative_errors,
    scatter_A2,
    specification,
    walk_A2,
)
from bench.systems.af_converter.estimators.scale_factor import (
    Referral,
    reference_current_A,
    scale_design,
    thermal_response_A_degC,
    unreferred_A,
    usable_rows,
    zero_difference,
)

Generator = np.random.Generator
_SMALLEST_VARIANCE_A2 = 1e-36  # keeps the Cholesky factor where noise is declared as zero


@dataclass(frozen=True)
class TrialModel:
    """A group of rows with all that is uncertain about it.

    ``drift``: relative standard uncertainty of the calibrator's drift.   ``standard_dof``: degrees of freedom of the
    calibrator's errors, where the certificate of a range states no others; such errors are drawn from Student's t.
    ``sensor_std_degC``: of the unit's temperature sensor.
    """

    rows: Readings
    converter: Converter
    standard: Mapping[float, RangeSpecification]
    referral: Referral
    method: str = "gls"
    drift: float = 0.0
    standard_dof: float = math.inf
    sensor_std_degC: float = 0.0

    def draw(self, generator: Generator, trials: int) -> Floats:
        """Fitted DSF_N and DSF_P of each trial, (trials, 2), ppm.

        Args:    generator: seeded.   trials: how many.
        Returns: scale-factor errors, one row per trial.
        Raises:  FitError of ``zero_difference`` (B-FIT-006) for the methods that need zero rows.
        Source:  docs/decisions/0004, corrected equations (4) to (11).
        """
        rows = self.rows.take(usable_rows(self.rows))
        counted_A = pulse_currents_A(rows, self.converter)
        n_A, p_A = _counted(generator, trials, rows, self.converter, counted_A)
        reference_A = _reference(generator, trials, rows, self)
        response_A_degC = thermal_response_A_degC(*counted_A, self.referral)
        warmth = rows.unit_temperature_degC - self.referral.to_degC + _interpolated(generator, trials, rows)
        readings_A = reference_A - (n_A - p_A) - response_A_degC * warmth
        away_A = self.referral.slope_std_ppm_degC * unreferred_A(rows, *counted_A, self.referral.to_degC)
        if away_A.any():  # else no draw is spent on it
            readings_A += generator.standard_normal((trials, 2)) @ away_A.T
        dsf_ppm = 1e6 * _refit(self._transform(rows, response_A_degC, away_A), rows, n_A, p_A, readings_A)
        sensor_degC = self.sensor_std_degC * generator.standard_normal((trials, 1))
        return np.asarray(dsf_ppm + sensor_degC * np.array(self.referral.slope_ppm_degC))

    def _transform(self, rows: Readings, response_A_degC: Floats, away_A: Floats) -> Floats:
        """Return what the method multiplies design and readings with before it takes equal weights."""
        if self.method != "gls":
            difference = zero_difference(rows)
            return difference / rows.level_A[rows.level_A > 0, None] if self.method == "paper" else difference
        covariance = np.sum(list(noise_parts(rows, self.converter).values()), axis=0)
        covariance += interpolation_A2(rows, response_A_degC) + away_A @ away_A.T
        for full_A in np.unique(rows.range_A):
            variance = (specification(self.standard, float(full_A)).floor_A / 2.0) ** 2
            signed = rows.polarity * (rows.range_A == full_A)
            same_level = np.equal.outer(rows.level_A, rows.level_A) & (rows.level_A > 0)
            covariance += variance * np.outer(signed, signed) * (1.0 + same_level)
        return np.linalg.inv(np.linalg.cholesky(covariance))


def _triangular(generator: Generator, shape: tuple[int, int]) -> Floats:
    """Difference of the two uniform fractions of a pulse at the ends of a gate, in pulses."""
    return generator.random(shape) - generator.random(shape)


def _counted(
    generator: Generator, trials: int, rows: Readings, converter: Converter, counted_A: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """Counted currents (trials, m) of N and P with quantisation, clock, white noise and walk on the counter in use."""
    m, declared = rows.gate_s.size, rows.scatter_dof == 0
    white_A2 = declared * converter.white_A_rtHz**2 / (2.0 * rows.gate_s) + _SMALLEST_VARIANCE_A2
    factor = np.linalg.cholesky(walk_A2(rows, converter) + np.diag(white_A2))
    noise_A = generator.standard_normal((trials, m)) @ factor.T
    cuts = declared * np.sqrt(1.0 + rows.gaps)
    noise_A += converter.k0_C / rows.gate_s * cuts * _triangular(generator, (trials, m))
    clock = 1.0 + cuts / rows.af_count * _triangular(generator, (trials, m))
    if not declared.all():
        scatter_A = np.sqrt(scatter_A2(rows, converter))[~declared]
        noise_A[:, ~declared] += scatter_A * _student_t(generator, trials, rows.scatter_dof[~declared])
    n_A, p_A = counted_A
    forward = n_A > p_A
    return clock * n_A + noise_A * forward, clock * p_A - noise_A * ~forward


def _reference(
    generator: Generator,
    trials: int,
    rows: Readings,
    model: TrialModel,
) -> Floats:
    """Current of the calibrator (trials, m): gains by label, one offset per range, one linearity error per level."""
    standard = model.standard
    certified = [specification(standard, float(full_A)).calibration for full_A in np.unique(rows.range_A)]
    dof_of = {calibration.label: calibration.dof for calibration in certified if calibration is not None}
    in_proportion = relative_errors(rows.range_A, standard)
    effects = [*(rows.level_A * relative for relative in in_proportion.values()), rows.level_A * model.drift]
    dof = [*(dof_of.get(label, model.standard_dof) for label in in_proportion), math.inf]
    for full_A in np.unique(rows.range_A):
        sigma_A = specification(standard, float(full_A)).floor_A / 2.0
        inside = rows.range_A == full_A
        levels_A = np.unique(rows.level_A[inside & (rows.level_A > 0)])
        effects += [sigma_A * inside, *(sigma_A * (inside & (rows.level_A == level_A)) for level_A in levels_A)]
    dof += [model.standard_dof] * (len(effects) - len(dof))
    error_A = _student_t(generator, trials, np.array(dof)) @ np.array(effects)
    return reference_current_A(rows, standard) + rows.polarity * error_A


def _student_t(generator: Generator, trials: int, dof: Floats) -> Floats:
    """Return draws of Student's t, (trials, k), for degrees of freedom (k,); normal where they are infinite.

    Source: JCGM 101:2008 section 6.4.9.
    """
    drawn = generator.standard_normal((trials, dof.size))
    finite = np.isfinite(dof)
    drawn[:, finite] *= np.sqrt(dof[finite] / generator.chisquare(dof[finite], (trials, int(finite.sum()))))
    return drawn


def _interpolated(generator: Generator, trials: int, rows: Readings) -> Floats:
    """Errors (trials, m) of interpolated unit temperatures; rows of one gap share theirs."""
    gaps, place = np.unique(rows.temperature_gap, return_inverse=True)
    drawn = generator.standard_normal((trials, gaps.size))
    return drawn[:, place] * rows.temperature_std_degC


def _refit(transform: Floats, rows: Readings, n_A: Floats, p_A: Floats, readings_A: Floats) -> Floats:
    """DSF_N and DSF_P (trials, 2) by the normal equations of every trial, with columns of unit length."""
    offsets = transform @ scale_design(rows, n_A[0], p_A[0])[:, 2:]
    offsets = offsets[:, np.linalg.norm(offsets, axis=0) > 1e-9 * np.linalg.norm(transform)]  # subtracted zeros: none
    offsets /= np.linalg.norm(offsets, axis=0)
    counted = [n_A @ transform.T, -p_A @ transform.T]
    lengths = [float(np.linalg.norm(column[0])) for column in counted]
    counted = [column / length for column, length in zip(counted, lengths, strict=True)]
    readings = readings_A @ transform.T
    normal = np.empty((n_A.shape[0], 2 + offsets.shape[1], 2 + offsets.shape[1]))
    right = np.empty(normal.shape[:2])
    for row, column in enumerate(counted):
        normal[:, row, :2] = np.column_stack([np.einsum("ti,ti->t", column, other) for other in counted])
        normal[:, row, 2:] = normal[:, 2:, row] = column @ offsets
        right[:, row] = np.einsum("ti,ti->t", column, readings)
    normal[:, 2:, 2:] = offsets.T @ offsets
    right[:, 2:] = readings @ offsets
    return np.asarray(np.linalg.solve(normal, right[..., None])[:, :2, 0] / np.array(lengths))
