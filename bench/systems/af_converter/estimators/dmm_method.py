"""Scale-factor errors of one converter channel by the DMM method: a current meter is the standard, not the source.

The meter stands in the calibrator's lead, before the switch, so it reads the same positive current r for both
polarities; i_DMM1 = r+ and i_DMM2 = -r- are what the unit is given. Half the difference and half the sum of the two
rows of a level:

``1/2 [K_N (C_N+ - C_N-) - K_P (C_P+ - C_P-)] = 1/2 (i_DMM1 - i_DMM2) - b_R + l``
``1/2 [K_N (C_N+ + C_N-) - K_P (C_P+ + C_P-)] = 1/2 (i_DMM1 + i_DMM2) + c``

b_R: zero of the meter's range, l: half the difference of the switch's leakages, c: half their sum minus i_AFbias.
Source: AF-converter paper equations (12) to (18), corrected as in docs/method-af-converter.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from bench.maths.arrays import Flags, Floats
from bench.maths.least_squares import LinearFit, solve
from bench.model.errors import FitError
from bench.systems.af_converter.estimators.readings import (
    GAIN,
    Converter,
    RangeSpecification,
    Readings,
    noise_parts,
    pulse_currents_A,
    relative_errors,
    specification,
)
from bench.systems.af_converter.estimators.scale_factor import (
    reference_current_A,
    require_polarities,
    spread,
    usable_rows,
)

METHODS = ("joint", "as_printed")
LARGEST_CONDITION = (
    20.0  # of the relative rows; 1.8 (gyro) and 2.3 (accelerometer) with common-mode rows, hundreds without
)
_PPM = 1e6
_CONTRASTS = {"dsf_n": (1.0, 0.0), "dsf_p": (0.0, 1.0), "dsf_asymmetry": (1.0, -1.0), "dsf_mean": (0.5, 0.5)}


@dataclass(frozen=True)
class Meter:
    """Readings of the meter beside each row, (m,) each; positive, whatever the switch does behind it."""

    current_A: Floats  # mean of the readings, minus the zero of the range where it was measured
    std_A: Floats  # noise of that mean
    zero_std_A: Floats  # noise of the zero that was subtracted; NaN where none was measured
    range_A: Floats

    def take(self, rows: Flags) -> Meter:
        """The rows where the mask is true."""
        return Meter(**{name: getattr(self, name)[rows] for name in self.__dataclass_fields__})


@dataclass(frozen=True)
class DmmScaleFactor:
    """Result for one channel at one temperature; all in ppm, positive = more current per pulse.

    ``value_ppm``, ``std_ppm``: by "dsf_n", "dsf_p", "dsf_asymmetry", "dsf_mean" (half the sum); only the last for the
    method "as_printed", and ``refusal`` then says why. ``parts_ppm``: component -> the same names, for the budget.
    ``standard_ppm``: the same names -> signed one-sigma effects of the meter's gains and calibration by label;
    ``operators_ppm``: what an ampere of each row's reading adds, (m,), 0 where dropped.
    ``condition``: condition number of the relative rows of the method, also where it is refused.
    """

    value_ppm: Mapping[str, float]
    std_ppm: Mapping[str, float]
    parts_ppm: Mapping[str, Mapping[str, float]]
    standard_ppm: Mapping[str, Mapping[str, float]]
    operators_ppm: Mapping[str, Floats]
    condition: float
    refusal: str
    unit_temperature_degC: float
    chi2: float  # NaN for "as_printed", which has no covariance weights
    dof: int
    n: int
    dropped: int


def fit_dmm_method(
    rows: Readings, meter: Meter, converter: Converter, standard: Mapping[float, RangeSpecification],
    method: str = "joint",
) -> DmmScaleFactor:  # fmt: skip
    """Fit DSF_N and DSF_P of one channel at one temperature to a current meter's readings.

    Args:    rows: closed-route rows, (m,); rows that are not finite, have no reading or no partner of the other
             polarity are dropped and counted.   meter: readings beside them.   converter, standard: declared constants,
             ``standard`` of the meter.   method: "joint" (differential and common-mode rows, covariance weights) or
             "as_printed" (differential rows with weights 1/level^2, equation (18): the mean of both only).
    Returns: DmmScaleFactor. Gains of the meter's ranges count as fully correlated in the uncertainty.
    Raises:  FitError B-FIT-001 (rank), B-FIT-003 (range not in the register), B-FIT-005 (a polarity is
             missing), B-FIT-050 (no row with a reading).
    Source:  AF-converter paper section 3.1.2; docs/method-af-converter.md.
    """
    readable = usable_rows(rows) & np.isfinite(meter.current_A) & np.isfinite(meter.std_A)
    usable = readable & _has_partner(rows, readable)
    if not np.any(usable & (rows.level_A > 0)):
        raise FitError(
            "B-FIT-050",
            f"none of {usable.size} records has a reading of the meter and a partner of the other polarity",
            next_step="the sequence must call dmm.measure_current between dmm.configure_current and the record",
        )
    problem = _set_up(rows.take(usable), meter.take(usable), converter, standard)
    solution = _joint(problem) if method == "joint" else _as_printed(problem)
    return _result(problem, solution, usable)


@dataclass(frozen=True)
class _Problem:
    rows: Readings
    readings_A: Floats  # (m,) signed meter current minus counted current
    design_A: Floats  # (m, 2) counted currents for DSF_N and DSF_P
    pairs: Floats  # (2 p, m) half differences of the p levels, then half sums
    level_A: Floats  # (p,)
    parts: Mapping[str, Floats]  # independent noise, (m, m) each
    gains_A: Floats  # (m, r) one standard deviation of each range's gain
    labelled_A: Mapping[str, Floats]  # label -> (m,) one standard deviation of what ranges or standards share

    @property
    def difference(self) -> Floats:
        return self.pairs[: self.level_A.size]

    def relative(self, pairs: Floats) -> Floats:
        """Return rows with a stimulus as multiples of it: what equation (18) makes of (17)."""
        driven = self.level_A > 0
        chosen = np.tile(driven, pairs.shape[0] // driven.size)
        weight = np.tile(1.0 / self.level_A[driven], pairs.shape[0] // driven.size)
        return weight[:, None] * pairs[chosen]


@dataclass(frozen=True)
class _Solution:
    operators: Mapping[str, Floats]  # name -> (m,): what each row's reading adds to the quantity, per unit
    fit: LinearFit
    chi2: float
    condition: float
    refusal: str = ""


def _set_up(
    rows: Readings, meter: Meter, converter: Converter, standard: Mapping[float, RangeSpecification]
) -> _Problem:
    n_A, p_A = pulse_currents_A(rows, converter)
    require_polarities(rows, n_A, p_A)
    reference_A = reference_A_of(rows, meter, standard)
    level_A, pairs = pair_rows(rows)
    gains = relative_errors(meter.range_A, standard)
    return _Problem(
        rows=rows,
        readings_A=reference_A - (n_A - p_A),
        design_A=np.column_stack([n_A, -p_A]),
        pairs=pairs,
        level_A=level_A,
        parts=noise_parts(rows, converter) | meter_parts(rows, meter, standard),
        gains_A=by_range(reference_A * gains.pop(GAIN, 0.0), meter.range_A),
        labelled_A={label: reference_A * relative for label, relative in gains.items()},
    )


def reference_A_of(rows: Readings, meter: Meter, standard: Mapping[float, RangeSpecification]) -> Floats:
    """Signed current the meter saw go to the unit, (m,): its readings corrected by its certificate.

    Raises: FitError B-FIT-003 for a range the register does not hold.
    Source: AF-converter paper equations (15), (16), for a meter before the switch (docs/method-af-converter.md).
    """
    read = replace(rows, level_A=meter.current_A, range_A=meter.range_A)
    return reference_current_A(read, standard, np.isfinite(meter.zero_std_A))


def pair_rows(rows: Readings) -> tuple[Floats, Floats]:
    """Levels (p,) and the matrix (2 p, m) of half differences, then half sums, of each level's two polarities.

    Source: AF-converter paper equations (14), (17); docs/method-af-converter.md for the sums.
    """
    levels = np.unique(rows.level_A)
    sides = [(rows.level_A == level) & (rows.polarity == sign) for sign in (1.0, -1.0) for level in levels]
    means = np.array([side / side.sum() for side in sides])
    plus, minus = means[: levels.size], means[levels.size :]
    return np.asarray(levels), np.vstack([0.5 * (plus - minus), 0.5 * (plus + minus)])


def meter_parts(rows: Readings, meter: Meter, standard: Mapping[float, RangeSpecification]) -> dict[str, Floats]:
    """Covariance (m, m) by the meter without its gains, ampere squared: noise, zero of a range, linearity at a level.

    A zero that was measured leaves its noise, one that was not the floor of the specification.
    Raises: FitError B-FIT-003 for a range the register does not hold.
    Source: docs/method-af-converter.md.
    """
    floor_A = np.array([specification(standard, float(range_A)).floor_A / 2.0 for range_A in meter.range_A])
    same_range = np.equal.outer(meter.range_A, meter.range_A)
    same_level = same_range & np.equal.outer(rows.level_A, rows.level_A)
    zero_A = rows.polarity * np.where(np.isfinite(meter.zero_std_A), meter.zero_std_A, floor_A)
    linearity_A = rows.polarity * floor_A * (rows.level_A > 0)
    return {
        "noise of the meter": np.diag(meter.std_A**2),
        "zero of the meter": np.outer(zero_A, zero_A) * same_range,
        "linearity of the meter": np.outer(linearity_A, linearity_A) * same_level,
    }


def condition_number(relative_design: Floats) -> float:
    """Condition number of relative rows after scaling the columns (K_N, K_P, nuisances) to unit length.

    Args:    relative_design: (m, p) in units of the stimulus.
    Returns: largest over smallest singular value; infinite if the rank is not full.
    Raises:  nothing.
    Source:  Golub and Van Loan, Matrix Computations, sections 2.6 and 5.5 (condition, numerical rank).
    """
    length = np.linalg.norm(relative_design, axis=0)
    singular = np.linalg.svd(relative_design / np.where(length > 0, length, 1.0), compute_uv=False)
    return float(singular[0] / singular[-1]) if singular[-1] > 0 else float("inf")


def require_separable(relative_design: Floats, rows: str) -> None:
    """Refuse rows that do not tell K_N from K_P.

    Args:    relative_design: (m, p) in units of the stimulus.   rows: name of the rows for the message.
    Raises:  FitError B-FIT-001 with the rank, if the condition number is above ``LARGEST_CONDITION``: only the bias of
             the converter, which the equations take as constant, then keeps the columns apart.
    Source:  docs/method-af-converter.md (rank of equations (17), (18)).
    """
    condition, columns = condition_number(relative_design), relative_design.shape[1]
    if condition > LARGEST_CONDITION:
        raise FitError(
            "B-FIT-001",
            f"the {rows} do not determine K_N and K_P apart: rank {columns - 1} of {columns} (condition number "
            f"{condition:.0f}; only the bias of the converter tells the columns apart)",
            next_step="use the method 'joint', which adds the common-mode rows; the mean of both is determined",
        )


def _joint(problem: _Problem) -> _Solution:
    driven = problem.level_A > 0
    common = np.repeat([0.0, 1.0], problem.level_A.size)  # c, in the half sums only
    relative_common = np.concatenate([np.zeros(driven.sum()), 1.0 / problem.level_A[driven]])
    relative = np.column_stack([problem.relative(problem.pairs) @ problem.design_A, relative_common])
    require_separable(relative, "differential and common-mode rows")
    columns, names = [problem.pairs @ problem.design_A, common], ["K_N", "K_P", "common-mode current"]
    if not driven.all():  # zeros show the leakage; without them it is taken as negligible (assumption 2)
        columns.append(1.0 - common)
        names.append("leakage")
    covariance = np.sum(list(problem.parts.values()), axis=0) + problem.gains_A @ problem.gains_A.T
    paired = problem.pairs @ covariance @ problem.pairs.T
    fit = solve(np.column_stack(columns), problem.pairs @ problem.readings_A, paired, names)
    operator = fit.operator @ problem.pairs
    return _Solution(
        operators={name: np.array(contrast) @ operator[:2] for name, contrast in _CONTRASTS.items()},
        fit=fit,
        chi2=fit.chi2,
        condition=condition_number(relative),
    )


def _as_printed(problem: _Problem) -> _Solution:
    relative = problem.relative(problem.difference)
    design = relative @ problem.design_A
    refusal = ""
    try:
        require_separable(design, "equations (17), (18) as printed")
    except FitError as error:
        refusal = error.message
    mean = design.sum(axis=1, keepdims=True)
    fit = solve(mean, relative @ problem.readings_A, np.eye(mean.shape[0]), ["mean of K_N and K_P"])
    operators = {"dsf_mean": fit.operator[0] @ relative}
    return _Solution(operators, fit, float("nan"), condition_number(design), refusal)


def by_range(error_A: Floats, range_A: Floats) -> Floats:
    """Return what an error (m,) makes of the rows of each range, (m, r).

    Source: docs/method-af-converter.md (a gain of each range).
    """
    return np.column_stack([error_A * (range_A == full_A) for full_A in np.unique(range_A)])


def _result(problem: _Problem, solution: _Solution, usable: Flags) -> DmmScaleFactor:
    parts: dict[str, dict[str, float]] = {}
    standard: dict[str, dict[str, float]] = {}
    for name, operator in solution.operators.items():
        for part, covariance in problem.parts.items():
            variance = max(0.0, float(operator @ covariance @ operator))
            parts.setdefault(part, {})[name] = _PPM * variance**0.5
        # nobody says how far the gains of two ranges share one cause: the largest that correlation can make
        gain = _PPM * float(np.abs(operator @ problem.gains_A).sum())
        parts.setdefault("gain of the meter's ranges", {})[name] = gain
        standard[name] = {GAIN: gain}
        standard[name] |= {label: _PPM * float(operator @ error_A) for label, error_A in problem.labelled_A.items()}
        labelled = [part for label, part in standard[name].items() if label != GAIN]
        parts.setdefault("traceability of the meter", {})[name] = float(np.linalg.norm(labelled))
    return DmmScaleFactor(
        value_ppm={name: _PPM * float(operator @ problem.readings_A) for name, operator in solution.operators.items()},
        std_ppm={
            name: float(np.sqrt(sum(part_ppm[name] ** 2 for part_ppm in parts.values()))) for name in solution.operators
        },
        parts_ppm=parts,
        standard_ppm=standard,
        operators_ppm={name: spread(_PPM * operator, usable, 0.0) for name, operator in solution.operators.items()},
        condition=solution.condition,
        refusal=solution.refusal,
        unit_temperature_degC=float(np.mean(problem.rows.unit_temperature_degC)),
        chi2=solution.chi2,
        dof=solution.fit.dof,
        n=int(usable.sum()),
        dropped=int((~usable).sum()),
    )


def _has_partner(rows: Readings, readable: Flags) -> Flags:
    plus, minus = (rows.level_A[readable & (rows.polarity == sign)] for sign in (1.0, -1.0))
    return np.isin(rows.level_A, np.intersect1d(plus, minus))
