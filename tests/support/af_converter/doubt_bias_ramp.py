"""Wrong worlds of a bias ramp: what the model says of unit, chamber or sensor is not so.

Heat, slack, walk and whole pulses are those of ``bias_simulation``; nothing of the product makes them. The wrong part
is a charge beside that of the right world of the same seed.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import bias_simulation as sim
import numpy as np
from doubt_classes import PROVENANCE, Seen, Switch, changed

from bench.analysis import Material, Trace, build_results, estimates_of
from bench.model.errors import FitError
from bench.systems.af_converter.bias_ramp.analysis import analyse

SYSTEM = "bias_ramp"
CHANNEL = 1
_LAG_s = 1500.0
_PROMISED = 7
_HALVES = (0.4, 1.5, 3.5)  # of three operators, in parts of the half-width
Array = np.ndarray


@dataclass(frozen=True)
class Course:
    """Hold what a world adds to the right one: hours since the first window, temperatures every 2 s, and the unit.

    ``length_h``: of all windows.
    """

    hours: Array
    length_h: float
    air_degC: Array
    unit_degC: Array
    unit: sim.Unit


@dataclass(frozen=True)
class World:
    """A right world; a wrong one adds a current. ``size``: by how much, of the width of the loop where not said."""

    size: float = 0.0

    def added_A(self, at: Course) -> Array:
        """Return the wrong part of the bias at every step."""
        return np.zeros_like(at.hours)

    def shown_degC(self, unit_degC: Array) -> Array:
        """Return what the unit's own sensor shows."""
        return unit_degC


def _loop(at: Course, parts: tuple[float, ...]) -> Array:
    """Half the loop of play operators of equal widths, their half-widths in parts of the unit's."""
    found = np.zeros_like(at.hours)
    for part in parts:
        half = part * at.unit.half_width_degC
        found += (sim.slack(at.unit_degC, half) - at.unit_degC) / (2.0 * half * len(parts))
    return at.unit.width_A * found


def current(added_A: Callable[[World, Course], Array]) -> type[World]:
    """The bias has this part besides."""
    return changed(World, added_A=added_A)


def many_plays_A(w: World, at: Course) -> Array:
    """A share of the loop has half-widths from 0.15 to 5 times as wide, fewer the wider."""
    wide = np.geomspace(0.15, 5.0, 12)
    weights = np.exp(-wide / 1.5)
    spread = sum(weight * _loop(at, (times,)) for weight, times in zip(weights / weights.sum(), wide, strict=True))
    return w.size * (spread - _loop(at, (1.0,)))


def of_loop(part: Callable[[Course], Array]) -> type[World]:
    """The bias has this part of the width of its loop besides."""
    return current(lambda w, at: w.size * at.unit.width_A * part(at))


def of_slope(part: Callable[[Course], Array]) -> type[World]:
    """The bias has this part of its slope besides, of degrees."""
    return current(lambda w, at: w.size * at.unit.polynomial[1] * part(at))


def _switch(name: str, world: type[World], largest: float = 1.0) -> Switch:
    return Switch(name, world, (0.01, 0.1, largest), "shape_of_the_bias")


SWITCHES = (
    # a share of the loop is that of operators of other half-widths
    _switch("several_plays", current(lambda w, at: w.size * (_loop(at, _HALVES) - _loop(at, (1.0,))))),
    _switch("many_plays", current(many_plays_A)),
    # a share of the bias follows the air within 150 min
    _switch("second_lag", of_slope(lambda at: sim.follow(at.air_degC, 9000.0) - at.unit_degC), 0.5),
    _switch("step_of_bias", of_loop(lambda at: at.hours > 0.6 * at.length_h)),
    _switch("drift_of_bias", of_loop(lambda at: (at.hours - at.length_h / 2.0) / 25.0)),  # within 25 hours
    _switch(
        "width_over_temperature",
        current(lambda w, at: w.size * (at.unit_degC - sim.REFERENCE_degC) / 30.0 * _loop(at, (1.0,))),
    ),
    _switch("bend", of_slope(lambda at: np.maximum(at.unit_degC - 30.0, 0.0))),  # another slope from 30 degC on
    # the bias follows the hour of the day, as mains or sunlight may make it
    _switch("daily_rhythm", of_loop(lambda at: np.sin(2.0 * np.pi * at.hours / 24.0))),
    # after each turn a part of the loop is lost within three hours
    _switch(
        "relaxation", current(lambda w, at: w.size * (sim.follow(_loop(at, (1.0,)), 10_800.0) - _loop(at, (1.0,))))
    ),
    # the unit's own sensor errs by a share of its distance from 20 degC
    Switch(
        "sensor_scale",
        changed(World, shown_degC=lambda w, unit_degC: unit_degC + w.size * (unit_degC - sim.REFERENCE_degC)),
        (1e-3, 1e-2, 1e-1),
        "temperature_sensor_gain",
    ),
)


def seen(seed: int, switch: Switch | None, size: float, *, noise_free: bool = False) -> Seen:
    """Return what one ramp states and its truth; without a switch that of the same seed in a right world."""
    world = World() if switch is None else switch.world(size)
    ramp = _ramp(seed, world, noise_free=noise_free)
    trace = Trace(ramp.trace_t_s, ramp.air_degC, world.shown_degC(ramp.sensor_degC))
    shown = replace(ramp, sensor_degC=trace.unit_degC)
    material = Material(sim.rows({CHANNEL: shown}), sim.campaign({CHANNEL: shown}), {"generator": {}}, trace)
    try:
        analysis = analyse(material)
    except FitError:
        return Seen([], [], np.inf, _PROMISED)
    document = build_results("doubt", analysis, {"records": len(ramp.start_s)}, PROVENANCE)
    pairs = [(entry, _truth(entry, ramp)) for entry in estimates_of(document)]
    known = [(entry, truth) for entry, truth in pairs if truth is not None]
    chi2 = sum(group["reduced_chi2"] * group["dof"] for group in analysis.groups)
    return Seen([entry for entry, _ in known], [truth for _, truth in known], chi2, _PROMISED)


def _ramp(seed: int, world: World, *, noise_free: bool) -> sim.Ramp:
    heat, unit = sim.heat(_LAG_s), sim.draw(np.random.default_rng([seed, 1]), "gyro")
    hours = (heat.t_s - heat.t_s[heat.windows[0]]) / 3600.0
    course = Course(hours, float(hours[heat.windows[-1]]), heat.air_degC, heat.unit_degC, unit)
    return sim.ramp(seed, unit=unit, noise=not noise_free, quantised=not noise_free, added_A=world.added_A(course))


def _truth(entry: Any, ramp: sim.Ramp) -> float | None:
    """Truth of an estimate: the centre of the loop over the temperature of the unit, and its full width."""
    about, quantity = entry.conditions, entry.quantity
    if about.get("channel") != CHANNEL:
        return None
    truths = {f"bias_tc{order}": ramp.truth(order) for order in (1, 2, 3)}
    truths |= {"thermal_lag": _LAG_s / 60.0, "play_half_width": ramp.unit.half_width_degC}
    if "reference_temperature_degC" in about:
        truths["hysteresis_width"] = ramp.unit.width_A
    if about.get("temperature_degC") == sim.REFERENCE_degC:
        truths["bias"] = ramp.truth(0)
    return truths.get(quantity)
