"""Readings of a turned magnetometer, written from the definition of the errors and without the code of the fits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FIELD_gauss, NOISE_gauss, STEP_gauss = 0.43, 0.5e-3, 120e-6
RATE_Hz, LENGTH_s = 200.0, 180.0
QUICK_deg_s, SLOW_deg_s = 15.0 * 360.0, 15.0


@dataclass(frozen=True)
class PlaneUnit:
    """Errors of two axes; ``alpha_deg`` leans axis X towards the field of +y."""

    offset: tuple[float, float] = (0.05, -0.02)
    gain: float = 1.03
    alpha_deg: float = 1.5
    radius: float = FIELD_gauss

    @property
    def truth(self) -> np.ndarray:
        return np.array([*self.offset, self.gain, self.alpha_deg, self.radius])


def drawn_unit(rng: np.random.Generator) -> PlaneUnit:
    x, y = rng.normal(0.0, 0.05, 2)
    return PlaneUnit((float(x), float(y)), float(1.0 + rng.normal(0.0, 0.03)), float(rng.normal(0.0, 1.5)))


@dataclass(frozen=True)
class Turn:
    """How the unit was turned and read; ``clock`` is what table and unit are off from their nominal ratio."""

    rate_deg_s: float = QUICK_deg_s
    rate_Hz: float = RATE_Hz
    length_s: float = LENGTH_s
    begin_deg: float = 0.0
    clock: float = 0.0
    noise: float = NOISE_gauss
    step: float = STEP_gauss


def turned(unit: PlaneUnit, turn: Turn, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Readings x_out, y_out of a right-handed turn of the unit about +z: the field goes from +x towards -y."""
    t_s = np.arange(round(turn.length_s * turn.rate_Hz)) / turn.rate_Hz
    roll = np.deg2rad(turn.begin_deg + turn.rate_deg_s * (1.0 + turn.clock) * t_s)
    x, y = unit.radius * np.cos(roll), -unit.radius * np.sin(roll)
    lean = np.deg2rad(unit.alpha_deg)
    x_out = unit.offset[0] + x * np.cos(lean) + y * np.sin(lean)
    y_out = unit.offset[1] + y / unit.gain
    both = [one + rng.normal(0.0, turn.noise, t_s.size) if turn.noise else one for one in (x_out, y_out)]
    if turn.step:
        both = [np.round(one / turn.step) * turn.step for one in both]
    return both[0], both[1]


def halir_flusser(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Coefficients a..f of the direct ellipse by the formulas of Halir and Flusser (WSCG 1998), with numpy's eig."""
    quadratic = np.column_stack((x**2, x * y, y**2))
    linear = np.column_stack((x, y, np.ones(x.size)))
    s1, s2, s3 = quadratic.T @ quadratic, quadratic.T @ linear, linear.T @ linear
    back = -np.linalg.solve(s3, s2.T)
    reduced = s1 + s2 @ back
    reduced = np.array([reduced[2] / 2.0, -reduced[1], reduced[0] / 2.0])
    vectors = np.real(np.linalg.eig(reduced)[1])
    kind = 4.0 * vectors[0] * vectors[2] - vectors[1] ** 2
    best = vectors[:, int(np.argmax(kind))]
    return np.concatenate((best, back @ best))


def conic_parameters(conic: np.ndarray) -> np.ndarray:
    """Offsets, K_y, alpha, radius from the coefficients of a conic, by the paper's model written as a conic."""
    a, b, c, d, e, f = conic
    centre = np.linalg.solve(np.array([[2 * a, b], [b, 2 * c]]), -np.array([d, e]))
    size = a * centre[0] ** 2 + b * centre[0] * centre[1] + c * centre[1] ** 2 - f
    sine = -b / (2.0 * np.sqrt(a * c)) * np.sign(a)
    radius = np.sqrt(size / a / (1.0 - sine**2))
    return np.array([*centre, np.sqrt(c / a), np.rad2deg(np.arcsin(sine)), radius])
