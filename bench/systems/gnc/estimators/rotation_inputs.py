"""Turns of the table as inputs of the calibration of gyroscopes: the known input of each record, what of a constant
local vector the unit sees meanwhile, and everything that the calibration depends on as one vector with a covariance.

Source: GNC module paper section 4.2 1); Earth's rate as in ``bench.systems.gnc.estimators.earth_rate``; JCGM 102:2011
section 6.2 (input quantities and their covariance).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bench.maths.arrays import Flags, Floats
from bench.model.errors import FitError
from bench.systems.gnc.estimators.earth_rate import (
    MARGIN_S,
    RotationRecord,
    Samples,
    Site,
    earth_rate_local_deg_s,
    mounting_matrix,
    resting,
    table_to_local,
    turn_axis_in_body,
    turned_about,
)
from bench.systems.gnc.estimators.triad import AXES

_LOWEST, _HIGHEST = 0.8, 1.25  # of the turn that was asked for, by the sensor's nominal scale
_ALONG = 0.999  # cosine


@dataclass(frozen=True)
class Turn:
    """A part of a record as numbers of a linear model: ``integral`` (3,) deg, ``known`` (3,) deg turned in body axes,
    ``seen`` (3, 3) s: times a vector in the frame of the table's base it is the integral of that vector over the
    part in body axes.   ``rest_s``: how much of it is rest.
    """

    integral: Floats
    known: Floats
    seen: Floats
    duration_s: float
    rest_s: float


def whole_turn(record: RotationRecord, samples: Samples, rest: Floats) -> Turn:
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


def _angle_deg(record: RotationRecord, samples: Samples, rest: Floats) -> Floats:
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


def _part(record: RotationRecord, samples: Samples, angle_deg: Floats, part: Flags, moves: bool) -> Turn:
    step_s, known = samples.step_s[part], np.zeros(3)
    known[AXES.index(record.axis)] = record.turn_deg if moves else 0.0
    duration_s = float(np.sum(step_s))
    seen = _seen(record, angle_deg[part], step_s)
    return Turn(step_s @ samples.rate[part], known, seen, duration_s, 2.0 * MARGIN_S if moves else duration_s)


def _seen(record: RotationRecord, angle_deg: Floats, step_s: Floats) -> Floats:
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
        return fixed @ moving @ inner @ middle @ outer
    return fixed @ inner @ middle @ moving @ outer


def _integral_of_rotation(axis: int, angle_deg: Floats, step_s: Floats) -> Floats:
    """Return sum of step times rotation matrix about axis 0 or 2."""
    angle, second, third = np.radians(angle_deg), (axis + 1) % 3, (axis + 2) % 3
    matrix = np.zeros((3, 3))
    matrix[axis, axis] = np.sum(step_s)
    matrix[second, second] = matrix[third, third] = step_s @ np.cos(angle)
    matrix[third, second] = step_s @ np.sin(angle)
    matrix[second, third] = -matrix[third, second]
    return matrix


@dataclass(frozen=True)
class Declared:
    """Standard uncertainties: ``tilt_std_deg`` of the axis of turn against the body axis (each of two directions,
    common to forth and back), ``resolution_deg_s`` step of the output, ``drift_deg_s`` by which the bias wanders from
    record to record, ``time_std`` of all durations together, relative.
    """

    tilt_std_deg: float = 0.0
    resolution_deg_s: float = 0.0
    drift_deg_s: float = 0.0
    time_std: float = 0.0


@dataclass(frozen=True)
class Inputs:
    """Per part of a record: ``integral`` (r, 3) deg, ``known`` (r, 3) deg, ``seen`` (r, 3, 3) s, ``earth`` (r, 3) deg:
    integral of the Earth's rate in body axes, ``duration_s`` and ``rest_s`` (r,), ``record`` (r,) number of the record
    it belongs to.   ``seen`` and ``earth`` are zero where there is no Earth's rate to compensate.
    """

    integral: Floats
    known: Floats
    seen: Floats
    earth: Floats
    duration_s: Floats
    rest_s: Floats
    record: NDArray[np.intp]

    @staticmethod
    def of(records: Sequence[Sequence[Turn]], site: Site | None) -> Inputs:
        """From the parts of each record; without a site the Earth's rate is left in."""
        turns = [turn for parts in records for turn in parts]
        seen = np.stack([turn.seen for turn in turns]) * (site is not None)
        rate = table_to_local(site).T @ earth_rate_local_deg_s(site.latitude_deg) if site else np.zeros(3)
        return Inputs(
            integral=np.stack([turn.integral for turn in turns]),
            known=np.stack([turn.known for turn in turns]),
            seen=seen,
            earth=seen @ rate,
            duration_s=np.array([turn.duration_s for turn in turns]),
            rest_s=np.array([turn.rest_s for turn in turns]),
            record=np.repeat(np.arange(len(records)), [len(parts) for parts in records]),
        )

    @property
    def vector(self) -> Floats:
        """Integrals, and tilt (3 each) of the turns about x, y, z."""
        return np.concatenate([self.integral.ravel(), np.zeros(9)])

    def at(self, vector: Floats) -> Inputs:
        """Return the same with the values of a vector."""
        known, about = self.known, vector[-9:].reshape(3, 3)[np.argmax(np.abs(self.known), axis=1)]
        ahead, behind = known[:, [1, 2, 0]], known[:, [2, 0, 1]]  # numpy's cross takes longer than the fit
        known = known + about[:, [1, 2, 0]] * behind - about[:, [2, 0, 1]] * ahead
        return replace(self, integral=vector[:-9].reshape(-1, 3), known=known)

    def covariance(
        self, declared: Declared, density: Floats, common: Floats, wandering: Floats | None = None
    ) -> Floats:
        """Of ``vector``: white noise ``density`` (3, 3) deg^2/s, ``common`` (3, 3) (deg/s)^2 to all rests,
        ``wandering`` of each sensor's bias from record to record, (3, records, records) (deg/s)^2.
        """
        count, length = len(self.known), self.duration_s
        covariance: Floats = np.eye(3 * count + 9) * np.radians(declared.tilt_std_deg) ** 2
        together = np.outer(length, length) * (self.record[:, None] == self.record)
        covariance[: 3 * count, : 3 * count] = (
            np.kron(np.diag(length), density)
            + np.kron(np.outer(self.rest_s, self.rest_s), common)
            + np.kron(together, np.eye(3) * declared.drift_deg_s**2)
        )
        if wandering is not None:
            for sensor, seen in enumerate(wandering):
                own = np.outer(length, length) * seen[np.ix_(self.record, self.record)]
                covariance[sensor : 3 * count : 3, sensor : 3 * count : 3] += own
        return covariance
