"""The simulated gyroscope as a unit under test: supply, analogue output, serial port of frames ``fog_1k``.

It starts 2 s behind its supply and then sends by itself, a frame for each millisecond of the bench clock; the samples
are those of the analogue output. The port listens to nothing.
"""

from __future__ import annotations

import numpy as np

from bench.frame import load_frame
from bench.model.arrays import Floats, Integers
from bench.model.clock import NS, Clock, to_ns
from bench.model.shipped import find_shipped
from sim_instruments.worlds.common.port import OnePortUnit
from sim_instruments.worlds.common.thermal import LAB_DEGC
from sim_instruments.worlds.north.sensor import SAMPLE_NS, TURN_DEG, FogSensor

PORT, FRAME = "fog", "fog_1k"
BOOT_S = 2.0
MADE_NS = 100_000  # from the end of a sample to its frame
STEPS_PER_TURN = 2**24
OUTPUT_LSB_V, TEMPERATURE_LSB_DEGC = 1e-6, 0.01
HIGHEST_COUNT = 2**31 - 1
WARM_DEGC, WARM_S = 4.0, 600.0  # self-heating and its lag
AT_ONCE = 20_000  # frames made together at most
_NEVER = 2**62


class FogUnit(OnePortUnit):
    """Unit under test of the world ``fog_north``.

    Args: clock: of the bench.   sensor: the gyroscope on its table.
    Attributes: lock: held while the past is read, and by whoever moves the table (the world's own).
    """

    port_name = PORT

    def __init__(self, clock: Clock, sensor: FogSensor) -> None:
        super().__init__(clock)
        self.definition = load_frame(find_shipped("frames", FRAME))
        self.sensor = sensor
        self._periods: list[list[int]] = []  # first sample with supply, first one without, power-on in ns
        self._sent = 0  # frames of the newest period

    # --- the bench ---------------------------------------------------------------------------------------------

    def set_power(self, on: bool, t_ns: int, voltage_V: float) -> None:
        """Supply on or off; a voltage that changes while it is on changes nothing."""
        with self.lock:
            self._upto_now()
            if on == self._supplied:
                return
            if on and voltage_V > 0.0:
                self._periods.append([-(-(t_ns + to_ns(BOOT_S)) // SAMPLE_NS), _NEVER, t_ns])
                self._sent = 0
            elif not on:
                self._send(t_ns)
                self._periods[-1][1] = t_ns // SAMPLE_NS

    @property
    def _supplied(self) -> bool:
        return bool(self._periods) and self._periods[-1][1] == _NEVER

    def waveform(self, first: int, stop: int) -> Floats:
        """Return means of the output over the milliseconds ``first`` to ``stop`` - 1, volt; 0 while it is dead."""
        number = np.arange(first, stop, dtype=np.int64)
        volts = np.zeros(number.size)
        with self.lock:
            for begin, end, _ in self._periods:
                alive = slice(max(begin - first, 0), max(min(end, stop) - first, 0))
                if number[alive].size:
                    volts[alive] = self.sensor.output_V(number[alive])
        return volts

    def _foreseen(self, name: str, t_ns: Integers) -> Integers:
        self._upto_now()
        if self._supplied:
            self._send(int(t_ns[-1]))
        return t_ns

    # --- frames ------------------------------------------------------------------------------------------------

    def _upto(self, now_ns: int) -> int:
        if self._supplied:
            self._send(now_ns)
        return now_ns

    def _send(self, now_ns: int) -> None:
        """Send the samples of the newest period that are ready; nobody's are only counted."""
        begin, _, power_ns = self._periods[-1]
        due = max((now_ns - MADE_NS) // SAMPLE_NS - begin, 0)
        if not self.port.listened:
            self._sent = due
        while self._sent < due:
            counter = np.arange(self._sent, min(due, self._sent + AT_ONCE), dtype=np.int64)
            self._send_frames(counter, begin + counter, power_ns)
            self._sent += counter.size

    def _send_frames(self, counter: Integers, number: Integers, power_ns: int) -> None:
        middle_ns = number * SAMPLE_NS + SAMPLE_NS // 2
        output = np.rint(self.sensor.output_V(number) / OUTPUT_LSB_V)
        turns = self.sensor.table_deg(middle_ns) / TURN_DEG
        degC = LAB_DEGC - WARM_DEGC * np.expm1((power_ns - middle_ns) / NS / WARM_S)
        columns = {
            "counter": (counter % 2**32).astype(np.uint32),
            "output": output.clip(-HIGHEST_COUNT, HIGHEST_COUNT).astype(np.int64),
            "encoder": np.rint((turns - np.floor(turns)) * STEPS_PER_TURN).astype(np.int64) % STEPS_PER_TURN,
            "temperature": np.rint(degC / TEMPERATURE_LSB_DEGC).astype(np.int64),
            "status": 0,
        }
        ready_ns = (number + 1) * SAMPLE_NS + MADE_NS
        self.port.append(ready_ns, self.definition.encode(columns, number.size))
