"""Scale-factor errors of one converter channel at one temperature by the calibrator method.

Model of a row with polarity s and level l on the calibrator range R:
``K0 (1 + DSF_N) C_N - K0 (1 + DSF_P) C_P = s l + s (b_R + e_l) + o_s``, where C = r N / t and o_s holds the leakage
of the switch and the bias of the converter for that polarity.
Source: AF-converter paper equations (4) to (11), corrected as in docs/method-af-converter.md.

In the Monte Carlo model of a group every input is drawn from its distribution and every draw fitted again. The counts
stand in the design matrix of the fit, so the model is not linear; the draws show whether the linear budget holds all
the same. Nothing of it uses the sensitivities of the budget. Source: JCGM 101:2008 section 5;
docs/method-uncertainty.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bench.maths.arrays import Flags, Floats
from bench.maths.least_squares import LinearFit, solve
from bench.model.errors import FitError
from bench.systems.af_converter.estimators.readings import (
    Converter,
    Effects,
    RangeSpecification,
    Readings,
    calibrator_effects,
    interpolation_A2,
    noise_parts,
    pulse_currents_A,
    relative_errors,
    scatter_A2,
    specification,
    walk_A2,
)

METHODS = ("gls", "paper", "ols")
UNREFERRED = "unknown temperature coefficients"
_PPM = 1e6


@dataclass(frozen=True)
class Referral:
    """Refer the rows to one unit temperature by temperature coefficients of DSF_N and DSF_P, known or guessed."""

    to_degC: float
    slope_ppm_degC: tuple[float, float] = (0.0, 0.0)
    slope_std_ppm_degC: float = 0.0  # 0: they are known


@dataclass(frozen=True)
class ScaleFactor:
    """Scale-factor errors (N, P) in ppm; positive = more current per pulse.

    ``covariance_ppm2`` is that of the fit (noise and shared effects); ``gains_ppm`` are one-sigma effects of the
    calibrator's errors in proportion to its current, which are added outside the fit.
    """

    dsf_ppm: Floats  # (2,)
    noise_ppm2: Floats  # (2, 2) independent noise
    shared_ppm: Mapping[str, Floats]  # label -> (2,) one-sigma effect of what channels and temperatures share
    gains_ppm: Mapping[str, Floats]  # label -> (2,), signed
    operator_ppm: Floats  # (2, m): what an ampere of each row's reference adds; 0 where dropped
    drift_ppm_s: Floats  # (2,) for each ppm per second that the calibrator gains, about the mean time of the rows
    unreferred_degC: Floats  # (2, 2) for each ppm/degC of DSF_N, DSF_P (columns) that the rows are not referred by
    time_s: float  # that mean time
    parts_ppm: Mapping[str, Floats]  # component -> (2,) standard uncertainties, for the budget
    unit_temperature_degC: float
    residual_A: Floats  # (m,) for the rows handed in; NaN where dropped
    std_A: Floats  # (m,) standard deviation the covariance model expects of a row
    chi2: float  # of the weighted fit; NaN for the methods without a covariance
    dof: int
    n: int
    dropped: int

    @property
    def covariance_ppm2(self) -> Floats:
        """Covariance (2, 2) of the fit without the calibrator's gains."""
        return self.noise_ppm2 + sum(np.outer(part, part) for part in self.shared_ppm.values())

    @property
    def standard_ppm(self) -> dict[str, Floats]:
        """Signed one-sigma effect (2,) of every error of the calibrator, by label."""
        return {**self.gains_ppm, **self.shared_ppm}


def fit_scale_factor(
    rows: Readings,
    converter: Converter,
    standard: Mapping[float, RangeSpecification],
    method: str = "gls",
    referral: Referral | None = None,
) -> ScaleFactor:
    """Fit DSF_N and DSF_P of one channel at one temperature.

    Args:    rows: closed-route rows, (m,); rows that are not finite are dropped and counted.
             converter, standard: declared constants.   method: "gls" (all rows, covariance weights), "ols" (equation
             (10): zero rows subtracted, equal weights), "paper" (equation (11): the same, weights 1/level^2).
             referral: unit temperature the result holds for, and the coefficients that refer each row to it; by
             default the mean over the rows, without coefficients.
    Returns: ScaleFactor; its uncertainties follow from the same covariance model for every method.
    Raises:  FitError B-FIT-001 (rank), B-FIT-003 (range not in the register), B-FIT-004 (method unknown), B-FIT-005 (a
             polarity is missing), B-FIT-006 (a zero row is missing).
    Source:  AF-converter paper equations (10), (11), corrected as in docs/method-af-converter.md.
    """
    if method not in METHODS:
        raise FitError("B-FIT-004", f"unknown method {method!r}", next_step=f"use one of {', '.join(METHODS)}")
    usable = usable_rows(rows)
    problem = _set_up(rows.take(usable), converter, standard, referral)
    fit = _solve(method, problem)
    to_ppm = fit.operator[:2] * _PPM
    shared = to_ppm @ problem.effects.matrix
    return ScaleFactor(
        dsf_ppm=fit.parameters[:2] * _PPM,
        noise_ppm2=np.sum([to_ppm @ part @ to_ppm.T for part in problem.parts.values()], axis=0),
        shared_ppm=dict(zip(problem.effects.labels, shared.T, strict=True)),
        gains_ppm=gain_effects_ppm(to_ppm, problem.reference_A, problem.rows, standard),
        operator_ppm=np.array([spread(row, usable, 0.0) for row in to_ppm]),
        drift_ppm_s=to_ppm @ (problem.reference_A / _PPM * (problem.rows.time_s - problem.rows.time_s.mean())),
        unreferred_degC=to_ppm @ problem.away_A,
        time_s=float(problem.rows.time_s.mean()),
        parts_ppm=_budget(to_ppm, problem.parts, problem.effects.labels, shared),
        unit_temperature_degC=problem.unit_temperature_degC,
        residual_A=spread(fit.residual, usable),
        std_A=spread(np.sqrt(np.diag(problem.covariance_A2)), usable),
        chi2=fit.chi2,
        dof=fit.dof,
        n=int(usable.sum()),
        dropped=int((~usable).sum()),
    )


@dataclass(frozen=True)
class _Problem:
    """The usable rows as a linear problem in DSF_N, DSF_P and one offset per polarity."""

    rows: Readings
    unit_temperature_degC: float
    reference_A: Floats  # (m,)
    readings_A: Floats  # (m,) reference minus counted current
    design_A: Floats  # (m, 4)
    response_A_degC: Floats  # (m,) by the temperature coefficients, signed
    away_A: Floats  # (m, 2) for each ppm/degC of DSF_N, DSF_P, at the row's own temperature
    parts: Mapping[str, Floats]  # independent noise, (m, m) each
    effects: Effects
    covariance_A2: Floats  # (m, m) noise and effects


def _set_up(
    rows: Readings, converter: Converter, standard: Mapping[float, RangeSpecification], referral: Referral | None
) -> _Problem:
    n_A, p_A = pulse_currents_A(rows, converter)
    require_polarities(rows, n_A, p_A)
    at = referral or Referral(float(np.mean(rows.unit_temperature_degC)))
    reference_A = reference_current_A(rows, standard)
    response_A_degC = thermal_response_A_degC(n_A, p_A, at)
    away_A = unreferred_A(rows, n_A, p_A, at.to_degC)
    parts = noise_parts(rows, converter)
    parts |= {"interpolated unit temperature": interpolation_A2(rows, response_A_degC)}
    if at.slope_std_ppm_degC:
        parts |= {UNREFERRED: at.slope_std_ppm_degC**2 * away_A @ away_A.T}
    effects = calibrator_effects(rows, standard)
    return _Problem(
        rows=rows,
        unit_temperature_degC=at.to_degC,
        reference_A=reference_A,
        readings_A=reference_A - (n_A - p_A) - response_A_degC * (rows.unit_temperature_degC - at.to_degC),
        design_A=scale_design(rows, n_A, p_A),
        response_A_degC=response_A_degC,
        away_A=away_A,
        parts=parts,
        effects=effects,
        covariance_A2=np.sum(list(parts.values()), axis=0) + effects.matrix @ effects.matrix.T,
    )


def thermal_response_A_degC(n_A: Floats, p_A: Floats, referral: Referral) -> Floats:
    """Return what the temperature coefficients make of a degC of unit temperature in each row, (m,), signed.

    Source: derivative of AF-converter paper equation (1) with respect to the scale-factor errors.
    """
    slope_n, slope_p = referral.slope_ppm_degC
    return 1e-6 * (slope_n * n_A - slope_p * p_A)


def unreferred_A(rows: Readings, n_A: Floats, p_A: Floats, to_degC: float) -> Floats:
    """Return what 1 ppm/degC of DSF_N and of DSF_P makes of rows at other temperatures, (m, 2), ampere, signed."""
    return 1e-6 * np.column_stack([n_A, -p_A]) * (rows.unit_temperature_degC - to_degC)[:, None]


def usable_rows(rows: Readings) -> Flags:
    """Mask (m,) of the rows with finite values, a gate and an AF clock."""
    needed = rows.__dataclass_fields__.keys() - {"halves"}
    finite = np.all([np.isfinite(getattr(rows, name)) for name in needed], axis=0)
    return np.asarray(finite & (rows.gate_s > 0) & (rows.af_count > 0))


def reference_current_A(
    rows: Readings, standard: Mapping[float, RangeSpecification], zeroed: Flags | bool = False
) -> Floats:
    """Signed current the standard is believed to deliver, (m,): its level corrected by its certificate.

    ``zeroed`` (m,): rows of which the offset is off already.
    """
    entries = [specification(standard, float(range_A)) for range_A in rows.range_A]
    gain = np.array([entry.gain for entry in entries])
    offset_A = np.where(zeroed, 0.0, [entry.offset_A for entry in entries])
    return np.asarray(rows.polarity * (rows.level_A * (1.0 + gain) + offset_A))


def scale_design(rows: Readings, n_A: Floats, p_A: Floats) -> Floats:
    """Design (m, 4): counted currents for DSF_N and DSF_P, and one offset per polarity.

    The counts, not the set-points, multiply the unknowns: set-points would bias DSF by -DSF^2.
    Source: docs/method-af-converter.md, corrected equations (4) to (10).
    """
    return np.column_stack([n_A, -p_A, rows.polarity > 0, rows.polarity < 0]).astype(np.float64)


def require_polarities(rows: Readings, n_A: Floats, p_A: Floats) -> None:
    """Refuse rows whose stimulus drove only one of the two counters: the other is then known from the bias alone.

    Raises: FitError B-FIT-005 naming the missing polarity.
    """
    stimulus = rows.level_A > 0
    for name, current_A, polarity in (("K_N", n_A, "positive"), ("K_P", p_A, "negative")):
        if not np.any(stimulus & (current_A > 0.5 * rows.level_A)):
            raise FitError(
                "B-FIT-005",
                f"{name} is not determined: none of {int(stimulus.sum())} usable rows with a stimulus has {polarity} "
                "input",
                next_step=f"take the {polarity} levels again; a value from the bias alone would be meaningless",
            )


def zero_difference(rows: Readings) -> Floats:
    """Return matrix (d, m) that subtracts the zero row of the same polarity (same range first) from every level row.

    Raises: FitError B-FIT-006 if a polarity has no zero row.
    Source: AF-converter paper equations (6), (9).
    """
    levels = np.flatnonzero(rows.level_A > 0)
    zeros = np.flatnonzero(rows.level_A == 0)
    difference = np.zeros((levels.size, rows.level_A.size))
    for row, level in enumerate(levels):
        same = zeros[rows.polarity[zeros] == rows.polarity[level]]
        if same.size == 0:
            sign = "+" if rows.polarity[level] > 0 else "-"
            raise FitError(
                "B-FIT-006",
                f"the re-zeroed equations need the {sign}0 row of this channel and temperature, which is missing",
                next_step="use the method 'gls', which does not subtract zeros, or take the row again",
            )
        other_range = rows.range_A[same] != rows.range_A[level]
        difference[row, level] = 1.0
        difference[row, same[np.argmin(other_range)]] = -1.0
    return difference


def _solve(method: str, problem: _Problem) -> LinearFit:
    names = ("K_N", "K_P", "offset of the positive connection", "offset of the negative connection")
    rows, design_A = problem.rows, problem.design_A
    if method == "gls":
        present = np.flatnonzero(design_A.any(axis=0))
        chosen = [names[column] for column in present]
        return solve(design_A[:, present], problem.readings_A, problem.covariance_A2, chosen)
    difference = zero_difference(rows)
    level_A = rows.level_A[rows.level_A > 0]
    weights = np.diag(level_A**2) if method == "paper" else np.eye(level_A.size)
    fit = solve(difference @ design_A[:, :2], difference @ problem.readings_A, weights, names[:2])
    residual_A = problem.readings_A - design_A[:, :2] @ fit.parameters
    for polarity in (1.0, -1.0):
        side = rows.polarity == polarity
        residual_A[side] -= residual_A[side & (rows.level_A == 0)].mean()
    return LinearFit(fit.parameters, fit.covariance, fit.operator @ difference, residual_A, float("nan"), fit.dof)


def gain_effects_ppm(
    to_ppm: Floats, reference_A: Floats, rows: Readings, standard: Mapping[float, RangeSpecification]
) -> dict[str, Floats]:
    """Effects (2,) in ppm of one standard deviation of each error in proportion to the calibrator's current, by label.

    They do not average over levels, channels or temperatures, so they never enter the weights of the fit.
    Source: docs/method-af-converter.md (common gain), method-uncertainty.md (calibration of the calibrator).
    """
    errors = relative_errors(rows.range_A, standard)
    return {label: to_ppm @ (reference_A * relative) for label, relative in errors.items()}


def spread(values: Floats, usable: Flags, elsewhere: float = np.nan) -> Floats:
    """Put values (k,) where the mask (m,) is true, and another one ``elsewhere``."""
    everywhere = np.full(usable.size, elsewhere)
    everywhere[usable] = values
    return everywhere


def _budget(to_ppm: Floats, parts: Mapping[str, Floats], labels: tuple[str, ...], shared: Floats) -> dict[str, Floats]:
    budget = {name: np.sqrt(np.diag(to_ppm @ part @ to_ppm.T)) for name, part in parts.items()}
    for kind in ("offset", "linearity"):
        chosen = [label.startswith(kind) for label in labels]
        budget[f"calibrator {kind}"] = np.sqrt(np.sum(shared[:, chosen] ** 2, axis=1))
    return budget


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
        Source:  docs/method-af-converter.md, corrected equations (4) to (11).
        """
        problem = _set_up(self.rows.take(usable_rows(self.rows)), self.converter, self.standard, self.referral)
        rows = problem.rows
        n_A, p_A = _counted(generator, trials, rows, self.converter)
        reference_A = _reference(generator, trials, problem, self)
        warmth = rows.unit_temperature_degC - self.referral.to_degC + _interpolated(generator, trials, rows)
        readings_A = reference_A - (n_A - p_A) - problem.response_A_degC * warmth
        away_A = self.referral.slope_std_ppm_degC * problem.away_A
        if away_A.any():  # else no draw is spent on it
            readings_A += generator.standard_normal((trials, 2)) @ away_A.T
        dsf_ppm = 1e6 * _refit(self._transform(problem), problem.design_A[:, 2:], n_A, p_A, readings_A)
        sensor_degC = self.sensor_std_degC * generator.standard_normal((trials, 1))
        return np.asarray(dsf_ppm + sensor_degC * np.array(self.referral.slope_ppm_degC))

    def _transform(self, problem: _Problem) -> Floats:
        """Return what the method multiplies design and readings with before it takes equal weights."""
        if self.method == "gls":
            return np.linalg.inv(np.linalg.cholesky(problem.covariance_A2))
        difference, level_A = zero_difference(problem.rows), problem.rows.level_A
        return difference / level_A[level_A > 0, None] if self.method == "paper" else difference


def _triangular(generator: Generator, shape: tuple[int, int]) -> Floats:
    """Difference of the two uniform fractions of a pulse at the ends of a gate, in pulses."""
    return generator.random(shape) - generator.random(shape)


def _counted(generator: Generator, trials: int, rows: Readings, converter: Converter) -> tuple[Floats, Floats]:
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
    n_A, p_A = pulse_currents_A(rows, converter)
    forward = n_A > p_A
    return clock * n_A + noise_A * forward, clock * p_A - noise_A * ~forward


def _reference(generator: Generator, trials: int, problem: _Problem, model: TrialModel) -> Floats:
    """Current of the calibrator (trials, m): gains by label, one offset per range, one linearity error per level."""
    rows, standard = problem.rows, model.standard
    certified = [specification(standard, float(full_A)).calibration for full_A in np.unique(rows.range_A)]
    dof_of = {calibration.label: calibration.dof for calibration in certified if calibration is not None}
    in_proportion = relative_errors(rows.range_A, standard)
    signed_A = rows.polarity * rows.level_A
    effects = [*(signed_A * relative for relative in in_proportion.values()), signed_A * model.drift]
    dof = [*(dof_of.get(label, model.standard_dof) for label in in_proportion), math.inf]
    effects += [*problem.effects.matrix.T]
    dof += [model.standard_dof] * (len(effects) - len(dof))
    return problem.reference_A + _student_t(generator, trials, np.array(dof)) @ np.array(effects)


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


def _refit(transform: Floats, offsets: Floats, n_A: Floats, p_A: Floats, readings_A: Floats) -> Floats:
    """DSF_N and DSF_P (trials, 2) by the normal equations of every trial, with columns of unit length."""
    offsets = transform @ offsets
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
