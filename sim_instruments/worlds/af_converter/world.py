"""The world of the AF-converter bench: a unit of ten channels, in the chamber, at the calibrator's matrix.

The bench of AF converters with a unit in each slot of the chamber, behind a card of the switch matrix of its own.

Each unit has a seed, a lag and a temperature of its own: the air differs over the chamber, more at its ends, and the
neighbours warm it. What its sensors say differs from its converters by a gradient that stays (SENSED_DEGC, one sigma).
Unit number n from 0 is the one that a bench of a single unit has with the seed ``seed + n * SEED_STEP``.

Its truth is what a perfect analysis of the records would find. Nothing of the product reads it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from bench.model.arrays import Integers
from bench.model.clock import NS, Clock
from bench.model.ports import RecordWindow
from sim_instruments.seeds import generator
from sim_instruments.worlds.af_converter.constants import CURRENT_A, REFERENCE_DEGC, START_V
from sim_instruments.worlds.af_converter.ngu import Ngu
from sim_instruments.worlds.af_converter.options import apart
from sim_instruments.worlds.af_converter.unit_constants import NguTruth
from sim_instruments.worlds.common.thermal import LAB_DEGC, PlaceInAir, SharedAir, Thermal
from sim_instruments.worlds.common.wiring import CHANNELS, Wiring
from sim_instruments.worlds.common.world import Unit, World, entry

_POINTS_PER_WINDOW = 11
TEMPERATURES_DEGC = (-10.0, 5.0, 20.0, 35.0, 50.0)
_ORDERS = 4
_REFERENCE = {"reference_temperature_degC": REFERENCE_DEGC}


def per_degC(unit: str, order: int) -> str:
    """Return unit of the coefficient of (T - T_ref)^order."""
    return unit if order == 0 else f"{unit}/degC{order if order > 1 else ''}"


def times_ns(windows: Sequence[RecordWindow]) -> Integers:
    """Return bench times spread evenly over the windows."""
    return np.concatenate([np.linspace(w.t_start_ns, w.t_end_ns, _POINTS_PER_WINDOW).astype(np.int64) for w in windows])


def estimates(truth: NguTruth, thermal: Thermal | PlaceInAir, windows: Sequence[RecordWindow]) -> list[dict[str, Any]]:
    """Return true values in the contract's form, one block per channel and temperature of the measuring windows.

    Scale factors are those at the unit's true temperature averaged over the windows of that channel and temperature
    (wiring checks and closing repeats left out); the bias is averaged over the open-input windows among them, with
    the hysteresis as it was then. A bias campaign has a list of its own.
    """
    if ramp := bias_windows(windows):
        return bias_estimates(truth, ramp, thermal.unit_lag_s)
    entries: list[dict[str, Any]] = []
    groups = _groups(windows)
    for (channel, kind, nominal_degC), group in groups.items():
        conditions = {"channel": channel, "kind": kind, "temperature_degC": nominal_degC}
        entries += _at_temperature(truth, thermal, group, conditions)
    for channel, kind in dict.fromkeys((channel, kind) for channel, kind, _ in groups):
        entries += _coefficients(truth, channel, kind)
    for nominal_degC in sorted({nominal_degC for _, _, nominal_degC in groups}):
        spans = [w for (_, _, degC), group in groups.items() if degC == nominal_degC for w in group]
        entries += _clocks(truth, thermal.unit_degC(times_ns(spans)), {"temperature_degC": nominal_degC})
    return entries


def _groups(windows: Sequence[RecordWindow]) -> dict[tuple[int, str, float], list[RecordWindow]]:
    groups: dict[tuple[int, str, float], list[RecordWindow]] = {}
    for window in windows:
        conditions = window.conditions
        if not {"channel", "kind", "temperature_degC"} <= conditions.keys():
            continue
        if conditions.get("repeat") or conditions.get("purpose") == "wiring":
            continue
        key = (int(conditions["channel"]), str(conditions["kind"]), float(conditions["temperature_degC"]))
        groups.setdefault(key, []).append(window)
    return groups


def _at_temperature(
    truth: NguTruth, thermal: Thermal | PlaceInAir, windows: Sequence[RecordWindow], conditions: dict[str, Any]
) -> list[dict[str, Any]]:
    channel = conditions["channel"]
    unit_degC = float(thermal.unit_degC(times_ns(windows)).mean())
    n_ppm, p_ppm = truth.dsf_ppm(channel, unit_degC).tolist()
    open_ns = times_ns([w for w in windows if w.conditions.get("route") == "open"] or windows)
    offset_degC = thermal.play_offset_degC(open_ns, truth.half_width_degC[channel - 1])
    bias_A = truth.bias_A(channel, thermal.unit_degC(open_ns), open_ns / NS, offset_degC).mean()
    return [
        entry("dsf_n", "ppm", n_ppm, conditions),
        entry("dsf_p", "ppm", p_ppm, conditions),
        entry("dsf_asymmetry", "ppm", n_ppm - p_ppm, conditions),
        entry("bias", "A", bias_A, conditions),
    ]


def _clocks(truth: NguTruth, unit_degC: np.ndarray, conditions: dict[str, Any]) -> list[dict[str, Any]]:
    master = truth.master_error_ppm(unit_degC) * 1e-6
    ratio = (1.0 + master) / (1.0 + truth.af_clock_error_ppm * 1e-6) - 1.0
    return [
        entry("clock_ratio_error", "ppm", ratio.mean() * 1e6, conditions),
        entry("master_clock_error", "ppm", master.mean() * 1e6, conditions),
    ]


def _coefficients(truth: NguTruth, channel: int, kind: str) -> list[dict[str, Any]]:
    conditions = {"channel": channel, "kind": kind, "reference_temperature_degC": REFERENCE_DEGC}
    entries = []
    for side in ("n", "p"):
        tc1, tc2 = truth.tc_ppm(channel, side)
        entries.append(entry(f"dsf_{side}_tc1", "ppm/degC", tc1, conditions))
        entries.append(entry(f"dsf_{side}_tc2", "ppm/degC2", tc2, conditions))
    return entries


def bias_windows(windows: Sequence[RecordWindow]) -> list[RecordWindow]:
    """Return the windows of a bias campaign: on a branch of the temperature, of no single channel."""
    return [w for w in windows if "branch" in w.conditions and "channel" not in w.conditions]


def bias_estimates(truth: NguTruth, windows: Sequence[RecordWindow], unit_lag_s: float) -> list[dict[str, Any]]:
    """Return true values as in the contract, by channel and for the oscillator; ``unit_lag_s`` behind the air.

    ``bias`` is the curve between the branches with the mean of the random walk over the windows; a unit without
    hysteresis has the width 0 and no half-width.
    """
    entries = []
    for number in range(1, len(truth.kinds) + 1):
        lag = entry("thermal_lag", "min", unit_lag_s / 60.0, {"channel": number, "kind": truth.kinds[number - 1]})
        entries += [*_of_channel(truth, number, windows), lag]
    entries += [
        entry("master_clock_error", "ppm", truth.master_error_ppm(degC), {"temperature_degC": degC})
        for degC in TEMPERATURES_DEGC
    ]
    entries += [
        entry(f"master_clock_error_tc{order}", per_degC("ppm", order), truth.master_tc_ppm(order), _REFERENCE)
        for order in range(_ORDERS)
    ]
    return entries


def _of_channel(truth: NguTruth, number: int, windows: Sequence[RecordWindow]) -> list[dict[str, Any]]:
    channel = {"channel": number, "kind": truth.kinds[number - 1]}
    t_s = times_ns(windows) / NS
    entries = [
        entry("bias", "A", truth.bias_A(number, degC, t_s).mean(), {**channel, "temperature_degC": degC})
        for degC in TEMPERATURES_DEGC
    ]
    entries += [
        entry(f"bias_tc{order}", per_degC("A", order), truth.bias_tc_A(number, order), {**channel, **_REFERENCE})
        for order in range(1, _ORDERS)
    ]
    width_A = truth.hysteresis_A[number - 1]
    entries.append(entry("hysteresis_width", "A", width_A, {**channel, **_REFERENCE}))
    if width_A:
        entries.append(entry("play_half_width", "degC", truth.half_width_degC[number - 1], channel))
    return entries


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
