"""Phase of a dithered ring laser on a fine grid of many half cycles at once.

With G(t) the phase without lock-in and v = psi - G, w = exp(i v) obeys a Riccati equation,

    dw/dt = kappa/2 [E - conj(E) w^2],    E = exp(-i (G + beta)),

so any stretch of time maps w by (A w + B) / (conj(B) w + conj(A)), and A, B do not depend on w: they are found for all
stretches of all half cycles at once, then w is carried through the stretches by scalars, and v on the grid is
v_0 + 2 arg(A + B conj(w_0)). A and B are the ordered integrals of kappa E / 2, up to the third; stretches are a tenth
of a half cycle, so the fourth is below 1e-7 rad. Integrals over a step are the two-point Hermite rule of sixth order.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.model.arrays import Floats, Integers

Complex = NDArray[np.complex128]

SEGMENTS = 10  # stretches of a half cycle
TURN = 2.0 * math.pi
_SETTLED_RAD, _MOST_ROUNDS = 1e-9, 30


@dataclass(frozen=True)
class Drive:
    """The drive of the phase in n consecutive half cycles of ``half_s`` with ``steps`` steps each; rates of phase.

    ``amplitude_rad_s``: signed amplitude of the dither, (n,).   ``rate_rad_s``: of the input.   ``kappa_rad_s``: K W_L.
    ``beta_rad``: (n,).   ``walk_rad``: steps of the random walk of quantum noise, (n, steps), or None: the noise is
    constant within a step, so the phase stays smooth between the points of the grid.
    ``second``, ``second_phase_rad``: second harmonic of the backscatter, relative.
    """

    half_s: float
    steps: int
    amplitude_rad_s: Floats
    rate_rad_s: float
    kappa_rad_s: float
    beta_rad: Floats
    walk_rad: Floats | None = None
    second: float = 0.0
    second_phase_rad: float = 0.0

    @property
    def step_s(self) -> float:
        """One step of the grid, seconds."""
        return self.half_s / self.steps

    def shape(self) -> tuple[Floats, Floats, Floats]:
        """Return time since the half cycle began, sine and cosine of the dither on the grid, (steps + 1,)."""
        tau_s = np.arange(self.steps + 1) * self.step_s
        angle = np.pi / self.half_s * tau_s
        sine = np.sin(angle)
        sine[-1] = 0.0
        return tau_s, sine, np.cos(angle)

    @property
    def angular_Hz(self) -> float:
        """Angular frequency of the dither, rad/s."""
        return math.pi / self.half_s


@dataclass(frozen=True)
class Motion:
    """``psi_rad``: phase on the grid, (n, steps + 1), each half cycle within a turn of zero at its beginning.

    ``turns``: whole turns to be added to each half cycle, (n,).   ``start_rad``: unwrapped phase at the beginning of
    each, (n,).   ``end_rad``: unwrapped phase behind the last.
    """

    psi_rad: Floats
    turns: Integers
    start_rad: Floats
    end_rad: float


def integrate(drive: Drive, psi_rad: float) -> Motion:
    """Integrate from the phase ``psi_rad`` on. A second harmonic enters as a known input, found by repetition."""
    motion = _riccati(drive, psi_rad, None)
    if drive.second == 0.0:
        return motion
    for _ in range(_MOST_ROUNDS):
        previous = motion
        motion = _riccati(drive, psi_rad, _second_harmonic(drive, previous.psi_rad))
        if np.abs(motion.start_rad - previous.start_rad).max() + abs(motion.end_rad - previous.end_rad) < _SETTLED_RAD:
            break
    return motion


def circle(angle_rad: Floats) -> tuple[Floats, Floats]:
    """Return cosine and sine, by the tangent of the half angle: numpy's tangent is ten times as fast as its sine."""
    t = np.tan(0.5 * angle_rad)
    square = t * t
    scale = 1.0 / (1.0 + square)
    return (1.0 - square) * scale, 2.0 * t * scale


def _riccati(drive: Drive, psi_rad: float, extra_rad: Floats | None) -> Motion:
    tau_s, sine, cosine = drive.shape()
    free = np.multiply.outer(drive.amplitude_rad_s / drive.angular_Hz, sine)
    free += drive.rate_rad_s * tau_s
    if drive.walk_rad is not None:
        free[:, 1:] += np.cumsum(drive.walk_rad, axis=1)
    if extra_rad is not None:
        free += extra_rad
    first, second, third = _ordered_integrals(*_step_integrals(drive, free, sine, cosine))
    v_rad, w, turns, start_rad, end_rad = _chain(psi_rad, free[:, -1], first[..., -1] + third[..., -1], second[..., -1])
    first += third
    first *= w.conj()[..., None]
    second += first
    turned = second.imag / (1.0 + second.real)
    np.arctan(turned, out=turned)
    turned *= 2.0
    turned += v_rad[..., None]
    free[:, 1:] += turned.reshape(len(free), -1)
    free[:, 0] = v_rad[:, 0]
    return Motion(free, turns, start_rad, end_rad)


def _step_integrals(drive: Drive, free_rad: Floats, sine: Floats, cosine: Floats) -> tuple[Complex, Floats]:
    """Return kappa/2 times the integral of E over each step, (n, steps), and the second one's curl within a step."""
    h, k = drive.step_s, 0.5 * drive.kappa_rad_s
    rate = np.multiply.outer(drive.amplitude_rad_s * h, cosine)  # g h
    rate += drive.rate_rad_s * h
    swing = np.empty(free_rad.shape, np.complex128)
    swing.real, swing.imag = circle(free_rad + drive.beta_rad[:, None])
    np.negative(swing.imag, out=swing.imag)
    even = rate * rate
    even *= -k * h / 120.0
    even += k * h / 2.0
    bent = np.multiply.outer(drive.amplitude_rad_s * (k * h**3 / 120.0 * drive.angular_Hz), sine)
    weight = np.empty(swing.shape, np.complex128)
    weight.real = even
    np.multiply(rate, -k * h / 10.0, out=weight.imag)
    weight.imag += bent
    steps = (swing * weight)[:, :-1]
    np.multiply(rate, k * h / 10.0, out=weight.imag)
    weight.imag += bent
    weight *= swing
    steps += weight[:, 1:]
    middle = 0.5 * (rate[:, 1:] + rate[:, :-1])
    square = middle * middle
    curl = middle * (-((k * h) ** 2)) * (1.0 / 6.0 - square / 120.0 + square * square / 5040.0)
    return steps, curl


def _ordered_integrals(steps: Complex, curl: Floats) -> tuple[Complex, Complex, Complex]:
    """Return first, second and third ordered integral from the beginning of each stretch to each step's end."""
    n = len(steps)
    steps = steps.reshape(n, SEGMENTS, -1)
    first = np.cumsum(steps, axis=-1)
    inner = first - 0.5 * steps
    np.conj(inner, out=inner)
    inner *= steps
    inner.imag += curl.reshape(steps.shape)
    second = np.cumsum(inner, axis=-1)
    inner *= -0.5
    inner += second
    np.conj(inner, out=inner)
    inner *= steps
    return first, second, np.cumsum(inner, axis=-1)


def _chain(
    psi_rad: float, free_end_rad: Floats, b: Complex, a: Complex
) -> tuple[Floats, Complex, Integers, Floats, float]:
    """Carry the state through all stretches: v and w at the beginning of each, (n, SEGMENTS), turns, phases."""
    values, points = np.empty(a.shape), np.empty(a.shape, np.complex128)
    n = len(a)
    turns, start_rad = np.zeros(n, np.int64), np.empty(n)
    turned = 0
    a_rows, b_rows, ends = (1.0 + a).tolist(), b.tolist(), free_end_rad.tolist()
    for row in range(n):
        whole = round(psi_rad / TURN)
        turned, psi_rad = turned + whole, psi_rad - whole * TURN
        turns[row], start_rad[row] = turned, psi_rad + turned * TURN
        v, w = psi_rad, cmath.exp(1j * psi_rad)
        for segment in range(SEGMENTS):
            values[row, segment], points[row, segment] = v, w
            c = a_rows[row][segment] + b_rows[row][segment] * w.conjugate()
            w *= c * c / (c.real * c.real + c.imag * c.imag)
            v += 2.0 * math.atan2(c.imag, c.real)
        psi_rad = v + ends[row]
    return values, points, turns, start_rad, psi_rad + turned * TURN


def _second_harmonic(drive: Drive, psi_rad: Floats) -> Floats:
    """Return phase that the second harmonic adds from the begin of a half cycle, for known motion, (n, steps + 1)."""
    h = drive.step_s
    _, __, cosine = drive.shape()
    rate = np.multiply.outer(drive.amplitude_rad_s, cosine) + drive.rate_rad_s
    angle = 2.0 * psi_rad + drive.second_phase_rad
    bend, value = circle(angle)
    slope = 2.0 * rate * bend
    step = 0.5 * h * (value[:, 1:] + value[:, :-1]) + h * h / 12.0 * (slope[:, :-1] - slope[:, 1:])
    extra = np.zeros(psi_rad.shape)
    np.cumsum(step, axis=1, out=extra[:, 1:])
    extra *= -drive.kappa_rad_s * drive.second
    return extra
