"""Ellipse of two magnetometer axes turned in a constant field: zero, gain and non-orthogonality by least squares.

Model, x and y in units of axis X: ``x_out = dX + x cos(alpha) + y sin(alpha)``, ``y_out = dY + y / K_y`` with (x, y) on
a circle; ``alpha`` is positive where x_out is positive at the largest y_out.

Source: GNC paper (001) equations (5) to (9), (9) divided by cos(alpha) as corrected: x = (x_out - y sin alpha) / cos
alpha after zero and gain. Least squares: ``bench.systems.gnc.estimators.magnetometer.quadric``.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from bench.maths.arrays import Flags, Floats
from bench.model.errors import FitError
from bench.systems.gnc.estimators.magnetometer.quadric import Quadric, fit_quadric
from bench.systems.gnc.estimators.magnetometer.wander import odd_readings

LARGEST_GAP_deg = 60.0  # of the turn without a reading
PARAMETERS = ("offset_x", "offset_y", "gain", "alpha_deg", "radius")
_STEP = 1e-6


@dataclass(frozen=True)
class PlaneParameters:
    """Correction of two axes, and how well it is known; offsets and radius in the unit of the readings.

    Attributes:
        offset: (2,).   gain: K_y.   alpha_deg: non-orthogonality.   radius: field in the plane, sensitivity of axis X.
        covariance: (5, 5) in the order of ``PARAMETERS``, alpha in degrees.
        bias: (5,) expected error of the method itself, not taken off and not in ``covariance``; 0 for least squares.
        dof: (5,) degrees of freedom behind ``covariance``.
    """

    offset: Floats
    gain: float
    alpha_deg: float
    radius: float
    covariance: Floats
    bias: Floats
    dof: Floats = field(default_factory=lambda: np.full(5, np.inf))

    @property
    def values(self) -> Floats:
        """(5,) in the order of ``PARAMETERS``."""
        return np.array([*self.offset, self.gain, self.alpha_deg, self.radius])

    @property
    def std(self) -> Floats:
        """(5,) standard uncertainties, the expected error of the method included."""
        return np.sqrt(np.diag(self.covariance) + self.bias**2)

    def corrected(self, x_out: Floats, y_out: Floats) -> tuple[Floats, Floats]:
        """Return components without zero, gain and non-orthogonality, in units of axis X.

        Args:    x_out, y_out: (n,), unit of the readings.
        Returns: x, y: (n,) each, on a circle of ``radius`` about the origin.
        Source:  GNC paper equations (7) to (9), (9) corrected.
        """
        return corrected(self.values, x_out, y_out)


@dataclass(frozen=True)
class EllipseFit:
    """Least-squares ellipse.

    Attributes:
        parameters: PlaneParameters.   quadric: the curve, its residuals and how their noise wanders.
        odd: (n,) readings that were left out: off the ellipse of the others, one among a thousand.
        slope: (5, 5) derivatives of the parameters by those of the quadric.
        phase_deg: angle of the corrected components of each reading kept, (m,), -180 to 180.
        largest_gap_deg: largest part of the turn without a reading.   phases: distinct phases, readings nearer to each
            other than the noise counted once; 0 where the turn has
            no gap.
    """

    parameters: PlaneParameters
    quadric: Quadric
    odd: Flags
    slope: Floats
    phase_deg: Floats
    largest_gap_deg: float
    phases: int

    @property
    def noise(self) -> float:
        """Standard deviation of the orthogonal distances, unit of the readings."""
        return self.quadric.noise


def corrected(values: Floats, x_out: Floats, y_out: Floats) -> tuple[Floats, Floats]:
    """Return components corrected by five values in the order of ``PARAMETERS``; see ``PlaneParameters.corrected``."""
    sine, cosine = np.sin(np.deg2rad(values[3])), np.cos(np.deg2rad(values[3]))
    y = values[2] * (y_out - values[1])
    return (x_out - values[0] - y * sine) / cosine, y


def fit_ellipse(x_out: Floats, y_out: Floats, noise: float | None = None) -> EllipseFit:
    """Zero, gain and non-orthogonality from all readings of a rotation.

    Args:    x_out, y_out: (n,), same unit, noise alike on both axes.   noise: of readings that hold none.
    Returns: EllipseFit.
    Raises:  FitError B-FIT-090 if no ellipse passes through the readings; B-FIT-091 if a part of the turn of more
             than 60 degrees has none, naming where.
    Source:  see the head of this file; covariance by first derivatives, JCGM 102:2011 section 6.2.
    """
    points = np.column_stack((x_out, y_out)).astype(np.float64)
    odd = odd_readings(points)
    points = points[~odd]
    quadric = fit_quadric(points, noise=noise)
    values = parameters_of(np.concatenate((quadric.centre, quadric.shape[np.triu_indices(2)])))
    x, y = corrected(values, points[:, 0], points[:, 1])
    phase_deg = np.rad2deg(np.arctan2(y, x))
    gap_deg, at_deg = _largest_gap(phase_deg)
    if gap_deg > LARGEST_GAP_deg:
        raise FitError(
            "B-FIT-091",
            f"the readings leave {gap_deg:.0f} degrees of the turn empty (limit {LARGEST_GAP_deg:.0f}), "
            f"about the direction {at_deg:.0f} degrees from +x to +y",
            next_step="turn the unit through at least one whole turn while the magnetometer is read",
        )
    slope = _derivative(quadric)
    parameters = PlaneParameters(
        offset=values[:2],
        gain=float(values[2]),
        alpha_deg=float(values[3]),
        radius=float(values[4]),
        covariance=slope @ quadric.covariance @ slope.T,
        bias=np.zeros(5),
        dof=quadric.uncertainty.dof(slope),
    )
    return EllipseFit(
        parameters=parameters,
        quadric=quadric,
        odd=odd,
        slope=slope,
        phase_deg=phase_deg,
        largest_gap_deg=gap_deg,
        phases=_distinct(phase_deg, np.rad2deg(quadric.noise / parameters.radius)),
    )


def parameters_of(place: Floats) -> Floats:
    """Return the five parameters, (5,), from the centre and the upper triangle (w00, w01, w11) of a quadric."""
    w00, w01, w11 = place[2:]
    length = np.hypot(w01, w11)
    alpha = np.arctan2(-w01, w11)
    radius = length / (w00 * w11)
    return np.array([place[0], place[1], length / w00, np.rad2deg(alpha), radius])


def _derivative(quadric: Quadric) -> Floats:
    """(5, 5) derivatives of the parameters with respect to those of the quadric, by central differences."""
    place = np.concatenate((quadric.centre, quadric.shape[np.triu_indices(2)]))
    steps = _STEP * np.concatenate((np.full(2, 1.0 / quadric.shape[0, 0]), np.full(3, quadric.shape[0, 0])))
    columns = [
        (parameters_of(place + step) - parameters_of(place - step)) / (2.0 * step.sum()) for step in np.diag(steps)
    ]
    return np.column_stack(columns)


def _largest_gap(phase_deg: Floats) -> tuple[float, float]:
    """Return largest empty part of the turn and its middle, degrees."""
    ordered, gaps = _gaps(phase_deg)
    place = int(np.argmax(gaps))
    middle = ordered[place] + gaps[place] / 2.0
    return float(gaps[place]), float((middle + 180.0) % 360.0 - 180.0)


def _gaps(phase_deg: Floats) -> tuple[Floats, Floats]:
    """Return the phases in order and what is between each and the next one round the turn."""
    ordered = np.sort(phase_deg)
    return ordered, np.diff(ordered, append=ordered[0] + 360.0)


def _distinct(phase_deg: Floats, noise_deg: float) -> int:
    """Clusters of phases that are further apart than ten times their noise: 10 for ten readings in every turn.

    0 for readings so close that no gap is between any of them.
    """
    _, gaps = _gaps(phase_deg)
    return int((gaps > 10.0 * noise_deg).sum())
