"""The world of the AF-converter bench: a unit of ten channels, in the chamber, at the calibrator's matrix.

The bench of AF converters with a unit in each slot of the chamber, behind a card of the switch matrix of its own.

Each unit has a seed, a lag and a temperature of its own: the air differs over the chamber, more at its ends, and the
neighbours warm it. What its sensors say differs from its converters by a gradient that stays (SENSED_DEGC, one sigma).
Unit number n from 0 is the one that a bench of a single unit has with the seed ``seed + n * SEED_STEP``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

from bench.model.clock import Clock
from bench.model.ports import RecordWindow
from sim_instruments.seeds import generator
from sim_instruments.worlds.af_converter.constants import CURRENT_A, START_V
from sim_instruments.worlds.af_converter.ngu import Ngu
from sim_instruments.worlds.af_converter.options import apart
from sim_instruments.worlds.af_converter.truth import estimates
from sim_instruments.worlds.common.thermal import LAB_DEGC, PlaceInAir, SharedAir, Thermal
from sim_instruments.worlds.common.wiring import CHANNELS, Wiring
from sim_instruments.worlds.common.world import Unit, World

SEED_STEP = 1_000_003
MOST_WARMER_DEGC = 0.4  # by its neighbours
AIR_SHARE = 0.005  # of the way from the room that a slot stays behind or goes too far, one sigma
LAG_SPREAD = 0.1
SENSED_DEGC = 0.15  # between converters and sensors, one sigma


class UnitsInSlots:
    """All units of the bench as one: channels and ports are counted on from slot to slot."""

    def __init__(self, units: Sequence[Ngu], ports: Mapping[str, tuple[Ngu, str]]) -> None:
        self._units, self._ports = units, ports

    def set_input(self, channel: int, current_A: float, t_ns: int) -> None:
        """Current into a channel of one unit."""
        place, number = divmod(channel - 1, CHANNELS)
        self._units[place].set_input(number + 1, current_A, t_ns)

    def set_power(self, on: bool, t_ns: int, voltage_V: float) -> None:
        """Supply of all units at once."""
        for unit in self._units:
            unit.set_power(on, t_ns, voltage_V)

    def set_fg(self, frequency_Hz: float, t_ns: int) -> None:
        """One reference for all units."""
        for unit in self._units:
            unit.set_fg(frequency_Hz, t_ns)

    def port_at(self, name: str) -> tuple[Ngu, str] | None:
        """Return the unit behind a port of the bench and its own name for it; None without such a port."""
        return self._ports.get(name)


class AfSlots(World):
    """One simulated bench with several AF converters.

    Args: slots: links and instruments of each by letter.   clock, seed, options: as of every world.
    """

    load = START_V, CURRENT_A

    def __init__(self, slots: Mapping[str, Any], *, clock: Clock, seed: int, options: Mapping[str, Any]) -> None:
        own, texts = apart(options)
        self._slots, factor = slots, float(own.get("time_constants", 1.0))
        thermals: list[Thermal] = []
        self._places: dict[str, PlaceInAir] = {}
        self.converters: dict[str, Ngu] = {}
        for number, letter in enumerate(slots):
            draws = generator(seed, "slot of the chamber", number)
            thermals.append(Thermal(factor, unit_lag=1.0 + LAG_SPREAD * draws.uniform(-1.0, 1.0)))
            share, warmer_degC = 1.0 + AIR_SHARE * draws.normal(), draws.uniform(0.0, MOST_WARMER_DEGC)
            offset_degC = warmer_degC + LAB_DEGC * (1.0 - share)
            place = self._places[letter] = PlaceInAir(thermals[-1], share, offset_degC)
            sensed = PlaceInAir(thermals[-1], share, offset_degC + SENSED_DEGC * draws.normal())
            self.converters[letter] = Ngu(
                clock, seed + number * SEED_STEP, place, texts, sensed=sensed, serial=f"SIM-{number + 1}"
            )
        ports = {
            own_name: (self.converters[letter], name)
            for letter, slot in slots.items()
            for name, own_name in slot["links"].items()
        }
        self.ports = tuple(ports)  # type: ignore[misc]
        every = UnitsInSlots(list(self.converters.values()), ports)
        shared = SharedAir(factor, thermals)
        super().__init__(clock=clock, seed=seed, unit=every, thermal=shared, options=own)
        self.wiring = Wiring(every, seed, CHANNELS * len(slots))

    def fed_by(self, role: str) -> Unit:
        letter = next((letter for letter, slot in self._slots.items() if role in slot["roles"].values()), None)
        return self.unit if letter is None else self.converters[letter]

    def truth(self, windows: Sequence[RecordWindow]) -> list[dict[str, Any]]:
        """Return true values of each unit, with its serial number as condition ``unit``."""
        entries = []
        for letter, slot in self._slots.items():
            own = [window for window in windows if window.link in slot["links"].values()]
            if own:
                known = {"unit": own[0].conditions["unit"]}
                of_unit = estimates(self.converters[letter].truth, self._places[letter], own)
                entries += [{**entry, "conditions": {**entry["conditions"], **known}} for entry in of_unit]
        return entries


class AfWorld(World):
    """One simulated bench of AF converters.

    Args: clock, seed: as of every world.   options: checked ones; switches that are not given are on.
        unit_factory: makes the unit from (clock, seed, its temperature, options of its own).
    """

    ports: ClassVar[tuple[str, ...]] = ("port_a", "port_b")
    load = START_V, CURRENT_A

    def __init__(
        self, *, clock: Clock, seed: int, options: Mapping[str, Any], unit_factory: Callable[..., Ngu] = Ngu
    ) -> None:
        own, texts = apart(options)
        thermal = Thermal(float(own.get("time_constants", 1.0)))
        self.converters = unit_factory(clock, seed, thermal, texts)
        super().__init__(clock=clock, seed=seed, unit=self.converters, thermal=thermal, options=own)

    @classmethod
    def in_slots(cls, slots: Mapping[str, Any], **made: Any) -> World:
        return AfSlots(slots, **made)

    def truth(self, windows: Sequence[RecordWindow]) -> list[dict[str, Any]]:
        return estimates(self.converters.truth, self.thermal, windows)


WORLD = AfWorld
