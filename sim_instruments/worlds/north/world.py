"""The world of the north finder's bench: gyroscope on a turning table, its index marks, the place, the Earth.

Its truth is what a perfect analysis would find; nothing of the product reads it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from bench.model.arrays import Floats, Integers
from bench.model.clock import Clock
from bench.model.ports import RecordWindow
from sim_instruments.seeds import generator
from sim_instruments.worlds.common.attitude import Site
from sim_instruments.worlds.common.motion import AxisMotion
from sim_instruments.worlds.common.thermal import Thermal
from sim_instruments.worlds.common.world import Operation, World, entry
from sim_instruments.worlds.north.options import FogOptions
from sim_instruments.worlds.north.sensor import FogSensor
from sim_instruments.worlds.north.unit import PORT, FogUnit

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
