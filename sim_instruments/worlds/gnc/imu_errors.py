"""Truth of the sensors of one simulated module: errors drawn once from (seed, serial number), and the periods in
which it had power, which warm it and give it a bias of their own. Every number and its reason stands in
docs/method-gnc.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from bench.model.arrays import Floats, Integers
from bench.model.clock import NS
from sim_instruments.seeds import generator
from sim_instruments.worlds.common.attitude import Tilt

REFERENCE_DEGC = 25.0
WARM_UP_DEGC = 6.0
WARM_UP_LAG_S = 80.0
MEAN_INTERVAL_S = 10.0  # of the paper's stability figure
SCALE, CROSS = 0.01, 0.003  # standard deviations of scale errors and cross terms
SLOW_GYRO_DEG_S = 2.0 / 3600.0
SLOW_GYRO_S = 300.0
SLOW_ACCEL_G = 6e-6  # each of three, a decade apart
SLOW_ACCEL_S = (10.0, 100.0, 1000.0)
ARW_DEG_RT_H = 0.3
VRW_G_RTS = 0.1e-3
MAGNETIC_NOISE_GAUSS = 0.5e-3
THERMOMETER_NOISE_DEGC = 0.02
_LARGEST_DRAW = 2.5  # standard deviations


@dataclass(frozen=True)
class ImuOptions:
    """Choices for the sensors of a simulated module.

    Attributes:
        errors: off makes ideal sensors (their noise stays).
        noise: off leaves out white and slow noise and the bias that a power-on brings.
        tilt_arcmin: standard deviation of the body's tilt against the inner axis, about each axis and at each pose.
    """

    errors: bool = True
    noise: bool = True
    tilt_arcmin: float = 0.0


@dataclass(frozen=True)
class Triad:
    """One triad of sensors, N = S (w + b) at ``REFERENCE_DEGC``: indicated from true, in the unit of the triad.

    Attributes:
        sensitivity: S, (3, 3), indicated per true; row = sensor, column = body axis.
        bias: b, (3,).   scale_per_degC: relative change of each sensor's row.   bias_per_degC: change of b.
        turn_on: standard deviation of what a power-on adds to b, (3,).   white: N of each sensor, unit times sqrt(s).
    """

    sensitivity: Floats
    bias: Floats
    scale_per_degC: Floats
    bias_per_degC: Floats
    turn_on: Floats
    white: Floats

    def sensitivity_at(self, degC: Floats) -> Floats:
        """Return S at temperatures (n,), (n, 3, 3)."""
        return self.row_factor(degC)[:, :, None] * self.sensitivity

    def row_factor(self, degC: Floats) -> Floats:
        """Return what temperature multiplies each sensor's row with, (n, 3)."""
        return 1.0 + (degC - REFERENCE_DEGC)[:, None] * self.scale_per_degC

    def bias_at(self, degC: Floats) -> Floats:
        """Return b at temperatures (n,) without noise, (n, 3)."""
        return self.bias + (degC - REFERENCE_DEGC)[:, None] * self.bias_per_degC


class ImuErrors:
    """Gyroscopes (deg/s), accelerometers (standard g), thermometer and tilt of one module.

    Args: seed of the run, serial number of the module, options.
    """

    def __init__(self, seed: int, serial: str, options: ImuOptions) -> None:
        self.options = options
        rng = generator(seed, f"gnc imu errors {serial}")
        s_deg_s = 1.0 / 3600.0
        gyro = _errors(rng, 0.1, 30e-6, 3.0 * s_deg_s)
        accel = _errors(rng, 10e-3, 20e-6, 0.03e-3)
        self.gyro = _chosen(options, gyro, rng.uniform(1.2, 4.8, 3) * s_deg_s, ARW_DEG_RT_H / 60.0)
        self.accel = _chosen(options, accel, rng.uniform(0.015, 0.070, 3) * 1e-3, VRW_G_RTS)
        self.thermometer_degC = rng.normal(0.0, 0.5) * options.errors
        self._seed, self._serial = seed, serial

    def tilt(self, mounting: str) -> Tilt | None:
        """Return tilt of the body in one mounting, None if there is none."""
        if self.options.tilt_arcmin <= 0.0:
            return None
        rng = generator(self._seed, f"gnc tilt {self._serial} {mounting}")
        sigma_rad = np.deg2rad(self.options.tilt_arcmin / 60.0) / np.sqrt(3.0)
        turns = rng.standard_normal((5, 3)) * sigma_rad
        return Tilt(turns[0], turns[1:3], turns[3:5])


def drawn(rng: np.random.Generator, sigma: ArrayLike, shape: int | tuple[int, ...]) -> Floats:
    """Return normal numbers that stay within 2.5 standard deviations."""
    return np.asarray(np.clip(rng.standard_normal(shape), -_LARGEST_DRAW, _LARGEST_DRAW) * sigma)


def signed(rng: np.random.Generator, size: float, shape: int) -> Floats:
    """Return numbers of half to one and a half times ``size``, of either sign."""
    return np.asarray(rng.choice((-1.0, 1.0), shape) * size * rng.uniform(0.5, 1.5, shape))


def _errors(rng: np.random.Generator, bias: float, scale_degC: float, bias_degC: float) -> tuple[Floats, ...]:
    """Return matrix of the errors, bias and the changes of both with temperature."""
    wrong = drawn(rng, CROSS, (3, 3))
    np.fill_diagonal(wrong, 1.0 + drawn(rng, SCALE, 3))
    return wrong - np.eye(3), drawn(rng, bias, 3), signed(rng, scale_degC, 3), signed(rng, bias_degC, 3)


def _chosen(options: ImuOptions, errors: tuple[Floats, ...], turn_on: Floats, white: float) -> Triad:
    """Return the triad with what the options leave of it."""
    matrix, *others = (float(options.errors) * error for error in errors)
    noisy = float(options.noise)
    return Triad(np.eye(3) + matrix, *others, noisy * turn_on, noisy * np.full(3, white))


@dataclass(frozen=True)
class _Stretch:
    """From ``start_ns`` on the self-heating goes from ``start_degC`` to ``target_degC``; ``period`` counts from 0."""

    start_ns: int
    start_degC: float
    target_degC: float
    period: int


class PowerPeriods:
    """Times of power-on and power-off, given in order of time; before the first one the module is cold."""

    def __init__(self) -> None:
        self._stretches = [_Stretch(0, 0.0, 0.0, 0)]

    def on(self, t_ns: int) -> None:
        """Power comes on; each time but the first begins a new period."""
        self._begin(t_ns, WARM_UP_DEGC)

    def off(self, t_ns: int) -> None:
        """Power goes off: the module cools with the lag it warmed with."""
        self._begin(t_ns, 0.0)

    @property
    def first_ns(self) -> int:
        """Bench time of the first power-on, 0 before it."""
        return next((s.start_ns for s in self._stretches if s.target_degC > 0.0), 0)

    def rise_degC(self, t_ns: Integers) -> Floats:
        """Return self-heating above the surroundings at bench times (n,), degC."""
        starts = np.array([s.start_ns for s in self._stretches], np.int64)
        states = np.array([(s.start_degC, s.target_degC) for s in self._stretches])
        at = self._at(t_ns)
        first, last = states[at].T
        since_s = np.maximum(t_ns - starts[at], 0) / NS
        return np.asarray(last + (first - last) * np.exp(-since_s / WARM_UP_LAG_S))

    def period(self, t_ns: Integers) -> Integers:
        """Return number of the power-on period at bench times (n,), from 0."""
        return np.array([s.period for s in self._stretches], np.int64)[self._at(t_ns)]

    def _at(self, t_ns: Integers) -> Integers:
        starts = [s.start_ns for s in self._stretches]
        return np.maximum(np.searchsorted(starts, t_ns, side="right") - 1, 0)

    def _begin(self, t_ns: int, target_degC: float) -> None:
        last = self._stretches[-1]
        if target_degC == last.target_degC:
            return
        started = any(s.target_degC > 0.0 for s in self._stretches)
        period = last.period + 1 if started and target_degC > 0.0 else last.period
        rise_degC = float(self.rise_degC(np.array([t_ns]))[0])
        self._stretches.append(_Stretch(t_ns, rise_degC, target_degC, period))
