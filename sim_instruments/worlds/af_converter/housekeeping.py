"""Port B of the simulated unit: housekeeping frames at 10 Hz and the answers to commands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bench.frame import FrameDefinition
from sim_instruments.seeds import generator
from sim_instruments.worlds.af_converter.framer import Mode
from sim_instruments.worlds.af_converter.gates import GateRows
from sim_instruments.worlds.common.port import Port
from sim_instruments.worlds.common.thermal import TemperatureFunction

GATES_PER_FRAME = 10
_BLOCK = 4096  # frames whose sensor noise is drawn together
_WRAP = 1 << 16
_SENSORS = 4
_SENSOR_NOISE_DEGC = 0.01
_SUPPLY_NOISE_MV = 3.0
_SUPPLY_CURRENT_MA = 1850.0
_RAILS_MV = (5000.0, 15000.0, 15000.0)  # +5 V, +15 V, -15 V
_OVER_TEMPERATURE_DEGC = 70.0
_READINGS = _SENSORS + 2 + len(_RAILS_MV)


class Housekeeping:
    """Makes the frames of port B; a reading depends on the seed, the power-on period and the frame number only."""

    zero_frame = 0  # frames sent before the one with counter 0

    def __init__(
        self, port: Port, definition: FrameDefinition, thermal: TemperatureFunction, seed: int, *, noise: bool
    ) -> None:
        self._port = port
        self._definition = definition
        self._thermal = thermal
        self._seed = seed
        self._noise = noise
        self._drawn: dict[tuple[int, int], NDArray[np.float64]] = {}

    def send(self, rows: Sequence[GateRows], period: int, supply_V: float, mode: Mode) -> None:
        """Queue the housekeeping frames that fall due with these gates (each tenth gate ends one)."""
        gates = np.concatenate([np.arange(part.first + 1, part.first + 1 + len(part.end_ns)) for part in rows])
        due = gates % GATES_PER_FRAME == 0
        if not due.any():
            return
        number = gates[due] // GATES_PER_FRAME
        ready_ns = np.concatenate([part.end_ns for part in rows])[due]
        over_range = np.repeat([part.over_range for part in rows], [len(part.end_ns) for part in rows])[due]
        drawn = self._draws(period, number)
        unit_degC = self._thermal(ready_ns)
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

    def _draws(self, period: int, number: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return standard normal numbers of the frames, (n, readings)."""
        if not self._noise:
            return np.zeros((len(number), _READINGS))
        first, last = int(number[0]) // _BLOCK, int(number[-1]) // _BLOCK
        blocks = [self._block(period, block) for block in range(first, last + 1)]
        start = int(number[0]) - first * _BLOCK
        return (blocks[0] if first == last else np.concatenate(blocks))[start : start + len(number)]

    def _block(self, period: int, block: int) -> NDArray[np.float64]:
        key = (period, block)
        if key not in self._drawn:
            if len(self._drawn) > 2:
                self._drawn.pop(next(iter(self._drawn)))
            rng = generator(self._seed, "ngu housekeeping", period, block)
            self._drawn[key] = rng.standard_normal((_BLOCK, _READINGS))
        return self._drawn[key]
