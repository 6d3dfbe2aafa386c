"""Edges of one laser that runs, by bench time: made in blocks as they are asked for, the same however they are asked.

A block is forty half cycles. What is drawn for a block is a function of its number, so a block can be made again from
any of its half cycles on when somebody changes the laser meanwhile.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bench.model.arrays import Floats, Integers, Octets
from sim_instruments.worlds.lock_in.core import AT_ONCE, BEAT, PICK_OFF, RingLaser, levels
from sim_instruments.worlds.lock_in.crossings import crossings
from sim_instruments.worlds.lock_in.half_cycles import integrate

Columns = tuple[Integers, Octets, Octets, Octets]
Draw = Callable[..., np.random.Generator]

PS = 10**12
PICK_OFF_NOISE_PS = 15_000  # of the comparator at the slow zero of the dither's pick-off, normal
PICK_OFF_DELAY_PS = 60_000  # of the same: four times its noise, so that no edge comes before its half cycle
NOTHING: Columns = (np.empty(0, np.int64), np.empty(0, np.uint8), np.empty(0, np.uint8), np.empty(0, np.uint8))


@dataclass(frozen=True)
class _Block:
    """Edges not yet handed out from the half cycle ``first`` on; phase at each beginning, within a turn of zero."""

    first: int
    columns: Columns
    start_rad: Floats


class EdgeStream:
    """Edges from the beginning of the beat on.

    Args:
        laser: what runs.   begin_ps: of half cycle 0, a maximum of the velocity, picoseconds since the bench's epoch.
        beta_rad: phase of the backscatter at times of that scale (n,) to (n,).
        draw: generator of a purpose and a number, see seeds.generator.
    """

    def __init__(self, laser: RingLaser, begin_ps: int, beta_rad: Callable[[Integers], Floats], draw: Draw) -> None:
        self.laser, self._begin_ps, self._beta_rad, self._draw = laser, begin_ps, beta_rad, draw
        self._half_ps = round(laser.half_s * PS)
        self._blocks: deque[_Block] = deque()
        self._next = 0  # half cycle to be made next
        self._psi_rad = self._fresh_rad(0)

    def until(self, t_ps: int) -> Columns:
        """Return edges before ``t_ps`` that were not yet handed out: picoseconds, channel, level, cosine level."""
        parts: list[Columns] = []
        while self._time_ps(self._next) < t_ps:
            self._make()
        while self._blocks:
            block = self._blocks[0]
            stop = int(np.searchsorted(block.columns[0], t_ps, side="left"))
            parts.append(_cut(block.columns, slice(0, stop)))
            if stop < len(block.columns[0]) or self._end_ps(0) > t_ps:
                self._blocks[0] = _Block(block.first, _cut(block.columns, slice(stop, None)), block.start_rad)
                break
            self._blocks.popleft()
        return joined(parts)

    def skip(self, t_ps: int) -> None:
        """Forget the edges before ``t_ps``; whole blocks are not computed, the phase behind them is a draw."""
        block = max(0, (t_ps - self._begin_ps) // self._half_ps // AT_ONCE)
        if block * AT_ONCE > self._next:
            self._blocks.clear()
            self._next, self._psi_rad = block * AT_ONCE, self._fresh_rad(block)
        self.until(t_ps)

    def change(self, t_ps: int) -> None:
        """Make again the half cycles that begin at ``t_ps`` or later: the laser has changed."""
        half = max(0, -(-(t_ps - self._begin_ps) // self._half_ps))
        while self._blocks and half < self._next:
            block = self._blocks.pop()
            if half <= block.first:
                self._next, self._psi_rad = block.first, float(block.start_rad[0])
                continue
            self._next, self._psi_rad = half, float(block.start_rad[half - block.first])
            stop = int(np.searchsorted(block.columns[0], self._time_ps(half), side="left"))
            kept = block.start_rad[: half - block.first]
            self._blocks.append(_Block(block.first, _cut(block.columns, slice(0, stop)), kept))

    def dither_deg_s(self, t_ps: int, seconds: float) -> float:
        """Return mean amplitude of the half cycles that ended in so many seconds before ``t_ps``, deg/s."""
        last = (t_ps - self._begin_ps) // self._half_ps
        first = max(0, last - round(seconds / self.laser.half_s))
        if last <= first:
            return 0.0
        blocks = range(first // AT_ONCE, (last - 1) // AT_ONCE + 1)
        drawn = np.concatenate([self._amplitudes(block) for block in blocks])
        start = blocks[0] * AT_ONCE
        return float(drawn[first - start : last - start].mean())

    def _make(self) -> None:
        """Make edges from the half cycle ``_next`` on to the end of its block."""
        block, skip = divmod(self._next, AT_ONCE)
        halves = np.arange(self._next, (block + 1) * AT_ONCE)
        laser = self.laser
        noise = self._noise("quantum noise", block, skip) if laser.quantum_deg_rt_h else None
        beat_noise = laser.beat_noise * self._noise("comparator", block, skip) if laser.beat_noise else None
        times_ps = self._time_ps(halves)
        amplitudes = self._amplitudes(block)[skip:]
        drive = laser.drive(amplitudes, 1 - 2 * (self._next % 2), noise, self._beta_rad(times_ps))
        motion = integrate(drive, self._psi_rad)
        crossed = crossings(drive, motion, beat_noise)
        start_rad = motion.psi_rad[:, 0].copy()
        noise_ps = PICK_OFF_NOISE_PS * self._draw("pick-off", block).standard_normal(AT_ONCE)[skip:]
        late_ps = np.maximum(0.0, PICK_OFF_DELAY_PS + noise_ps)
        beat_ps = times_ps[crossed.half] + np.rint(crossed.since_s * PS).astype(np.int64)
        t_ps = np.concatenate([times_ps + np.rint(late_ps).astype(np.int64), beat_ps])
        order = np.argsort(t_ps, kind="stable")
        channel = np.repeat(np.array([PICK_OFF, BEAT], np.uint8), [len(halves), len(crossed.half)])
        level, cosine = levels(halves % 2 == 0, start_rad, crossed)
        columns = (t_ps[order], channel[order], level[order], cosine[order])
        self._blocks.append(_Block(self._next, columns, start_rad))
        self._next, self._psi_rad = self._next + len(halves), float(motion.psi_rad[-1, -1])

    def _noise(self, purpose: str, block: int, skip: int) -> Floats:
        """Return standard normal draws of the half cycles of a block from the ``skip``-th on, one for each step."""
        return np.asarray(self._draw(purpose, block).standard_normal((AT_ONCE, self.laser.steps))[skip:])

    def _amplitudes(self, block: int) -> Floats:
        draws = self._draw("dither", block).standard_normal(AT_ONCE)
        return np.asarray(self.laser.dither_deg_s * (1.0 + self.laser.dither_noise * draws))

    def _fresh_rad(self, block: int) -> float:
        return self._draw("phase", block).uniform(-math.pi, math.pi)

    def _time_ps(self, half: Integers | int) -> Integers:
        return np.asarray(self._begin_ps + np.asarray(half, np.int64) * self._half_ps)

    def _end_ps(self, number: int) -> int:
        """Return time behind the last half cycle of a block that is kept."""
        block = self._blocks[number]
        return int(self._time_ps(block.first + len(block.start_rad)))


def joined(parts: list[Columns]) -> Columns:
    """Return parts in order as one."""
    if not parts:
        return NOTHING
    t_ps, *others = (np.concatenate(column) for column in zip(*parts, strict=True))
    return t_ps, others[0], others[1], others[2]


def _cut(columns: Columns, part: slice) -> Columns:
    t_ps, channel, level, cosine = columns
    return t_ps[part], channel[part], level[part], cosine[part]
