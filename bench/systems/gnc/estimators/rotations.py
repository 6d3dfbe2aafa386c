"""Gyroscope triad from turns of known angle: forth and back about each axis, or one turn about each and rest.

Corrected equations: S_ij = (I_i of j+ - I_i of j-) / (turn+ - turn-), which is 4 pi N radians or 720 N degrees; it is
S (output per input, row sensor, column axis), so K = S^-1. Its integrals reach over the movement and 0.5 s around it:
rest adds nothing to them but noise. The bias comes from the integrals of sensor i in the four records that turn about
the other two axes, over the sum of their lengths, and through S: N = S (w + b).
The Earth's rate is a part of the input in both: it stands in the local frame and turns in the unit with the measured
angle, so a vertical turntable gives the same numbers as a mount along the Earth's axis.

Hand-held calibrations give one turn about each axis, and the bias from the output at rest.

Source: GNC module paper equations (1), (3), (4), corrected: (3) as printed is the transpose of S and is not inverted,
(4) divides by 8 pi N instead of 4 T. From rest: Ferraris, Grimaldi and Parvis, Procedure for effortless in-field
calibration of three-axis rate gyros and accelerometers, Sensors and Materials 7 (1995).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.maths.arrays import Floats
from bench.systems.gnc.estimators.earth_rate import (
    RotationRecord,
    Samples,
    Site,
    good_samples,
    noise_density,
    noise_dof,
    quantisation_variance,
    record_about,
    resting,
)
from bench.systems.gnc.estimators.rotation_inputs import Declared, Inputs, turn_and_rest, whole_turn
from bench.systems.gnc.estimators.sensor_noise import SensorNoise
from bench.systems.gnc.estimators.triad import AXES, TriadFit, TriadRows, derivatives, improbable, propagate_inputs

_LEAST_SPREAD = 1e-12
_DRIFT_DOF = 15  # three sensors at rest in six records, less three biases
_ROUNDS = 3  # both equations are tied by c (T+ - T-), some samples of some 1,000: each round gains three digits


@dataclass(frozen=True)
class RotationFit:
    """``triad``: w = K N - bias, deg/s.   ``used`` and ``trimmed_s``: samples used of each record and seconds cut off
    its end, so that both directions are of equal length.   ``duplicates``: samples dropped.   ``drift_deg_s``: by which
    the bias wandered from record to record, declared or seen at rest; it is in the intervals.
    """

    triad: TriadFit
    used: Mapping[str, int]
    trimmed_s: Mapping[str, float]
    duplicates: Mapping[str, int]
    drift_deg_s: float


def fit_rotations(
    records: Sequence[RotationRecord],
    site: Site | None = None,
    declared: Declared | None = None,
    noise: SensorNoise | None = None,
) -> RotationFit:
    """Fit S, K = S^-1 and bias to six records: each body axis turned forth and back.

    Args:    records: six, any order, rates in deg/s.   site: for the Earth's rate; needed if the records have poses.
             declared: uncertainties of the table and of the sensors' resolution.   noise: of records that hold none;
             None to measure it.
    Returns: RotationFit. The covariance holds white noise (at rest), quantisation and tilt of each axis. A
             chi-square of the residuals that is improbable (0.1 %) enlarges it.
    Raises:  FitError B-FIT-080 (samples missing), -081 (a record missing, double or about another axis), -082 (another
             turn than named), -083 (nothing at rest).
    Source:  the equations named in the head of this file; covariance as in JCGM 102:2011 section 6.2.
    """
    declared = declared or Declared()
    ordered = [record_about(records, axis, sign) for axis in AXES for sign in (1.0, -1.0)]
    samples = [good_samples(record) for record in ordered]
    trimmed = _equal_lengths(samples)
    density, std, dof = _noise(ordered, trimmed) if noise is None else _declared(noise, ordered, trimmed)
    parts = [turn_and_rest(record, kept) for record, kept in zip(ordered, trimmed, strict=True)]
    inputs = Inputs.of(parts, site)
    parameters, residual = paired(inputs)
    quantisation = quantisation_variance(std, declared.resolution_deg_s)
    common = np.diag(quantisation)
    wandering = None if noise is None else _wandering(noise, ordered, trimmed)
    declared_covariance, noise_dof = inputs.covariance(declared, density, common, wandering), dof
    drift_deg_s = _drift(residual, inputs, density, quantisation)
    if drift_deg_s > declared.drift_deg_s:
        dof = min(dof, float(_DRIFT_DOF))
        declared = replace(declared, drift_deg_s=drift_deg_s)
    covariance = inputs.covariance(declared, density, common, wandering)
    jacobian = derivatives(
        lambda x: np.concatenate(_both(paired(inputs.at(x)))), inputs.vector, np.sqrt(covariance.diagonal())
    )
    triad = _triad(parameters, residual, jacobian @ covariance @ jacobian.T, inputs, dof, declared.time_std)
    triad = replace(triad, rows=_rows(triad.matrix, inputs, jacobian, declared_covariance, noise_dof))
    names = [record.name for record in ordered]
    return RotationFit(
        triad=triad,
        used=dict(zip(names, (len(kept.rate) for kept in trimmed), strict=True)),
        trimmed_s={
            name: whole.duration_s - kept.duration_s for name, whole, kept in zip(names, samples, trimmed, strict=True)
        },
        duplicates={name: kept.duplicates for name, kept in zip(names, trimmed, strict=True)},
        drift_deg_s=declared.drift_deg_s,
    )


def paired(inputs: Inputs) -> tuple[Floats, Floats]:
    """Corrected equations (3) and (4): (12,) K row by row and bias; (12, 3) residuals of the integrals, deg.

    Args:    inputs: turn and rest of x+, x-, y+, y-, z+, z-, in this order.
    Returns: parameters and residuals.
    Raises:  nothing of its own.
    Source:  GNC module paper equations (3), (4), corrected as in the head of this file.
    """
    known, length = inputs.known + inputs.earth, inputs.duration_s[:, None]
    offset = np.zeros(3)
    other = ~np.repeat(np.eye(3, dtype=bool), 4, axis=0)  # a sensor's bias comes from turns about the other two axes
    for _ in range(_ROUNDS):
        clear = inputs.integral - offset * length
        difference = known[0::4] - known[2::4]
        sensitivity = np.linalg.solve(difference, clear[0::4] - clear[2::4]).T
        left = inputs.integral - known @ sensitivity.T
        offset = np.sum(left * other, axis=0) / np.sum(length * other, axis=0)
    inverse = np.linalg.inv(sensitivity)
    return np.concatenate([inverse.ravel(), inverse @ offset]), left - offset * length


def _rows(matrix: Floats, inputs: Inputs, jacobian: Floats, covariance: Floats, dof: float) -> TriadRows:
    """Return mean rates of turns and rests, (r, 3) deg/s. ``jacobian``: of K and bias by the vector of the inputs."""
    sensitivity, length = np.linalg.inv(matrix), inputs.duration_s[:, None]

    def left(vector: Floats) -> Floats:
        at = inputs.at(vector)
        return ((at.integral @ matrix.T - at.known - at.earth) / length).ravel()

    by_integral = jacobian[:12, : inputs.integral.size].reshape(12, -1, 3)
    return TriadRows(
        output=inputs.integral / length,
        input=(inputs.known + inputs.earth) / length,
        force=inputs.seen[:, :, 2] / length,
        covariance=propagate_inputs(left, inputs.vector, covariance),
        operator=(by_integral * length @ sensitivity).reshape(12, -1),
        dof=dof,
    )


def _drift(residual: Floats, inputs: Inputs, density: Floats, quantisation: Floats) -> float:
    """How much the bias wanders from record to record beyond noise and steps inside of them, deg/s, by the rests.

    Noise alone says so in one calibration of twenty. One of the six rests is spent on the bias itself.
    """
    length = inputs.duration_s[1::2, None]
    rate, noise = residual[1::2] / length, density.diagonal() / length + quantisation
    if not noise.all() or not improbable(float(np.sum(rate**2 / noise)), _DRIFT_DOF, below=0.05):
        return 0.0
    return math.sqrt(max(float(np.mean(np.sum(rate**2, axis=0) / 5.0 - noise.mean(axis=0))), 0.0))


def _both(solution: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    return solution[0], solution[1].ravel()


def _triad(
    parameters: Floats, residual: Floats, spread: Floats, inputs: Inputs, dof: float, time_std: float
) -> TriadFit:
    rank = residual.size - parameters.size
    values, vectors = np.linalg.eigh(spread[12:, 12:])
    values, vectors = values[values.size - rank :], vectors[:, values.size - rank :]
    known_spread = values[0] > _LEAST_SPREAD * values[-1]  # rounding errors of a sensor without noise are no spread
    chi2 = float(np.sum((vectors.T @ residual.ravel()) ** 2 / values)) if known_spread else 0.0
    inflated = improbable(chi2, rank)
    matrix = parameters[:9].reshape(3, 3)
    # S grows with the seconds that are counted, K and the bias shrink
    time = time_std**2 * np.outer(parameters, parameters)
    return TriadFit(
        matrix=matrix,
        bias=parameters[9:],
        covariance=spread[:12, :12] * (chi2 / rank if inflated else 1.0) + time,
        residual=(residual / inputs.duration_s[:, None]) @ matrix.T,
        chi2=chi2,
        residual_dof=rank,
        dof=min(dof, float(rank)) if inflated else dof,
        inflated=inflated,
    )


def _equal_lengths(samples: Sequence[Samples]) -> list[Samples]:
    """Cut the longer record of each pair at its end, where the table rests."""
    kept = []
    for first, second in zip(samples[0::2], samples[1::2], strict=True):
        shorter_s = min(first.duration_s, second.duration_s)
        for each in (first, second):
            half_s = 0.5 * float(np.median(each.step_s))
            kept.append(each.first(int(np.searchsorted(np.cumsum(each.step_s), shorter_s + half_s))))
    return kept


def _noise(records: Sequence[RotationRecord], samples: Sequence[Samples]) -> tuple[Floats, Floats, float]:
    """Density (3, 3), standard deviation of single samples (3,) and degrees of freedom, pooled over the records."""
    each = [noise_density(kept, record.axis, record.name) for record, kept in zip(records, samples, strict=True)]
    variances = [
        np.var(kept.rate[resting(kept, record.axis)], axis=0) for record, kept in zip(records, samples, strict=True)
    ]
    dof = math.fsum(noise[1] for noise in each)
    return np.sum([noise[0] * noise[1] for noise in each], axis=0) / dof, np.sqrt(np.mean(variances, axis=0)), dof


def _declared(
    noise: SensorNoise, records: Sequence[RotationRecord], samples: Sequence[Samples]
) -> tuple[Floats, Floats, float]:
    """Return the same as ``_noise``, of noise that is declared."""
    dof = math.fsum(noise_dof(kept, record.axis, record.name) for record, kept in zip(records, samples, strict=True))
    return noise.density * np.eye(3), np.full(3, noise.sample_std), dof


def _wandering(noise: SensorNoise, records: Sequence[RotationRecord], samples: Sequence[Samples]) -> Floats:
    """Return covariance of each sensor's bias in the records, less its mean over the turns about the other two axes."""
    begin_s = np.array([record.begin_s for record in records])
    length_s = np.array([kept.duration_s for kept in samples])
    axes = np.array([record.axis for record in records])
    return np.stack([noise.wander_about_mean(begin_s, length_s, axes != axis) for axis in AXES])


def fit_turns_from_rest(
    records: Sequence[RotationRecord], rest: Floats, rest_covariance: Floats, density: Floats, declared: Declared
) -> TriadFit:
    """Fit S and bias where each axis was turned once only: the bias comes from records at rest.

    Args:    records: three, one turn about each body axis, rates in deg/s.   rest: (3,) mean output at rest, deg/s.
             rest_covariance: (3, 3) of it.   density: (3, 3) white noise (deg/s)^2 s (covariance at rest times its
             length).   declared: uncertainties of the turns.
    Returns: TriadFit, w = K N - bias; the Earth's rate is left in. There are no residuals.
    Raises:  FitError B-FIT-080, -081 and -082 as ``fit_rotations``.
    Source:  Ferraris, Grimaldi and Parvis 1995 (bias at rest, turns of 360 degrees); GNC module paper (1), corrected.
    """
    ordered = [record_about(records, axis, None) for axis in AXES]
    turns = [whole_turn(record, good_samples(record), rest) for record in ordered]
    inputs = Inputs.of([(turn,) for turn in turns], None)

    def parameters(vector: Floats) -> Floats:
        there, offset = inputs.at(vector[3:]), vector[:3]
        clear = there.integral - offset * there.duration_s[:, None]
        inverse = np.linalg.inv(np.linalg.solve(there.known, clear).T)
        return np.concatenate([inverse.ravel(), inverse @ offset])

    vector = np.concatenate([rest, inputs.vector])
    covariance = np.zeros((vector.size,) * 2)
    covariance[:3, :3] = rest_covariance
    covariance[3:, 3:] = inputs.covariance(declared, density, np.zeros((3, 3)))
    solution = parameters(vector)
    return TriadFit(
        matrix=solution[:9].reshape(3, 3),
        bias=solution[9:],
        covariance=propagate_inputs(parameters, vector, covariance),
        residual=np.zeros((3, 3)),
        chi2=0.0,
        residual_dof=0,
        dof=math.inf,
    )
