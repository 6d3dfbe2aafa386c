"""Blocks of 1,000 gates: within one, the temperature-dependent parameters of the unit stay what they are.

They are those of the middle of the block, extrapolated from what is true at its start (temperature, rate, turning
points), because what the chamber is told during a block must not change what the unit has already done.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.model.arrays import Floats, Integers
from bench.model.clock import NS
from sim_instruments.seeds import generator
from sim_instruments.worlds.af_converter.constants import AF_CLOCK_HZ, CHANNELS, GATE_S, KINDS, WHITE_A_RTHZ
from sim_instruments.worlds.af_converter.unit_constants import NguTruth
from sim_instruments.worlds.common.thermal import ThermalOfUnit

BLOCK_GATES = 1000
CHARGE_BITS = 40  # charge unit = design pulse charge / 2^40: 10 s at full scale fit 64 bits, rounding is below 1 pA

_UNIFORM_SUM = 4 * 0xFFFF  # largest sum of four 16-bit numbers
_UNIFORM_SIGMA = np.sqrt(4 * ((1 << 32) - 1) / 12)
_K0_C = np.array([kind.k0_C for kind in KINDS])
_GATES, _NUMBERS = np.arange(1, BLOCK_GATES + 1), np.arange(1, CHANNELS + 1)
_HALF_BLOCK_S = 0.5 * BLOCK_GATES * GATE_S


@dataclass(frozen=True)
class Quanta:
    """Converters at one temperature in charge units: pulse charges (C,), and the units per ampere and clock (C,)."""

    q_n: Integers
    q_p: Integers
    units_A: Floats

    def charge(self, current_A: Floats, margin: Integers | int = 0) -> Integers:
        """Return charge of one clock period, units; an input beyond the reset current is all it can follow."""
        limit = np.minimum(self.q_n, self.q_p) - margin
        wanted = np.rint(current_A * self.units_A)
        return np.minimum(np.maximum(wanted, -limit), limit).astype(np.int64)


def quanta(truth: NguTruth, unit_degC: Floats) -> list[Quanta]:
    """Return pulse charges at each temperature; the AF clock sets the length of a reset, so its error is in them."""
    clock = 1.0 + truth.af_clock_error_ppm * 1e-6
    nominal = float(1 << CHARGE_BITS) / clock
    q_n, q_p = np.rint(nominal * (1.0 + 1e-6 * truth.dsf_ppm(_NUMBERS, unit_degC[:, None]))).astype(np.int64)
    units_A = float(1 << CHARGE_BITS) / (_K0_C * AF_CLOCK_HZ * clock)
    return [Quanta(n, p, units_A) for n, p in zip(q_n, q_p, strict=True)]


@dataclass(frozen=True)
class GateBlock:
    """Gates ``first`` to ``first + 999`` of one power-on period.

    Attributes:
        ends_s: end of each gate, (1000,), seconds of bench time from the first gate; ``ends_ns`` the same as bench
            time. ``edges``: AF clock edges up to the start and to each end, (1001,).
        noise: white noise charge per clock, (C, 1000) int32, charge units; ``noise_peak`` its largest size, (C,).
        bias_A: i_AFbias, (C,).
    """

    first: int
    ends_s: Floats
    ends_ns: Integers
    edges: Integers
    quanta: Quanta
    bias_A: Floats
    noise: NDArray[np.int32]
    noise_peak: Integers


class BlockFactory:
    """Makes the blocks of one power-on period; a block depends on the seed, its number and the state at its start."""

    def __init__(self, truth: NguTruth, thermal: ThermalOfUnit, epoch_ns: int, period: int) -> None:
        self._truth = truth
        self._thermal = thermal
        self.epoch_ns = epoch_ns
        self._period = period
        self._clock_Hz = AF_CLOCK_HZ * (1.0 + truth.af_clock_error_ppm * 1e-6)

    @property
    def af_clock_Hz(self) -> float:
        """True frequency of the AF clock."""
        return self._clock_Hz

    def make(self, number: int, start_s: float, stop_ns: int) -> list[GateBlock]:
        """Block ``number`` (from 0), whose first gate starts ``start_s`` after the epoch, and those behind it.

        As many as begin at or before ``stop_ns``: until then nobody tells the chamber anything new.
        """
        start_s_of, gate_s_of, middle_degC, turns_degC = self._starts(start_s, stop_ns)
        degC = np.array(middle_degC)
        starts_s = np.array(start_s_of)
        starts_ns = [self.epoch_ns + round(each_s * NS) for each_s in start_s_of]
        bias_A = self._truth.bias_A(
            _NUMBERS,
            degC[:, None],
            (np.array(starts_ns) / NS + _HALF_BLOCK_S)[:, None],
            self._truth.play_offset_degC(turns_degC, degC),
        )
        ends_s = starts_s[:, None] + _GATES * np.array(gate_s_of)[:, None]
        ends_ns = self.epoch_ns + np.rint(ends_s * NS).astype(np.int64)
        edges = np.floor(np.concatenate((starts_s[:, None], ends_s), axis=1) * self._clock_Hz).astype(np.int64)
        blocks = []
        for at, converters in enumerate(quanta(self._truth, degC)):
            noise, peak = self._noise(number + at, converters.units_A)
            blocks.append(
                GateBlock(
                    first=(number + at) * BLOCK_GATES,
                    ends_s=ends_s[at],
                    ends_ns=ends_ns[at],
                    edges=edges[at],
                    quanta=converters,
                    bias_A=bias_A[at],
                    noise=noise,
                    noise_peak=peak,
                )
            )
        return blocks

    def _starts(
        self, start_s: float, stop_ns: int
    ) -> tuple[list[float], list[float], list[float], list[tuple[float, ...]]]:
        """Return of each block its start and the length of a gate, s, the temperature in its middle, and the turns.

        A block ends where the next one starts, and how long its gates are is a matter of its temperature.
        """
        starts_s: list[float] = []
        gates_s: list[float] = []
        middles_degC: list[float] = []
        turns_degC: list[tuple[float, ...]] = []
        while not starts_s or self.epoch_ns + round(start_s * NS) <= stop_ns:
            start_ns = self.epoch_ns + round(start_s * NS)
            now_degC, rate_degC_s = self._thermal.unit_moment(start_ns)
            unit_degC = now_degC + _HALF_BLOCK_S * rate_degC_s
            gate_s = GATE_S / (1.0 + 1e-6 * float(self._truth.master_error_ppm(unit_degC)))
            starts_s.append(start_s)
            gates_s.append(gate_s)
            middles_degC.append(unit_degC)
            turns_degC.append(self._thermal.turns_degC(start_ns))
            start_s += BLOCK_GATES * gate_s
        return starts_s, gates_s, middles_degC, turns_degC

    def _noise(self, number: int, units_A: Floats) -> tuple[NDArray[np.int32], Integers]:
        """Return noise charges and a bound of their size; each is the sum of four uniform numbers, so it has one."""
        if not self._truth.noise:
            return np.zeros((CHANNELS, BLOCK_GATES), np.int32), np.zeros(CHANNELS, np.int64)
        raw = generator(self._truth.seed, "ngu white noise", self._period, number).bit_generator.random_raw(
            CHANNELS * BLOCK_GATES
        )
        pairs = raw.view(np.uint32)
        halves = pairs >> 16
        pairs &= 0xFFFF
        halves += pairs
        total = (halves[0::2] + halves[1::2]).reshape(CHANNELS, BLOCK_GATES)
        drawn = total.astype(np.float32)
        drawn -= np.float32(_UNIFORM_SUM / 2)
        scale = WHITE_A_RTHZ / np.sqrt(2.0 * GATE_S) * units_A / _UNIFORM_SIGMA
        drawn *= scale.astype(np.float32)[:, None]
        return drawn.astype(np.int32), np.ceil(scale * (_UNIFORM_SUM / 2 + 1)).astype(np.int64)
