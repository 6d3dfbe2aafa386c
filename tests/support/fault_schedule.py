"""Timed lists of faults for a world: written down by hand, or drawn from a seed."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bench.model.clock import NS
from sim_instruments.faults.fault import Value
from sim_instruments.faults.named import OFF
from sim_instruments.seeds import generator
from sim_instruments.worlds.common.world import World
from sim_instruments.worlds.simulation import possible_faults

MEAN_INTERVAL_S = 900.0


@dataclass(frozen=True)
class TimedFault:
    """One fault ``at_s`` seconds after the schedule began; switched off after ``for_s`` seconds, 0 = never."""

    at_s: float
    name: str
    target: str = ""
    values: tuple[Value, ...] = ()
    for_s: float = 0.0


def schedule(world: World, entries: Iterable[TimedFault]) -> None:
    """Let the world switch these faults at their times from now on.

    Raises: nothing now; a fault the world does not know raises InputError when it is due, in who advances the clock.
    """
    actions: list[tuple[float, Callable[[], None]]] = []
    for entry in entries:
        target = [entry.target] if entry.target else []
        actions.append((entry.at_s, _switching(world, entry.name, *target, *entry.values)))
        if entry.for_s > 0:
            actions.append((entry.at_s + entry.for_s, _switching(world, entry.name, *target, OFF)))
    actions.sort(key=lambda action: action[0])
    _arm(world, world.clock.now_ns(), actions, 0)


def _switching(world: World, name: str, *words: Value) -> Callable[[], None]:
    return lambda: world.switches.switch(name, *words)  # type: ignore[arg-type]


def _arm(world: World, began_ns: int, actions: Sequence[tuple[float, Callable[[], None]]], number: int) -> None:
    """Wait for one action only, however long the list is."""
    if number == len(actions):
        return
    at_s, act = actions[number]

    def fire() -> None:
        _arm(world, began_ns, actions, number + 1)
        act()

    world.after(at_s - (world.clock.now_ns() - began_ns) / NS, fire)


Draw = Callable[[np.random.Generator], tuple[tuple[Value, ...], float]]


def _for(low_s: float, high_s: float, *values: Value) -> Draw:
    return lambda rng: (values, float(rng.uniform(low_s, high_s)))


def _rate(low: float, high: float) -> Draw:
    """A rate, each decade as likely as another, for a minute to a quarter of an hour."""
    return lambda rng: ((float(np.exp(rng.uniform(np.log(low), np.log(high)))),), float(rng.uniform(60.0, 900.0)))


def _count(*before: Value) -> Draw:
    return lambda rng: ((*before, int(rng.integers(1, 4))), 0.0)


def _once(_: np.random.Generator) -> tuple[tuple[Value, ...], float]:
    return (), 0.0


def _amount(low: float, high: float, low_s: float, high_s: float) -> Draw:
    return lambda rng: ((float(rng.uniform(low, high)),), float(rng.uniform(low_s, high_s)))


def _late(rng: np.random.Generator) -> tuple[tuple[Value, ...], float]:
    return (float(rng.uniform(0.5, 8.0)), int(rng.integers(1, 4))), 0.0


DRAWS: Mapping[str, Draw] = {
    "bit_errors": _rate(1e-6, 1e-3),
    "drop": _rate(1e-3, 5e-2),
    "duplicate": _rate(1e-3, 5e-2),
    "silent": _for(0.5, 30.0),
    "unplug": _for(1.0, 20.0),
    "stuck": _for(1.0, 20.0, "55"),
    "mute": _for(1.0, 20.0),
    "late": _late,
    "garbled": _count(),
    "identity": _for(10.0, 60.0, "ACME,42,0,0"),
    "nan": _count(),
    "overload": _count(),
    "hang": _for(1.0, 20.0),
    "trip": _once,
    "calibrator_drops": _once,
    "chamber_runaway": _amount(0.5, 3.0, 60.0, 600.0),
    "chamber_shortfall": _amount(0.5, 5.0, 600.0, 3600.0),
    "reference_lost": _for(60.0, 600.0),
    "unit_restart": _once,
}  # replug is the end of unplug; the benches these schedules are for have no table


def random_schedule(
    seed: int,
    duration_s: float,
    roles: Sequence[str],
    links: Sequence[str],
    mean_interval_s: float = MEAN_INTERVAL_S,
    kinds: Collection[str] = tuple(DRAWS),
) -> list[TimedFault]:
    """Faults of these kinds at random times of a campaign, in order of time; the same for the same arguments.

    The number is Poisson's with mean ``duration_s / mean_interval_s``; every kind is equally likely, rates and lengths
    are such as a bad day on a real bench has them. Two of a kind on one target may overlap.
    """
    rng = generator(seed, "fault schedule")
    at_s = np.sort(rng.uniform(0.0, duration_s, rng.poisson(duration_s / mean_interval_s)))
    names, faults = sorted(kinds), possible_faults()
    entries = []
    for moment_s in at_s:
        name = names[int(rng.integers(len(names)))]
        known = {"link": links, "role": roles}.get(faults[name].target, ("",))
        target = known[int(rng.integers(len(known)))]
        values, for_s = DRAWS[name](rng)
        entries.append(TimedFault(float(moment_s), name, target, values, for_s))
    return entries
