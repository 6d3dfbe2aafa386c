"""The world of the north finder's bench: gyroscope on a turning table, its index marks, the place, the Earth.

Its truth is what a perfect analysis would find; nothing of the product reads it.

The simulated gyroscope as a unit under test: supply, analogue output, serial port of frames ``fog_1k``.

It starts 2 s behind its supply and then sends by itself, a frame for each millisecond of the bench clock; the samples
are those of the analogue output. The port listens to nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from bench.frame import load_frame
from bench.model.arrays import Floats, Integers
from bench.model.clock import NS, Clock, to_ns
from bench.model.lab import find_shipped
from bench.model.ports import RecordWindow
from sim_instruments.seeds import generator
from sim_instruments.worlds.common.attitude import Site
from sim_instruments.worlds.common.motion import AxisMotion
from sim_instruments.worlds.common.port import OnePortUnit
from sim_instruments.worlds.common.thermal import LAB_DEGC, Thermal
from sim_instruments.worlds.common.world import Operation, World, entry
from sim_instruments.worlds.north.options import FogOptions
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


_PLACE = ("item", "place", "parameters", "head_deg")
UNKNOWN = ("test", "search")  # items whose azimuth an analysis finds; that of a calibration is stated

SITE = Site(latitude_deg=37.0, gravity_m_s2=9.799, azimuth_deg=20.0)
PLACES = ("mark", "field")
PARAMETERS = CONSTANT, VARYING = "TIP", "TVP"
START_V, CURRENT_A = 12.0, 0.4
_MRAD_PER_ARCMIN = 1e3 * math.radians(1.0 / 60.0)


def _true_values(
    sensor: FogSensor, heading_deg: Callable[[Integers], Floats], windows: Sequence[RecordWindow]
) -> list[dict[str, Any]]:
    """Return true values in the contract's form: azimuth of each heading, index marks, amplitude, noise of a sample."""
    entries: dict[tuple[Any, ...], dict[str, Any]] = {}
    for window in windows:
        if window.conditions.get("item") in UNKNOWN:
            conditions = {key: window.conditions[key] for key in _PLACE if key in window.conditions}
            middle_ns = np.array([(window.t_start_ns + window.t_end_ns) // 2])
            azimuth_deg = float(heading_deg(middle_ns)[0])
            entries.setdefault(tuple(conditions.items()), entry("azimuth", "deg", azimuth_deg, conditions))
    if not entries:
        return []
    marks = [entry("index_placement", "deg", at_deg, {"index": mark}) for mark, at_deg in sensor.placement_deg.items()]
    about = {"source": "waveform"}
    signal = [entry("scale", "V", sensor.amplitude_V, about), entry("noise", "V", sensor.noise_V, about)]
    return [*entries.values(), *marks, *signal]


class FogWorld(World):
    """One simulated north finder.

    Args: clock, seed: as of every world.   options: checked ones of ``fog_options``; the others are as by default.
    Attributes: motion: of the table's axes; the first one, vertical, turns the gyroscope.
        place: "mark", whose azimuth was surveyed, or "field", whose azimuth nobody knows.   head_deg: dividing head.
    """

    ports = (PORT,)
    load = START_V, CURRENT_A

    def __init__(self, *, clock: Clock, seed: int, options: Mapping[str, Any]) -> None:
        self.motion = (AxisMotion(), AxisMotion(), AxisMotion())
        self.place, self.head_deg = "mark", 0.0
        self._field_deg = generator(seed, "fog field azimuth").uniform(0.0, 360.0)
        self._headings = [(-1, SITE.azimuth_deg)]  # from that time on
        self.fog_options = FogOptions(**options)
        self.sensor = FogSensor(seed, self.fog_options, self.motion[0], SITE.latitude_deg, self.heading_deg)
        self.gyroscope = FogUnit(clock, self.sensor)
        super().__init__(clock=clock, seed=seed, unit=self.gyroscope, thermal=Thermal(), options=options)
        self.gyroscope.lock = self.lock

    def _set_parameters(self, word: str) -> None:
        """Let amplitude and swing vary as the option says, slowly if it says constant, or be constant."""
        kind = self.fog_options.parameters if self.fog_options.parameters != "constant" else "slow"
        self.sensor.varies.append((self.clock.now_ns(), kind if word == VARYING else "constant"))

    def _stand(self, place: str, head_deg: float) -> None:
        self.place, self.head_deg = place, head_deg
        azimuth_deg = SITE.azimuth_deg if self.place == "mark" else self._field_deg
        self._headings.append((self.clock.now_ns(), (azimuth_deg + self.head_deg) % 360.0))

    operations: ClassVar[Mapping[str, Operation]] = {
        "head": Operation.number(
            lambda world, head_deg: world._stand(world.place, head_deg), -360.0, 360.0, "deg",
            due="an angle of -360 to 360 degrees"),
        "place": Operation.word(lambda world, place: world._stand(place, world.head_deg), *PLACES),
        "parameters": Operation.word(_set_parameters, *PARAMETERS),
    }  # fmt: skip

    # --- what the instruments see ------------------------------------------------------------------------------

    def waveform(self, n0: int, n1: int) -> Floats:
        """Return analogue output: means over the milliseconds n0 to n1 - 1 of the bench clock, volt, (n1 - n0,).

        Only what is past may be asked for; it never changes.
        """
        return self.gyroscope.waveform(n0, n1)

    def pulses(self, index: str, t0_ns: int, t1_ns: int) -> Integers:
        """Return times of the pulses of index mark "a" or "b" in [t0, t1), bench time in ns; only what is past."""
        return self.sensor.pulses(index, t0_ns, t1_ns)

    def heading_deg(self, t_ns: Integers) -> Floats:
        """Return True heading of the sensing axis at encoder zero, head included, at bench times (n,)."""
        since_ns, headings_deg = (np.array(column) for column in zip(*self._headings, strict=True))
        which = np.searchsorted(since_ns, np.asarray(t_ns, np.int64), side="right") - 1
        return np.asarray(headings_deg[np.maximum(which, 0)])

    def level_mrad(self, t_ns: int) -> tuple[float, float]:
        """Return tilt of the rotation axis about the bench axes: x along heading H0 (with head), y 90 deg clockwise.

        Right-handed about each axis. The bench stands on a floor whose tilt about north and east does not change.
        """
        heading = math.radians(float(self.heading_deg(np.array([t_ns]))[0]))
        east = self.fog_options.rotation_tilt_east_arcmin * _MRAD_PER_ARCMIN
        north = self.fog_options.rotation_tilt_arcmin * _MRAD_PER_ARCMIN
        x = east * math.sin(heading) + north * math.cos(heading)
        y = east * math.cos(heading) - north * math.sin(heading)
        return x, y

    def truth(self, windows: Sequence[RecordWindow]) -> list[dict[str, Any]]:
        return _true_values(self.sensor, self.heading_deg, windows)


WORLD = FogWorld
