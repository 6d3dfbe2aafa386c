"""True constants of one simulated unit: drawn once from the seed, known to the simulator and to its truth list only.

The random walk of the biases may be asked for any time of a campaign; only the stretch asked last is kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from bench.model.arrays import Floats, Integers
from bench.model.errors import InputError
from sim_instruments.seeds import generator
from sim_instruments.worlds.af_converter.constants import CHANNELS, KINDS, REFERENCE_DEGC, WALK_A_RTH
from sim_instruments.worlds.common.thermal import follow, play_after

_STEP_S = 10.0
_BLOCK = 4096
_STEP_A = WALK_A_RTH * np.sqrt(_STEP_S / 3600.0)


class BiasWalk:
    """Walks of all channels, drawn on a 10 s grid of bench time and joined by straight lines.

    A block of 4,096 steps depends on the seed, its number and the value the block before ended with. Those values are
    kept, so an earlier time costs one block and the memory does not grow with the campaign.
    """

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._starts_A: list[Floats] = [np.zeros(CHANNELS)]  # value before the first step of each block
        self._newest: tuple[int, Floats] = (-1, np.empty(0))

    def at(self, index: Integers, t_s: Floats | float) -> Floats:
        """Return walk of the channels ``index`` (from 0) at bench time ``t_s``, ampere; the arguments broadcast."""
        place = np.maximum(t_s, 0.0) / _STEP_S
        cell = np.asarray(place).astype(np.int64)
        first, last = int(cell.min()) // _BLOCK, int(cell.max()) // _BLOCK
        if first == last:
            return self._joined(first, index, place, cell)
        index, place, cell = np.broadcast_arrays(index, place, cell)
        walk_A = np.empty(cell.shape)
        for block in range(first, last + 1):
            inside = cell // _BLOCK == block
            if inside.any():
                walk_A[inside] = self._joined(block, index[inside], place[inside], cell[inside])
        return walk_A

    def _joined(self, block: int, index: Integers, place: Floats, cell: Integers) -> Floats:
        grid_A = self._grid_A(block)
        row = cell - block * _BLOCK
        low_A, high_A = grid_A[row, index], grid_A[row + 1, index]
        return np.asarray(low_A + (place - cell) * (high_A - low_A))

    def _grid_A(self, block: int) -> Floats:
        """Return values at the steps of a block and at the first of the next one, (4097, 10)."""
        while len(self._starts_A) <= block:
            self._starts_A.append(self._grid_A(len(self._starts_A) - 1)[_BLOCK - 1].copy())
        if self._newest[0] != block:
            grid_A = np.empty((_BLOCK + 1, CHANNELS))
            grid_A[:_BLOCK] = np.cumsum(self._steps_A(block, _BLOCK), axis=0) + self._starts_A[block]
            grid_A[_BLOCK] = grid_A[_BLOCK - 1] + self._steps_A(block + 1, 1)[0]
            self._newest = (block, grid_A)
        return self._newest[1]

    def _steps_A(self, block: int, count: int) -> Floats:
        """Return the first ``count`` steps of a block, (count, 10)."""
        return generator(self._seed, "ngu bias walk", block).standard_normal((count, CHANNELS)) * _STEP_A


class NguTruth:
    """Parameters of one unit as functions of its temperature (degC); channels are numbered from 1.

    ``dsf_n`` and ``dsf_p`` are the scale-factor errors of the N and P pulses (positive = more current per pulse).
    ``bias`` is i_AFbias of the paper's equation (1): the correction added to the reading, so the counts reflect the
    input current minus it and the open-input reading is its negative. It is a cubic of the unit temperature T, a
    random walk, and h (P - T) with P the play operator of the temperatures the unit has been through: P - T is
    ``half_width_degC`` on the falling branch, its negative on the rising one, so the loop is 2 h r wide.

    Args:
        seed: seed of the run.
        options: ``master_error_ppm`` and ``af_clock_error_ppm`` replace the drawn clock errors at 20 degC;
            ``noise`` is "on" or "off" (white noise, bias random walk and sensor noise); ``hysteresis`` is "on" or
            "off"; ``unit_seed`` is the seed of the constants, ``seed`` that of noise and walks alone then;
            ``check_standard``, as "7:12": a channel, and the seed of the unit whose constants it has. Others are not
            looked at.
    Raises:
        InputError: B-NGU-001, an option cannot be read.
    """

    def __init__(self, seed: int, options: Mapping[str, str] | None = None) -> None:
        options = options or {}
        self.seed = seed
        self.kinds = tuple(kind.name for kind in KINDS)
        self.noise = _switch(options, "noise")
        self.hysteresis = _switch(options, "hysteresis")
        own = options.get("unit_seed", str(seed))
        if not own.isdecimal():
            raise _unreadable("unit_seed", own, "the seed of a unit, 0 or positive", "12")
        constants = int(own)
        rng = generator(constants, "ngu truth")
        self._dsf_ppm = rng.normal(0.0, 400.0, (2, CHANNELS))
        self._dsf_tc1 = _signed(rng, (2, CHANNELS), 8.0, 0.15)
        self._dsf_tc2 = _signed(rng, (2, CHANNELS), 0.03, 0.3)
        self._bias_A = self._draw_bias(rng, constants)
        tilt, cubic = rng.uniform(-0.02, 0.02), rng.uniform(3e-5, 6e-5)
        self._master = (_number(options, "master_error_ppm", 1.5 + rng.normal(0.0, 0.2)), tilt, 0.0, cubic)
        self.af_clock_error_ppm = _number(options, "af_clock_error_ppm", 20.0 + rng.normal(0.0, 1.0))
        self.half_width_degC, self.hysteresis_A = self._draw_hysteresis(constants)
        if "check_standard" in options:
            self._take_channel(options["check_standard"])
        self._stiffness_A_degC = self.hysteresis_A / (2.0 * self.half_width_degC)  # h of h (P - T)
        self._walk = BiasWalk(seed)
        self._play: tuple[Sequence[float], Floats] = ((), np.empty(0))

    def dsf_ppm(self, channel: ArrayLike, unit_degC: ArrayLike) -> Floats:
        """Return scale-factor errors of the N and of the P pulses, (2, ...), ppm; the arguments broadcast."""
        index, rise = np.asarray(channel) - 1, np.asarray(unit_degC, float) - REFERENCE_DEGC
        sides = zip(self._dsf_ppm, self._dsf_tc1, self._dsf_tc2, strict=True)
        return np.array([at[index] + rise * (tc1[index] + rise * tc2[index]) for at, tc1, tc2 in sides])

    def tc_ppm(self, channel: int, polarity: str) -> tuple[float, float]:
        """Return linear (ppm/degC) and quadratic (ppm/degC^2) coefficient about 20 degC of the N ("n") or P pulses."""
        row = "np".index(polarity)
        return float(self._dsf_tc1[row, channel - 1]), float(self._dsf_tc2[row, channel - 1])

    def bias_A(
        self, channel: ArrayLike, unit_degC: ArrayLike, t_s: ArrayLike, play_offset_degC: ArrayLike = 0.0
    ) -> Floats:
        """Return i_AFbias, ampere, with the random walk at bench time ``t_s`` (seconds); the arguments broadcast.

        ``play_offset_degC`` is P - T (``play_offset_degC`` gives it); 0 is the centre of the loop.
        """
        index = np.asarray(channel) - 1
        curve_A = _polynomial(self._bias_A[:, index], np.asarray(unit_degC, float) - REFERENCE_DEGC)
        offset_A = self._stiffness_A_degC[index] * np.asarray(play_offset_degC, float)
        return curve_A + offset_A + self._walk_A(index, np.asarray(t_s, float))

    def bias_tc_A(self, channel: int, order: int) -> float:
        """Return coefficient of (T - 20 degC)^order of the centre curve of i_AFbias, ampere per degC^order."""
        return float(self._bias_A[order, channel - 1])

    def play_offset_degC(self, turns_degC: Sequence[Sequence[float]], unit_degC: Floats) -> Floats:
        """Return P - T of channels, (n, 10), for a unit at ``unit_degC`` (n,) that had turned at these, each time.

        Nothing is known of the past without turns: then it is 0, the centre of the loop.
        """
        state = np.empty((len(unit_degC), CHANNELS))
        for row, (turns, degC) in enumerate(zip(turns_degC, unit_degC, strict=True)):
            if turns and turns != self._play[0]:
                self._play = turns, play_after(turns, self.half_width_degC)
            state[row] = self._play[1] if turns else degC
        return follow(state, unit_degC[:, None], self.half_width_degC) - unit_degC[:, None]

    def master_error_ppm(self, unit_degC: ArrayLike) -> Floats:
        """Return frequency error of the master oscillator, ppm; it sets the gate: t_gate = 10 ms / (1 + error)."""
        return _polynomial(self._master, np.asarray(unit_degC, float) - REFERENCE_DEGC)

    def master_tc_ppm(self, order: int) -> float:
        """Return coefficient of (T - 20 degC)^order of the master oscillator's error, ppm per degC^order."""
        return float(self._master[order])

    def _take_channel(self, text: str) -> None:
        """Take the constants of a channel from another unit."""
        channel, _, seed = text.partition(":")
        number = int(channel) if channel.isdecimal() else 0
        if not 1 <= number <= CHANNELS or not seed.isdecimal():
            raise _unreadable("check_standard", text, f"a channel from 1 to {CHANNELS} and a seed", "7:12")
        other = NguTruth(int(seed), {"hysteresis": "on" if self.hysteresis else "off"})
        for name in ("_dsf_ppm", "_dsf_tc1", "_dsf_tc2", "_bias_A", "half_width_degC", "hysteresis_A"):
            getattr(self, name)[..., number - 1] = getattr(other, name)[..., number - 1]

    def _draw_bias(self, rng: np.random.Generator, seed: int) -> Floats:
        """Return coefficients of the centre curve, (4, 10), ampere per degC^order."""
        spread = np.clip(rng.standard_normal(CHANNELS), -2.5, 2.5)
        offset = np.array([k.bias_A for k in KINDS]) + spread * [k.bias_spread_A for k in KINDS]
        slope = _signed(rng, (CHANNELS,), 1.0, 0.1) * [k.bias_tc1_A for k in KINDS]
        curved = generator(seed, "ngu bias curve")
        square = _signed(curved, (CHANNELS,), 1.0, 0.5) * [k.bias_tc2_A for k in KINDS]
        cube = _signed(curved, (CHANNELS,), 1.0, 0.5) * [k.bias_tc3_A for k in KINDS]
        return np.array([offset, slope, square, cube])

    def _draw_hysteresis(self, seed: int) -> tuple[Floats, Floats]:
        """Return half-widths of the plays, (10,), degC, and widths of the loops (falling - rising), (10,), ampere."""
        rng = generator(seed, "ngu hysteresis")
        half_width = rng.uniform(0.8, 1.2, CHANNELS) * [k.half_width_degC for k in KINDS]
        width = _signed(rng, (CHANNELS,), 1.0, 0.2) * [k.hysteresis_A for k in KINDS]
        return half_width, width * float(self.hysteresis)

    def _walk_A(self, index: Integers, t_s: Floats | float) -> Floats:
        """Return bias random walk, ampere."""
        return self._walk.at(index, t_s) if self.noise else np.zeros(np.broadcast(index, t_s).shape)


def _polynomial(coefficients: Sequence[float] | Floats, rise_degC: Floats) -> Floats:
    """Return c0 + c1 x + c2 x^2 + c3 x^3 by Horner's rule; the coefficients broadcast with x."""
    c0, c1, c2, c3 = coefficients
    return np.asarray(c0 + rise_degC * (c1 + rise_degC * (c2 + rise_degC * c3)))


def _signed(rng: np.random.Generator, shape: tuple[int, ...], size: float, spread: float) -> Floats:
    """Return values of about ``size`` with either sign."""
    return rng.choice((-1.0, 1.0), shape) * size * rng.uniform(1 - spread, 1 + spread, shape)


def _switch(options: Mapping[str, str], name: str) -> bool:
    text = options.get(name, "on")
    if text not in ("on", "off"):
        raise _unreadable(name, text, "'on' or 'off'", "off")
    return text == "on"


def _unreadable(name: str, text: str, due: str, example: str) -> InputError:
    return InputError(
        "B-NGU-001",
        f"option {name} is {text!r}; it is {due}",
        where=f"option {name}",
        next_step=f"write for example --set {name}={example}",
    )


def _number(options: Mapping[str, str], name: str, drawn: float) -> float:
    if name not in options:
        return drawn
    try:
        value = float(options[name])
    except ValueError:
        value = float("nan")
    if not -1000.0 <= value <= 1000.0:
        raise _unreadable(name, options[name], "a number of ppm from -1000 to 1000", "50")
    return value
