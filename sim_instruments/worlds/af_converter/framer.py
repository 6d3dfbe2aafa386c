"""Port A of the simulated unit: finished gates become frames of 100 Hz or of 100 s."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from bench.frame import FrameDefinition
from sim_instruments.worlds.af_converter.charge_balance import Pulses
from sim_instruments.worlds.af_converter.constants import CHANNELS, GATE_MASTER_PULSES, INTEGRATED_GATES
from sim_instruments.worlds.af_converter.gates import GateRows
from sim_instruments.worlds.common.port import Port

Int64 = NDArray[np.int64]

_OVER_RANGE_BIT = 1
_MODE_BIT = 12
_WRAP = 1 << 16


class Mode(IntEnum):
    """What port A sends; also the ``mode`` bits of the status word."""

    GATES = 0  # one frame per gate, 100 Hz
    INTEGRATED = 1  # one frame per 10,000 gates, 0.01 Hz
    OFF = 15


def _no_counts() -> dict[str, Int64]:
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
    sums: dict[str, Int64] = field(default_factory=_no_counts)


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
        over_range = np.repeat([part.over_range for part in rows], [len(part.end_ns) for part in rows])
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

    def _send_integrated(self, ready_ns: Int64) -> None:
        state = self.state
        status = state.over_range << _OVER_RANGE_BIT | Mode.INTEGRATED << _MODE_BIT
        columns = {name: total[None] for name, total in state.sums.items()} | {
            "counter": np.uint16(state.sent % _WRAP),
            "master_count": np.uint32(GATE_MASTER_PULSES * INTEGRATED_GATES),
            "status": np.uint16(status),
        }
        self._port.append(ready_ns, self._integrated.encode(columns, 1))
        self.state = FramerState(state.mode, state.zero_gate, state.sent + 1)


def _joined(parts: Sequence[Pulses], dtype: type[np.integer]) -> Pulses:
    return np.concatenate(parts, axis=-1, dtype=dtype, casting="unsafe")
