"""The measuring part of the simulated unit: gates of 10 ms, and what its counters hold at the end of each."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from bench.model.arrays import Floats, Integers
from bench.model.clock import NS
from sim_instruments.worlds.af_converter.block import BLOCK_GATES, CHARGE_BITS, BlockFactory, GateBlock
from sim_instruments.worlds.af_converter.charge_balance import ChargeBalance, Pulses
from sim_instruments.worlds.af_converter.constants import CHANNELS, KINDS

_FULL_SCALE_A = np.array([kind.full_scale_A for kind in KINDS])
_BITS = 1 << np.arange(CHANNELS)


def _none() -> Integers:
    return np.zeros(CHANNELS, np.int64)


@dataclass(frozen=True)
class Drive:
    """Inputs from outside: currents (10,), ampere, and the reference pulses of the function generator."""

    input_A: Floats = field(default_factory=lambda: np.zeros(CHANNELS))
    fg_Hz: float = 0.0
    fg_since_ns: int = 0
    fg_phase: float = 0.0  # pulses up to fg_since_ns

    @cached_property
    def over_range(self) -> int:
        """Bit k - 1 is set where channel k is beyond its range."""
        return int(_BITS[np.abs(self.input_A) > _FULL_SCALE_A].sum())

    def fg_pulses(self, epoch_ns: int, t_s: Floats) -> Integers:
        """Return whole pulses of the function generator up to ``t_s`` seconds after the epoch."""
        elapsed_s = t_s + (epoch_ns - self.fg_since_ns) / NS
        return np.floor(self.fg_phase + self.fg_Hz * elapsed_s).astype(np.int64)

    def with_fg(self, frequency_Hz: float, t_ns: int) -> Drive:
        """Return the same with another frequency from ``t_ns`` on; the phase goes on."""
        phase = self.fg_phase + self.fg_Hz * (t_ns - self.fg_since_ns) / NS
        return replace(self, fg_Hz=frequency_Hz, fg_since_ns=t_ns, fg_phase=phase)


@dataclass
class GateState:
    """The state of the unit: ``gate`` gates are done, ``edge`` AF clocks and ``fraction`` of the next are integrated.

    ``partial`` is the charge of that fraction; ``n_pulses``, ``p_pulses`` are the counts of the gate in progress.
    Arrays are replaced, never written to, so a shallow copy keeps the state.
    """

    drive: Drive
    block: GateBlock | None = None
    gate: int = 0
    edge: int = 0
    fraction: float = 0.0
    partial: Integers = field(default_factory=_none)
    n_pulses: Integers = field(default_factory=_none)
    p_pulses: Integers = field(default_factory=_none)
    residue: Integers = field(default_factory=_none)
    fg_count: int = 0


@dataclass(frozen=True)
class GateRows:
    """n finished gates: counts (10, n) and (n,), ``end_ns`` bench time, ``over_range`` bits; ``first`` gate from 0."""

    first: int
    end_ns: Integers
    npp: Pulses
    ppp: Pulses
    af_clock: Integers
    fg_count: Integers
    over_range: int


class GateMachine:
    """Runs the gates of one power-on period; its whole state is ``state`` and may be put back to an earlier one."""

    def __init__(self, factory: BlockFactory, drive: Drive) -> None:
        self._factory = factory
        self._bank = ChargeBalance(np.full(CHANNELS, 1 << CHARGE_BITS), np.uint16)
        self.state = self._before_first_gate(drive)

    def run(self, stop_ns: int) -> list[GateRows]:
        """Finish gates that end at or before ``stop_ns``, in order; those that are alike go together."""
        rows: list[GateRows] = []
        for block in self._blocks(stop_ns):
            self.state.block = block
            at = self.state.gate - block.first
            last = int(block.ends_ns.searchsorted(stop_ns, "right"))
            if at < last and (self.state.edge > block.edges[at] or self.state.fraction > 0.0):
                rows.append(self._finish_gate(block, at))
                at += 1
            if at < last:
                rows.append(self._whole_gates(block, at, last))
        return rows

    def change(self, drive: Drive, t_ns: int) -> None:
        """From ``t_ns`` on the unit is driven by ``drive``; every gate that ends before is already finished."""
        blocks = self._blocks(t_ns)
        if not blocks:
            self.state = self._before_first_gate(drive)
            return
        block = self.state.block = blocks[0]
        position = (t_ns - self._factory.epoch_ns) / NS * self._factory.af_clock_Hz
        self._integrate(block, max(position, self.state.edge + self.state.fraction))
        self.state.drive = drive

    def _before_first_gate(self, drive: Drive) -> GateState:
        """The integrator starts empty; pulses of the function generator count from the first gate on."""
        return GateState(drive, fg_count=int(drive.fg_pulses(self._factory.epoch_ns, np.zeros(1))[0]))

    def _blocks(self, stop_ns: int) -> list[GateBlock]:
        """Return block of the next gate and those behind it that begin up to ``stop_ns``; none before the first."""
        block, gate = self.state.block, self.state.gate
        begun = [block] if block is not None and gate < block.first + BLOCK_GATES else []
        start_s = 0.0 if block is None else float(block.ends_s[-1])
        if self._factory.epoch_ns + round(start_s * NS) > stop_ns:
            return begun
        return begun + self._factory.make(gate // BLOCK_GATES + len(begun), start_s, stop_ns)

    def _charge(self, block: GateBlock) -> Integers:
        """Return charge per clock without noise, (C,)."""
        return block.quanta.charge(self.state.drive.input_A - block.bias_A, margin=block.noise_peak)

    def _load(self, block: GateBlock) -> ChargeBalance:
        self._bank.residue = self.state.residue
        self._bank.set_quanta(block.quanta.q_n, block.quanta.q_p)
        return self._bank

    def _whole_gates(self, block: GateBlock, at: int, last: int) -> GateRows:
        bank, steady = self._load(block), self._charge(block)
        clocks = block.edges[at + 1 : last + 1] - block.edges[at:last]
        npp, ppp = bank.advance(block.noise[:, at:last] + steady[:, None], clocks)
        self.state.edge, self.state.residue = int(block.edges[last]), bank.residue
        return self._rows(block, at, last, npp, ppp)

    def _finish_gate(self, block: GateBlock, at: int) -> GateRows:
        self._integrate(block, float(block.edges[at + 1]))
        npp, ppp = self.state.n_pulses[:, None], self.state.p_pulses[:, None]
        self.state.n_pulses = self.state.p_pulses = _none()
        return self._rows(block, at, at + 1, npp, ppp)

    def _rows(self, block: GateBlock, at: int, last: int, npp: Pulses, ppp: Pulses) -> GateRows:
        drive = self.state.drive
        pulses = np.empty(last - at + 1, np.int64)
        pulses[0] = self.state.fg_count
        pulses[1:] = drive.fg_pulses(self._factory.epoch_ns, block.ends_s[at:last])
        rows = GateRows(
            first=block.first + at,
            end_ns=block.ends_ns[at:last],
            npp=npp,
            ppp=ppp,
            af_clock=block.edges[at + 1 : last + 1] - block.edges[at:last],
            fg_count=pulses[1:] - pulses[:-1],
            over_range=drive.over_range,
        )
        self.state.gate, self.state.fg_count = block.first + last, int(pulses[-1])
        return rows

    def _integrate(self, block: GateBlock, position: float) -> None:
        """Integrate inside the gate in progress up to ``position``, in AF clocks from the epoch."""
        state = self.state
        charge = self._charge(block) + block.noise[:, state.gate - block.first]
        edge, fraction = int(position), position - int(position)
        if edge > state.edge:
            bank = self._load(block)
            limit = np.minimum(block.quanta.q_n, block.quanta.q_p)
            first = np.rint(state.partial + charge * (1.0 - state.fraction)).astype(np.int64)
            steps = np.column_stack([np.minimum(np.maximum(first, -limit), limit), charge])
            n_pulses, p_pulses = bank.advance(steps, np.array([1, edge - state.edge - 1]))
            state.n_pulses = state.n_pulses + n_pulses.sum(axis=1, dtype=np.int64)
            state.p_pulses = state.p_pulses + p_pulses.sum(axis=1, dtype=np.int64)
            state.edge, state.fraction, state.partial, state.residue = edge, 0.0, _none(), bank.residue
        state.partial = state.partial + np.rint(charge * (fraction - state.fraction)).astype(np.int64)
        state.fraction = fraction
