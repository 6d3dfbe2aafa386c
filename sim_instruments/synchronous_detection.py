"""Signal processing of the simulated lock-in amplifier, on samples of 1 ms: phase-locked loop, mixer, low-pass filters.

Sample n is the mean of the signal over [n, n + 1) ms of the bench clock. Everything is causal and goes on from where it
was: the reference's phase between two pulses is what the loop expects from the two before. Phases in turns. With V sin
(a + b) at the input and a the phase of the reference, X settles at V / sqrt 2 cos(b - phase), Y at its sine.

Source: SR830 manual, chapter 3 (mixer, one to four equal RC poles, synchronous filter as the mean over one period,
below 200 Hz) and specifications (acquisition in two periods). Placeholders: tolerance of the loop, overload levels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from bench.model.arrays import Flags, Floats, Integers

Samples = Floats
SAMPLE_NS = 1_000_000
TOLERANCE = 0.01  # of one period against the one before
LATE = 1.5  # periods without a pulse end the lock
SYNCHRONOUS_BELOW_HZ = 200.0
LONGEST_AVERAGE = 20_000  # samples the synchronous filter can hold
CHUNK = 100_000
FULL_SCALE = 1.09  # of the outputs, times the sensitivity
STEPS = 30_000  # of an output of 16 bit, from zero to the sensitivity
POLES = 4
INPUT_OVERLOAD, OUTPUT_OVERLOAD, UNLOCKED = 1, 4, 8  # bit 1, the filters, is never set here


@dataclass(frozen=True)
class Settings:
    """Settings of the amplifier; volts are those at its own input."""

    time_constant_s: float = 0.1
    poles: int = 2
    synchronous: bool = False
    phase_deg: float = 0.0
    harmonic: int = 1
    sensitivity_V: float = 1.0
    input_limit_V: float = 2**0.5
    square: bool = False  # the mixer multiplies by a square wave that gives the same for a pure sine


class ReferenceLoop:
    """Phase-locked loop on the pulses of a reference, in nanoseconds of the bench clock."""

    def __init__(self) -> None:
        self._starts = [np.iinfo(np.int64).min]  # from when on each row holds
        self._rows: list[tuple[int, float, bool]] = [(0, np.nan, False)]  # its pulse, the period, whether locked
        self._begun = False

    @property
    def frequency_Hz(self) -> float:
        """Frequency of the reference, hertz; 0 before there is one."""
        period_ns = self._rows[-1][1]
        return 0.0 if np.isnan(period_ns) else 1e9 / period_ns

    def take(self, pulses_ns: Integers) -> None:
        """Go on with further pulses, in order."""
        for pulse_ns in pulses_ns.tolist():
            last_ns, period_ns, _ = self._rows[-1]
            interval_ns = float(pulse_ns - last_ns)
            if self._begun and interval_ns <= 0:
                continue
            lost = not self._begun or interval_ns > LATE * period_ns
            locked = not lost and abs(interval_ns - period_ns) <= TOLERANCE * period_ns
            self._begun = True
            self._starts.append(pulse_ns)
            self._rows.append((pulse_ns, np.nan if lost else interval_ns, locked))

    def follow(self, t_ns: Integers) -> tuple[Samples, Samples, Flags]:
        """At times in order: phase in turns since the last pulse (NaN before two), period (ns), whether locked."""
        place = np.searchsorted(np.array(self._starts), t_ns, side="right") - 1
        pulse_ns, period_ns, locked = (np.array(column)[place] for column in zip(*self._rows, strict=True))
        turns = (t_ns - pulse_ns) / period_ns
        return turns, period_ns, locked & (turns <= LATE)

    def forget_before(self, t_ns: int) -> None:
        """Drop what nobody asks for any more."""
        while len(self._starts) > 1 and self._starts[1] <= t_ns:
            del self._starts[0], self._rows[0]


class LockIn:
    """The amplifier: ``run_to`` processes what came in; then ``outputs`` and ``status`` are those of that time.

    Args: signal: volt of samples [first, last).   pulses: ns of the reference's rising edges in [t0, t1).
    first: sample at which it is switched on.
    """

    def __init__(
        self,
        signal: Callable[[int, int], Samples],
        pulses: Callable[[int, int], Integers],
        first: int = 0,
    ) -> None:
        self.settings = Settings()
        self.status = 0  # latched bits, until somebody clears them
        self._signal, self._pulses = signal, pulses
        self._done = first
        self._loop = ReferenceLoop()
        self._last = np.zeros((POLES, 2))  # the last value behind each pole, X and Y
        self._integral = np.zeros((2, 1))  # of the products, at the beginning of the last samples

    @property
    def frequency_Hz(self) -> float:
        """Frequency the loop is at, hertz."""
        return self._loop.frequency_Hz

    @property
    def outputs_V(self) -> tuple[float, float]:
        """X and Y as they are told: in steps, not beyond full scale."""
        sensitivity_V = self.settings.sensitivity_V
        told = np.clip(self._last[self.settings.poles - 1] / sensitivity_V, -FULL_SCALE, FULL_SCALE)
        x_V, y_V = np.round(told * STEPS) / STEPS * sensitivity_V
        return float(x_V), float(y_V)

    def change(self, **settings: float | bool) -> None:
        """Change settings from the sample on that ``run_to`` has come to."""
        self.settings = replace(self.settings, **settings)  # type: ignore[arg-type]

    def run_to(self, last: int) -> None:
        """Process all samples before ``last``."""
        while self._done < last:
            end = min(last, self._done + CHUNK)
            self._process(self._done, end)
            self._done = end

    def _process(self, first: int, last: int) -> Samples:
        """Process samples [first, last): X and Y behind the filters of each, (2, n)."""
        self._loop.take(self._pulses(first * SAMPLE_NS, last * SAMPLE_NS))
        middle_ns = np.arange(first, last, dtype=np.int64) * SAMPLE_NS + SAMPLE_NS // 2
        turns, period_ns, locked = self._loop.follow(middle_ns)
        limit_V = self.settings.input_limit_V
        volts = self._signal(first, last)
        held_V = np.clip(volts, -limit_V, limit_V)
        products = self._mixed(held_V, turns, SAMPLE_NS / period_ns)
        smoothed = self._filtered(self._averaged(products, period_ns / SAMPLE_NS, locked))
        bits = ((volts != held_V).any(), INPUT_OVERLOAD), (not locked.all(), UNLOCKED)
        beyond = np.abs(smoothed).max() > FULL_SCALE * self.settings.sensitivity_V
        self.status |= sum(bit for on, bit in (*bits, (beyond, OUTPUT_OVERLOAD)) if on)
        self._loop.forget_before(int(middle_ns[-1]))
        return smoothed

    def _mixed(self, volts: Samples, turns: Samples, step_turns: Samples) -> Samples:
        """Return products with the reference and with the one a quarter ahead, (2, n); zero while there is none."""
        harmonic = self.settings.harmonic
        phases = harmonic * turns + self.settings.phase_deg / 360.0 + np.array([[0.0], [0.25]])
        if self.settings.square:
            reference = _mean_square_wave(phases, harmonic * step_turns) * (np.pi / (2.0 * np.sqrt(2.0)))
        else:
            reference = np.sqrt(2.0) * np.sin(2.0 * np.pi * phases)
        products: Samples = volts * np.where(np.isnan(reference), 0.0, reference)
        return products

    def _averaged(self, products: Samples, period: Samples, locked: Flags) -> Samples:
        """Return mean over the period (in samples) that ends with each sample, where the synchronous filter works."""
        held = self._integral.shape[1] - 1  # samples before the first of these
        integral = np.concatenate((self._integral, self._integral[:, -1:] + np.cumsum(products, axis=1)), axis=1)
        ends = np.arange(held + 1, integral.shape[1], dtype=np.float64)
        keep = min(integral.shape[1], LONGEST_AVERAGE + 1)
        self._integral = integral[:, -keep:] - integral[:, -1:]
        if not self.settings.synchronous:
            return products
        begins = ends - np.where(locked, period, np.nan)
        fits = (begins >= 0.0) & (period > 1000.0 / SYNCHRONOUS_BELOW_HZ)
        places = np.arange(integral.shape[1], dtype=np.float64)
        begun = np.stack([np.interp(np.where(fits, begins, 0.0), places, row) for row in integral])
        means = (integral[:, held + 1 :] - begun) / np.where(fits, period, 1.0)
        return np.where(fits, means, products)

    def _filtered(self, values: Samples) -> Samples:
        """Return values behind the RC poles that are set, (2, n); unused poles follow the last one that is."""
        keep = np.exp(-SAMPLE_NS / 1e9 / self.settings.time_constant_s)
        for pole in range(self.settings.poles):
            state = keep * self._last[pole][:, np.newaxis]
            values, _ = lfilter([1.0 - keep], [1.0, -keep], values, axis=1, zi=state)
            self._last[pole] = values[:, -1]
        self._last[self.settings.poles :] = values[:, -1]
        return values


def _mean_square_wave(turns: Samples, step_turns: Samples) -> Samples:
    """Return mean of the sign of a sine over a sample in whose middle its phase is ``turns``, all in turns."""
    triangle = 0.5 - np.abs((turns[..., np.newaxis] + np.array([-0.5, 0.5]) * step_turns[..., np.newaxis]) % 1.0 - 0.5)
    whole: Samples = (triangle[..., 1] - triangle[..., 0]) / step_turns
    return whole
