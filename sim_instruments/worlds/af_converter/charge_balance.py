"""Three-state synchronous charge-balance converters in exact integers, without stepping through the clock.

At every edge of its clock a converter adds the charge of the past clock period to its integrator Q. If Q is then
above +Qth one N pulse removes q_N; if it is below -Qth one P pulse adds q_P; otherwise nothing happens. All charges
are whole numbers of one small unit, so the closed form below gives the counts of a clock-by-clock loop exactly, and
the result does not depend on how a stretch of time is cut into calls.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bench.model.arrays import Flags, Integers

Pulses = NDArray[np.integer]


class ChargeBalance:
    """A bank of C converters that share one clock.

    Args:
        threshold: Qth of each converter, (C,), charge units; positive.
        pulse_type: integer type of the counts of a stretch; must hold the clocks of one.
    Attributes:
        residue: integrator charge after the last edge, (C,), charge units; always inside [-Qth, +Qth].
    Raises:
        ValueError: one call covers so many clocks that the charge could leave 64 bits.
    Source:
        AF-converter paper section 2 (separate positive and negative reset currents); closed form derived here:
        while only N pulses occur, their number up to an edge is max(0, ceil((max(phi) - Qth) / q_N)) with phi the
        integrated charge, because a pulse takes away at least what one clock can bring.
    """

    def __init__(self, threshold: Integers, pulse_type: type[np.integer] = np.int64) -> None:
        self._threshold = np.asarray(threshold, np.int64)
        self._pulse_type = pulse_type
        self.residue = np.zeros_like(self._threshold)
        self._q_n = self._threshold.copy()
        self._q_p = self._threshold.copy()
        self._max_clocks = 0
        self.set_quanta(self._q_n, self._q_p)

    def set_quanta(self, q_n: Integers, q_p: Integers) -> None:
        """Set the charge of one N and of one P pulse, (C,) each, charge units; each in (0, 2 Qth]."""
        self._q_n = np.asarray(q_n, np.int64)
        self._q_p = np.asarray(q_p, np.int64)
        largest = max(int(self._q_n.max()), int(self._q_p.max()))
        self._max_clocks = (1 << 62) // largest

    def advance(self, charge: Integers, clocks: Integers) -> tuple[Pulses, Pulses]:
        """Let n stretches of time pass, with constant input in each.

        Args:
            charge: charge per clock period, (C, n), charge units, positive makes N pulses; not above the smaller
                pulse charge of the converter. Overwritten.
            clocks: edges in each stretch, (n,), n > 0.
        Returns:
            N and P pulses of each stretch, (C, n) each.
        """
        if (total := int(clocks.sum())) > self._max_clocks:
            raise ValueError(f"{total} clocks in one call; at most {self._max_clocks} fit 64-bit charge")
        falling = np.asarray((charge <= 0).all(axis=1))
        one_way = (falling | (charge >= 0).all(axis=1)).all()
        charge *= clocks
        return self._one_way(charge, falling) if one_way else self._any_way(charge)

    def _one_way(self, steps: Integers, falling: Flags) -> tuple[Pulses, Pulses]:
        """Every row only rises or only falls, so its extreme is its last value; of one that falls all is negative."""
        quantum = np.where(falling, -self._q_p, self._q_n)
        ahead = quantum + np.where(falling, 1 + self._threshold, -1 - self._threshold)
        steps[:, 0] += self.residue + ahead
        phi = np.cumsum(steps, axis=1, out=steps)
        total = np.zeros((len(steps), steps.shape[1] + 1), np.int64)
        for row, divisor in enumerate(quantum.tolist()):  # by a plain number: numpy divides by it much faster
            np.floor_divide(phi[row], divisor, out=total[row, 1:])
        if (total[:, 1] < 0).any():
            np.maximum(total, 0, out=total)
        self.residue = phi[:, -1] - ahead - quantum * total[:, -1]
        counts = total.astype(self._pulse_type)  # what an unsigned type loses of a total, the differences get back
        pulses = counts[:, 1:] - counts[:, :-1]
        n_pulses, p_pulses = np.zeros_like(pulses), np.zeros_like(pulses)
        for row, p_only in enumerate(falling.tolist()):
            (p_pulses if p_only else n_pulses)[row] = pulses[row]
        return n_pulses, p_pulses

    def _any_way(self, steps: Integers) -> tuple[Pulses, Pulses]:
        n_pulses, p_pulses = (np.empty(steps.shape, self._pulse_type) for _ in range(2))
        self.residue = self.residue.copy()
        for row in range(len(steps)):
            phi = np.cumsum(steps[row]) + self.residue[row]
            q_n, q_p = int(self._q_n[row]), int(self._q_p[row])
            n_total, p_total = _phases(phi, q_n, q_p, int(self._threshold[row]))
            self.residue[row] = phi[-1] - q_n * n_total[-1] + q_p * p_total[-1]
            n_pulses[row] = np.diff(n_total, prepend=0)
            p_pulses[row] = np.diff(p_total, prepend=0)
        return n_pulses, p_pulses


def _phases(phi: Integers, q_n: int, q_p: int, threshold: int) -> tuple[Integers, Integers]:
    """Return cumulative N and P pulses at each sample of the integrated charge ``phi``, by phases of one polarity."""
    n_total = np.zeros_like(phi)
    p_total = np.zeros_like(phi)
    at, n_done, p_done = 0, 0, 0
    while at < len(phi):
        left = phi[at:] - q_n * n_done + q_p * p_done
        outside = np.flatnonzero(np.abs(left) > threshold)
        n_total[at:], p_total[at:] = n_done, p_done
        if len(outside) == 0:
            break
        up = bool(left[outside[0]] > 0)
        pulses, length = _one_phase(left if up else -left, q_n if up else q_p, threshold)
        (n_total if up else p_total)[at : at + length] += pulses[:length]
        at += length
        n_done, p_done = int(n_total[at - 1]), int(p_total[at - 1])
    return n_total, p_total


def _one_phase(phi: Integers, quantum: int, threshold: int) -> tuple[Integers, int]:
    """Return pulses of one polarity, and the samples until the other polarity is due."""
    highest = np.maximum.accumulate(phi)
    pulses = np.maximum((highest - threshold + quantum - 1) // quantum, 0)
    other = np.flatnonzero(phi - quantum * pulses < -threshold)
    return pulses, int(other[0]) if len(other) else len(phi)
