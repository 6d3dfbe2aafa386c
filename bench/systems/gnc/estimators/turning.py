"""A turn of the table: the known input of each record, and what of a constant local vector the unit sees meanwhile.

Source: GNC module paper section 4.2 1); Earth's rate as in ``bench.systems.gnc.estimators.earth_rate``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.model.errors import FitError
from bench.systems.gnc.estimators.earth_rate import mounting_matrix, turn_axis_in_body, turned_about
from bench.systems.gnc.estimators.records import MARGIN_S, RotationRecord, Samples, resting
from bench.systems.gnc.estimators.triad import AXES

Array = NDArray[np.float64]
_LOWEST, _HIGHEST = 0.8, 1.25  # of the turn that was asked for, by the sensor's nominal scale
_ALONG = 0.999  # cosine


@dataclass(frozen=True)
class Turn:
    """A part of a record as numbers of a linear model: ``integral`` (3,) deg, ``known`` (3,) deg turned in body axes,
    ``seen`` (3, 3) s: times a vector in the frame of the table's base it is the integral of that vector over the
    part in body axes.   ``rest_s``: how much of it is rest.
    """

    integral: Array
    known: Array
    seen: Array
    duration_s: float
    rest_s: float


def whole_turn(record: RotationRecord, samples: Samples, rest: Array) -> Turn:
    """Integrate a record as a whole; the angle of the turning axis comes from its own sensor, scaled to the known turn.

    Args:    record: what was turned.   samples: those of its samples that count.   rest: (3,) output at rest, deg/s.
    Returns: Turn; ``seen`` is zero if the record has no pose.
    Raises:  FitError B-FIT-081 if the body axis named is not the one that turns, B-FIT-082 if the outputs say another
             turn than the record (below 0.8 or above 1.25 of it).
    Source:  GNC module paper section 4.2 1): outputs summed times the output period.
    """
    return _part(record, samples, _angle_deg(record, samples, rest), np.ones(len(samples.rate), dtype=bool), True)


def turn_and_rest(record: RotationRecord, samples: Samples) -> tuple[Turn, Turn]:
    """Integrate the movement of a record (with 0.5 s around it) and its rest apart.

    Args:    record: what was turned.   samples: those of its samples that count; some of them at rest.
    Returns: the turn and the rest, as ``whole_turn``.
    Raises:  FitError B-FIT-081 and -082, as ``whole_turn``.
    Source:  GNC module paper section 4.2 1).
    """
    rest = resting(samples, record.axis)
    angle_deg = _angle_deg(record, samples, samples.rate[rest].mean(axis=0))
    return _part(record, samples, angle_deg, ~rest, True), _part(record, samples, angle_deg, rest, False)


def _angle_deg(record: RotationRecord, samples: Samples, rest: Array) -> Array:
    """Return angle turned about the body axis in the middle of each sample."""
    axis = AXES.index(record.axis)
    steps = samples.step_s * (samples.rate[:, axis] - rest[axis])
    turned = np.cumsum(steps)
    share = float(turned[-1]) / record.turn_deg
    if not _LOWEST < share < _HIGHEST:
        raise FitError(
            "B-FIT-082",
            f"record {record.name}: the outputs add up to {turned[-1]:.1f} deg, the turn is {record.turn_deg:+.0f} deg",
            next_step="look at the record: it must hold the whole turn, about the axis and in the direction it names",
        )
    return np.asarray((turned - 0.5 * steps) / share)


def _part(record: RotationRecord, samples: Samples, angle_deg: Array, part: NDArray[np.bool_], moves: bool) -> Turn:
    step_s, known = samples.step_s[part], np.zeros(3)
    known[AXES.index(record.axis)] = record.turn_deg if moves else 0.0
    duration_s = float(np.sum(step_s))
    seen = _seen(record, angle_deg[part], step_s)
    return Turn(step_s @ samples.rate[part], known, seen, duration_s, 2.0 * MARGIN_S if moves else duration_s)


def _seen(record: RotationRecord, angle_deg: Array, step_s: Array) -> Array:
    """Integral of the matrix that takes a vector from the table's base to the body."""
    pose, axis = record.pose, AXES.index(record.axis)
    if pose is None:
        return np.zeros((3, 3))
    along = turn_axis_in_body(pose, record.turned)[axis]
    if abs(along) < _ALONG:
        raise FitError(
            "B-FIT-081",
            f"record {record.name}: the {record.turned} axis does not turn about body axis {record.axis} in this pose "
            f"(mounting {pose.mounting}, middle {pose.middle_deg:g} deg): cosine {along:.4f}",
            next_step="correct axis, mounting or turned axis in the conditions of the record",
        )
    inner, outer = turned_about(0, -pose.inner_deg), turned_about(2, -pose.outer_deg)
    middle, fixed = turned_about(1, -pose.middle_deg), mounting_matrix(pose.mounting).T
    moving = _integral_of_rotation(0 if record.turned == "inner" else 2, -angle_deg * along, step_s)
    if record.turned == "inner":
        return np.asarray(fixed @ moving @ inner @ middle @ outer)
    return np.asarray(fixed @ inner @ middle @ moving @ outer)


def _integral_of_rotation(axis: int, angle_deg: Array, step_s: Array) -> Array:
    """Return sum of step times rotation matrix about axis 0 or 2."""
    angle, one, two = np.radians(angle_deg), (axis + 1) % 3, (axis + 2) % 3
    matrix = np.zeros((3, 3))
    matrix[axis, axis] = np.sum(step_s)
    matrix[one, one] = matrix[two, two] = step_s @ np.cos(angle)
    matrix[two, one] = step_s @ np.sin(angle)
    matrix[one, two] = -matrix[two, one]
    return matrix
