"""Counts of whole records without frames: the same converters and clocks, one step per record instead of 10,000.

For tests of fits over many campaigns. White noise enters as its mean over the record, which is exact as long as the
input current (bias included) does not change its sign within a gate of 10 ms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim_instruments.seeds import generator
from sim_instruments.worlds.af_converter.block import quanta
from sim_instruments.worlds.af_converter.charge_balance import ChargeBalance
from sim_instruments.worlds.af_converter.constants import AF_CLOCK_HZ, CHANNELS, MASTER_HZ, WHITE_A_RTHZ
from sim_instruments.worlds.af_converter.unit_constants import NguTruth

Int64 = NDArray[np.int64]
Float = NDArray[np.float64]

_BITS = 36  # 120 s at full scale are 2^61 charge units
_NUMBERS = np.arange(1, CHANNELS + 1)


@dataclass(frozen=True)
class WindowCounts:
    """Counts of m records: ``npp``, ``ppp`` (m, 10), ``af_clock``, ``master_count``, ``fg_count`` (m,)."""

    npp: Int64
    ppp: Int64
    af_clock: Int64
    master_count: Int64
    fg_count: Int64

    def sums(self, record: int) -> dict[str, Int64]:
        """The counts of one record by field name, as a record of frames gives them."""
        return {name: np.asarray(getattr(self, name)[record]) for name in self.__dataclass_fields__}


def count_windows(
    truth: NguTruth,
    input_A: ArrayLike,
    t_start_s: ArrayLike,
    unit_degC: ArrayLike,
    *,
    play_offset_degC: ArrayLike = 0.0,
    settle_s: float = 20.0,
    window_s: float = 100.0,
    fg_Hz: float = 1e7,
) -> WindowCounts:
    """Count m records one after the other.

    Args:
        truth: the unit; its options say whether there is noise.
        input_A: current into every channel, (m, 10), ampere, applied ``settle_s`` before the record starts.
        t_start_s: start of each record, (m,), seconds of bench time (for the bias random walk).
        unit_degC: unit temperature in the middle of the record, (m,) or one for all.
        play_offset_degC: state of the hysteresis in the middle of the record, P - T, (m, 10) or one for all.
        settle_s: time from the change of the input to the start of the record.
        window_s: length of a record by the unit's nominal master clock.
        fg_Hz: true frequency of the function generator.
    """
    input_A = np.asarray(input_A, float)
    m = len(input_A)
    start_s = np.broadcast_to(np.asarray(t_start_s, float), m)
    degC = np.broadcast_to(np.asarray(unit_degC, float), m)
    gate_s = window_s / (1.0 + 1e-6 * truth.master_error_ppm(degC))
    clock_Hz = AF_CLOCK_HZ * (1.0 + 1e-6 * truth.af_clock_error_ppm)
    instants_s = np.stack((start_s - settle_s, start_s, start_s + gate_s), axis=1)
    edges = np.floor(instants_s * clock_Hz).astype(np.int64)
    clocks = edges[:, 1:] - edges[:, :-1]
    middle_s = (start_s + window_s / 2)[:, None]
    bias_A = truth.bias_A(_NUMBERS, degC[:, None], middle_s, play_offset_degC)
    currents = _currents_A(truth, input_A - bias_A, (settle_s, window_s))
    npp, ppp = _pulses(truth, currents, degC, clocks)
    fg = (np.floor(instants_s[:, 2] * fg_Hz) - np.floor(instants_s[:, 1] * fg_Hz)).astype(np.int64)
    master = np.full(m, round(MASTER_HZ * window_s), np.int64)
    return WindowCounts(npp, ppp, clocks[:, 1], master, fg)


def _currents_A(truth: NguTruth, steady_A: Float, spans_s: tuple[float, float]) -> Float:
    """Net current in the settle time and in the record with its white noise, (m, 10, 2), ampere."""
    net_A = np.repeat(steady_A[:, :, None], 2, axis=2)
    if truth.noise:
        rng = generator(truth.seed, "ngu window noise")
        net_A += rng.standard_normal(net_A.shape) * (WHITE_A_RTHZ / np.sqrt(2.0 * np.array(spans_s)))
    return net_A


def _pulses(truth: NguTruth, net_A: Float, degC: Float, clocks: Int64) -> tuple[Int64, Int64]:
    bank = ChargeBalance(np.full(CHANNELS, 1 << _BITS))
    rng = generator(truth.seed, "ngu first charge")
    bank.residue = rng.integers(-(1 << _BITS), 1 << _BITS, CHANNELS)
    npp, ppp = np.empty(net_A.shape[:2], np.int64), np.empty(net_A.shape[:2], np.int64)
    last_degC = None
    for record, temperature_degC in enumerate(degC.tolist()):
        if temperature_degC != last_degC:
            (converters,) = quanta(truth, np.array([temperature_degC]), _BITS)
            bank.set_quanta(converters.q_n, converters.q_p)
            last_degC = temperature_degC
        bank.advance_once(converters.charge(net_A[record, :, 0]), int(clocks[record, 0]))
        charge = converters.charge(net_A[record, :, 1])
        npp[record], ppp[record] = bank.advance_once(charge, int(clocks[record, 1]))
    return npp, ppp
