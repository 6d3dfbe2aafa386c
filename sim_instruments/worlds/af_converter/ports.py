"""Ports of the simulated unit: finished gates become frames of 100 Hz or of 100 s on port A; port B sends housekeeping
frames at 10 Hz and the answers to commands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np

from bench.frame import FrameDefinition
from bench.model.arrays import Floats, Integers
from sim_instruments.seeds import generator
from sim_instruments.worlds.af_converter.charge_balance import Pulses
from sim_instruments.worlds.af_converter.constants import CHANNELS, GATE_MASTER_PULSES, INTEGRATED_GATES
from sim_instruments.worlds.af_converter.gates import GateRows
from sim_instruments.worlds.common.port import Port
from sim_instruments.worlds.common.thermal import ThermalOfUnit

_OVER_RANGE_BIT = 1
_MODE_BIT = 12
_WRAP = 1 << 16
GATES_PER_FRAME = 10
_FRAMES_DRAWN = 4096  # frames whose sensor noise is drawn together
_SENSORS = 4
_SENSOR_NOISE_DEGC = 0.01
_SUPPLY_NOISE_MV = 3.0
_SUPPLY_CURRENT_MA = 1850.0
_RAILS_MV = (5000.0, 15000.0, 15000.0)  # +5 V, +15 V, -15 V
_OVER_TEMPERATURE_DEGC = 70.0
_READINGS = _SENSORS + 2 + len(_RAILS_MV)


class Mode(IntEnum):
    """Modes of port A by what it sends; also the ``mode`` bits of the status word."""

    GATES = 0  # one frame per gate, 100 Hz
    INTEGRATED = 1  # one frame per 10,000 gates, 0.01 Hz
    OFF = 15


def _no_counts() -> dict[str, Integers]:
    each = np.zeros(CHANNELS, np.int64)
    return {"npp": each, "ppp": each, "af_clock": np.zeros((), np.int64), "fg_count": np.zeros((), np.int64)}


@dataclass(frozen=True)
class FramerState:
    """``zero_gate``: gate whose frame has counter 0. Of the integrated frame in progress: ``gates`` it holds, their
    ``sums``, their ``over_range`` bits; ``sent`` integrated frames went before it.
    """

    mode: Mode = Mode.GATES
    zero_gate: int = 0
    sent: int = 0
    gates: int = 0
    over_range: int = 0
    sums: dict[str, Integers] = field(default_factory=_no_counts)


class Framer:
    """Makes the frames of port A; its whole state is ``state``."""

    def __init__(self, port: Port, gates: FrameDefinition, integrated: FrameDefinition) -> None:
        self.state = FramerState()
        self._port = port
        self._gates = gates
        self._integrated = integrated

    def start(self, mode: Mode) -> None:
        """Send in this mode from the next gate on; an integrated frame begins with that gate."""
        self.state = FramerState(mode, self.state.zero_gate)

    def zero_counter(self, gate: int) -> None:
        """The frame of gate number ``gate``, or the integrated frame in progress, gets counter 0."""
        self.state = replace(self.state, zero_gate=gate, sent=0)

    def send(self, rows: Sequence[GateRows]) -> None:
        """Queue the frames of finished gates, in order."""
        if self.state.mode is Mode.GATES:
            self._send_gates(rows)
        elif self.state.mode is Mode.INTEGRATED:
            for part in rows:
                self._add(part)

    def _send_gates(self, rows: Sequence[GateRows]) -> None:
        n = sum(len(part.end_ns) for part in rows)
        counter = np.arange(rows[0].first, rows[0].first + n) - self.state.zero_gate
        over_range = _over_range(rows)
        columns = {
            "counter": (counter % _WRAP).astype(np.uint16),
            "npp": _joined([part.npp for part in rows], np.uint16).T,
            "ppp": _joined([part.ppp for part in rows], np.uint16).T,
            "af_clock": _joined([part.af_clock for part in rows], np.uint32),
            "master_count": np.uint32(GATE_MASTER_PULSES),
            "fg_count": _joined([part.fg_count for part in rows], np.uint32),
            "status": (over_range << _OVER_RANGE_BIT).astype(np.uint16),
        }
        ready_ns = np.concatenate([part.end_ns for part in rows])
        self._port.append(ready_ns, self._gates.encode(columns, n))

    def _add(self, part: GateRows) -> None:
        """Add gates to the integrated frame in progress; send each one that becomes full."""
        at, n = 0, len(part.end_ns)
        while at < n:
            state = self.state
            take = min(n - at, INTEGRATED_GATES - state.gates)
            span = slice(at, at + take)
            sums = {
                name: total + getattr(part, name)[..., span].sum(axis=-1, dtype=np.int64)
                for name, total in state.sums.items()
            }
            at += take
            self.state = replace(
                state, gates=state.gates + take, over_range=state.over_range | part.over_range, sums=sums
            )
            if self.state.gates == INTEGRATED_GATES:
                self._send_integrated(part.end_ns[at - 1 : at])

    def _send_integrated(self, ready_ns: Integers) -> None:
        state = self.state
        status = state.over_range << _OVER_RANGE_BIT | Mode.INTEGRATED << _MODE_BIT
        columns = {name: total[None] for name, total in state.sums.items()} | {
            "counter": np.uint16(state.sent % _WRAP),
            "master_count": np.uint32(GATE_MASTER_PULSES * INTEGRATED_GATES),
            "status": np.uint16(status),
        }
        self._port.append(ready_ns, self._integrated.encode(columns, 1))
        self.state = FramerState(state.mode, state.zero_gate, state.sent + 1)


def _over_range(rows: Sequence[GateRows]) -> Integers:
    return np.repeat([part.over_range for part in rows], [len(part.end_ns) for part in rows])


def _joined(parts: Sequence[Pulses], dtype: type[np.integer]) -> Pulses:
    return np.concatenate(parts, axis=-1, dtype=dtype, casting="unsafe")


class Housekeeping:
    """Makes the frames of port B; a reading depends on the seed, the power-on period and the frame number only."""

    zero_frame = 0  # frames sent before the one with counter 0

    def __init__(
        self, port: Port, definition: FrameDefinition, thermal: ThermalOfUnit, seed: int, *, noise: bool
    ) -> None:
        self._port = port
        self._definition = definition
        self._thermal = thermal
        self._seed = seed
        self._noise = noise
        self._drawn: dict[tuple[int, int], Floats] = {}

    def send(self, rows: Sequence[GateRows], period: int, supply_V: float, mode: Mode) -> None:
        """Queue the housekeeping frames that fall due with these gates (each tenth gate ends one)."""
        start = -rows[0].first - 1
        due = slice(start % GATES_PER_FRAME, None, GATES_PER_FRAME)
        ready_ns = np.concatenate([part.end_ns for part in rows])[due]
        if not len(ready_ns):
            return
        number = np.arange(len(ready_ns)) - start // GATES_PER_FRAME
        over_range = _over_range(rows)[due]
        drawn = self._draws(period, number)
        unit_degC = self._thermal.unit_degC(ready_ns)
        degC = unit_degC[:, None] + _SENSOR_NOISE_DEGC * drawn[:, :_SENSORS]
        mV = np.array([supply_V * 1000.0, _SUPPLY_CURRENT_MA, *_RAILS_MV]) + _SUPPLY_NOISE_MV * drawn[:, _SENSORS:]
        supplies = np.rint(mV).clip(0, _WRAP - 1).astype(np.uint16)
        columns = {
            "counter": ((number - 1 - self.zero_frame) % _WRAP).astype(np.uint16),
            "unit_temperature": np.rint(degC * 100.0).astype(np.int16),
            "supply_voltage": supplies[:, 0],
            "supply_current": supplies[:, 1],
            "rails": supplies[:, 2:],
            "status.streaming": int(mode is not Mode.OFF),
            "status.integrated": int(mode is Mode.INTEGRATED),
            "status.over_range": (over_range != 0).astype(np.uint16),
            "status.over_temperature": (unit_degC > _OVER_TEMPERATURE_DEGC).astype(np.uint16),
        }
        self._port.append(ready_ns, self._definition.encode(columns, len(number), "housekeeping"))

    def answer(self, t_ns: int, command: int, status: int, payload: bytes) -> None:
        """Queue an answer made at ``t_ns``."""
        values = {"command": command, "status": status, "payload": payload}
        frame = self._definition.encode_one(values, "answer")
        self._port.append(np.array([t_ns]), np.frombuffer(frame, np.uint8)[None, :])

    def _draws(self, period: int, number: Integers) -> Floats:
        """Return standard normal numbers of the frames, (n, readings)."""
        if not self._noise:
            return np.zeros((len(number), _READINGS))
        first, last = int(number[0]) // _FRAMES_DRAWN, int(number[-1]) // _FRAMES_DRAWN
        blocks = [self._block(period, block) for block in range(first, last + 1)]
        start = int(number[0]) - first * _FRAMES_DRAWN
        return (blocks[0] if first == last else np.concatenate(blocks))[start : start + len(number)]

    def _block(self, period: int, block: int) -> Floats:
        key = (period, block)
        if key not in self._drawn:
            if len(self._drawn) > 2:
                self._drawn.pop(next(iter(self._drawn)))
            rng = generator(self._seed, "ngu housekeeping", period, block)
            self._drawn[key] = rng.standard_normal((_FRAMES_DRAWN, _READINGS))
        return self._drawn[key]
