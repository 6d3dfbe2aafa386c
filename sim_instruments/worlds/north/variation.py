"""Variations of a parameter, relative to its value, within +-20 %: functions of time, with integrals in closed form.

The integral is what a varying frequency needs: the phase is the integral of the frequency, never frequency times time.
Every class takes times of shape (n,); parameters of shape (runs, 1) give values of shape (runs, n).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from bench.model.arrays import Floats, Integers

SHARE = 0.2
SLOWEST_HZ, FASTEST_HZ = 0.02, 0.1  # of what is called slow


class Variation(Protocol):
    """Relative change of a parameter."""

    def at(self, t_s: Floats) -> Floats:
        """Return relative change at times in seconds."""

    def integral_s(self, t_s: Floats) -> Floats:
        """Return its integral from 0 to each time, seconds."""


class Constant:
    """No change at all."""

    def at(self, t_s: Floats) -> Floats:
        """Return zeros."""
        return np.zeros_like(t_s)

    def integral_s(self, t_s: Floats) -> Floats:
        """Return zeros."""
        return np.zeros_like(t_s)


@dataclass(frozen=True)
class Sine:
    """A sine of ``frequency_Hz`` whose phase at 0 is ``phase_rad``."""

    frequency_Hz: float | Floats
    phase_rad: float | Floats

    def at(self, t_s: Floats) -> Floats:
        """Return 0.2 sin(2 pi f t + phase)."""
        return SHARE * np.sin(2.0 * np.pi * self.frequency_Hz * t_s + self.phase_rad)

    def integral_s(self, t_s: Floats) -> Floats:
        """Return integral of the sine."""
        omega = 2.0 * np.pi * np.asarray(self.frequency_Hz)
        return SHARE / omega * (np.cos(self.phase_rad) - np.cos(omega * t_s + self.phase_rad))


@dataclass(frozen=True)
class Linear:
    """From -20 % to +20 % in ``ramp_s``, back again in as long, and so on."""

    ramp_s: float

    def at(self, t_s: Floats) -> Floats:
        """Return the triangle."""
        return SHARE * (1.0 - 2.0 * np.abs(1.0 - self._place(t_s)))

    def integral_s(self, t_s: Floats) -> Floats:
        """Return integral of the triangle; zero after each ramp."""
        place = self._place(t_s)
        way = np.where(place <= 1.0, place * (place - 1.0), (2.0 - place) * (place - 1.0))
        return SHARE * self.ramp_s * way

    def _place(self, t_s: Floats) -> Floats:
        """Return ramps since the last lowest point, 0 to 2."""
        return np.mod(np.asarray(t_s) / self.ramp_s, 2.0)


class Steps:
    """A new value each ``step_s``, from a table that repeats itself.

    Args: values: relative changes, (m,) or (runs, m).
    """

    def __init__(self, values: Floats, step_s: float) -> None:
        self._values, self._step_s = values, step_s
        self._sums = np.concatenate((np.zeros((*values.shape[:-1], 1)), np.cumsum(values, axis=-1)), axis=-1)

    def at(self, t_s: Floats) -> Floats:
        """Return the value of the step that each time is in."""
        return self._values[..., self._place(t_s)[1]]

    def integral_s(self, t_s: Floats) -> Floats:
        """Return sum of the steps so far."""
        rounds, step, part = self._place(t_s)
        inside = self._sums[..., step] + part * self._values[..., step]
        return self._step_s * (inside + rounds * self._sums[..., -1:])

    def _place(self, t_s: Floats) -> tuple[Integers, Integers, Floats]:
        """Return rounds of the table, step in it and part of the step."""
        place = np.asarray(t_s) / self._step_s
        step = np.floor(place).astype(np.int64)
        rounds, inside = np.divmod(step, self._values.shape[-1])
        return rounds, inside, place - step


def drawn_steps(rng: np.random.Generator, shape: tuple[int, ...], step_s: float) -> Steps:
    """Return steps whose values are uniform within +-20 %."""
    return Steps(rng.uniform(-SHARE, SHARE, shape), step_s)


def drawn_slow(rng: np.random.Generator, shape: tuple[int, ...] = ()) -> Sine:
    """Return a sine of 0.02 to 0.1 Hz with a drawn phase; ``shape`` for several at once."""
    frequency_Hz, phase_rad = rng.uniform(SLOWEST_HZ, FASTEST_HZ, shape), rng.uniform(0.0, 2.0 * np.pi, shape)
    return Sine(frequency_Hz, phase_rad)
