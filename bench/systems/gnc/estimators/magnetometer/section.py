"""Ellipse that an ellipsoid promises for a turn about one axis: its section by the plane of the readings.

The plane of the turn is that of the readings themselves, z = p + q x + r y, so neither the axis of the table nor the
mounting needs to be known.

Source: coordinate geometry of a quadric; covariance by first derivatives, JCGM 102:2011 section 6.2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bench.systems.gnc.estimators.magnetometer.ellipse import PlaneParameters, parameters_of
from bench.systems.gnc.estimators.magnetometer.quadric import Quadric
from bench.systems.gnc.estimators.magnetometer.wander import uncertainty

Array = NDArray[np.float64]
_STEP = 1e-6
_TRIANGLE = np.triu_indices(3)


def section_of(quadric: Quadric, turn: Array) -> PlaneParameters:
    """Return the parameters of axes x and y in the plane of a turn, with what ellipsoid and plane leave open.

    Args:    quadric: in space.   turn: (n, 3) readings, unit of the quadric.
    Returns: PlaneParameters; not a number where the plane does not cut the ellipsoid.
    Source:  see the head of this file.
    """
    design = np.column_stack((np.ones(len(turn)), turn[:, :2]))
    plane = np.linalg.lstsq(design, turn[:, 2], rcond=None)[0]
    of_plane = uncertainty(-design, turn[:, 2] - design @ plane)
    place = np.concatenate((quadric.centre, quadric.shape[_TRIANGLE], plane))
    size = float(quadric.shape[0, 0])
    steps = _STEP * np.concatenate((np.full(3, 1.0 / size), np.full(6, size), [1.0 / size, 1.0, 1.0]))
    slope = np.column_stack([(_section(place + step) - _section(place - step)) / (2.0 * step.sum())
                             for step in np.diag(steps)])  # fmt: skip
    values = _section(place)
    return PlaneParameters(
        offset=values[:2],
        gain=float(values[2]),
        alpha_deg=float(values[3]),
        radius=float(values[4]),
        covariance=slope[:, :9] @ quadric.covariance @ slope[:, :9].T
        + slope[:, 9:] @ of_plane.covariance @ slope[:, 9:].T,
        bias=np.zeros(5),
        dof=np.minimum(quadric.uncertainty.dof(slope[:, :9]), of_plane.dof(slope[:, 9:])),
    )


def _section(place: Array) -> Array:
    """(5,) offsets, gain, angle and radius from centre, shape and plane (12,)."""
    shape = np.zeros((3, 3))
    shape[_TRIANGLE] = place[3:9]
    origin = np.array([0.0, 0.0, place[9]]) - place[:3]
    along = shape @ np.array([[1.0, 0.0], [0.0, 1.0], [place[10], place[11]]])
    middle = -np.linalg.lstsq(along, shape @ origin, rcond=None)[0]
    left = 1.0 - float(np.sum((along @ middle + shape @ origin) ** 2))
    if left <= 0.0:
        return np.full(5, np.nan)
    upper = np.linalg.cholesky(along.T @ along / left).T
    return parameters_of(np.concatenate((middle, upper[np.triu_indices(2)])))
