"""A controller that only brings the bench into a harmless stimulus, and waits to be killed (``bench drill``).

The stimulus is the calibrator in operate at 0 A into a closed route: every output that a guard has to take back is on,
and no current flows. Nothing is switched that is not made safe first.
"""

from __future__ import annotations

import json
import select
import sys
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bench.model.clock import Clock, WallClock
from bench.model.drivers import driver_class
from bench.model.errors import BenchError, InputError
from bench.model.ports import Effect, Instrument, Parameter, Tells, actions_of, effects_of
from bench.plan import Station, load_station
from bench.run.bus.beginning import begin_safely
from bench.run.bus.opener import OpenBench, open_bench
from bench.run.bus.safety import make_safe, states_of
from bench.run.guard.diary import DIARY
from bench.run.guard.guarding import brief_of, station_lock
from bench.run.guard.start import GuardProcess
from bench.run.observers import HeldTranscript
from bench.run.setpoints import drives
from bench.run.stop import SEQUENCER, Health, StopSwitch

LEVEL_A = 0.0
_LOOK_S = 0.1


def source_of(station: Station, drivers: dict[str, type]) -> str:
    """Return the role that switches a stimulus on. Raises: InputError B-RUN-095 if the station has none."""
    for role in station.safe_order:
        if Effect.STIMULUS_ON in effects_of(drivers[role]):
            return role
    raise InputError("B-RUN-095", "the station has no instrument that switches a stimulus on", where=station.name)


def has_source(station: Station) -> bool:
    """Return whether there is a stimulus that a drill can switch on."""
    entries = station.instruments.values()
    return any(Effect.STIMULUS_ON in effects_of(driver_class(entry.driver)) for entry in entries)


def stimulate(bench: OpenBench) -> None:
    """Close a route if the bench has one, then switch the source on at 0 A. Raises: InputError B-RUN-095."""
    instruments = bench.instruments
    source = source_of(bench.station, {role: type(instrument) for role, instrument in instruments.items()})
    for instrument in instruments.values():
        _call(instrument, Effect.ROUTE)
    _call(instruments[source], Effect.STIMULUS_SET)
    _call(instruments[source], Effect.STIMULUS_ON)


def _call(instrument: Instrument, effect: Effect) -> None:
    """Call the action of an instrument that has this effect, if there is one, with the least that it demands."""
    for name, action in actions_of(type(instrument)).items():
        if action.effect is effect:
            getattr(instrument, name)(**{each.name: _least(each) for each in action.parameters if each.required})
            return


def _least(parameter: Parameter) -> object:
    """Return 0 A for the level, of anything else the first choice or the lowest value."""
    known = (*parameter.choices, *parameter.values)
    return LEVEL_A if parameter.name == "current" else known[0] if known else parameter.low


def stimulated(instruments: dict[str, Instrument]) -> dict[str, object]:
    """Return what is on by read-back: sources and routes, by what they tell; empty when nothing is."""
    states: dict[str, object] = {}
    for role, instrument in instruments.items():
        tells: Tells | None = getattr(instrument, "tells", None)
        if drives(type(instrument)) and tells is not None:
            for question, is_on in tells.on.items():
                if is_on(reply := instrument.raw(question, answers=True)):  # type: ignore[attr-defined]
                    states[role] = f"on by {question} {reply}"
    return states


def main(station_file: str, folder: str) -> int:
    """Say "on" when the stimulus is on, then beat until the standard input is closed."""
    station, clock, stop = load_station(Path(station_file)), WallClock(), StopSwitch()
    transcript, health = HeldTranscript(), Health(clock)
    stop.live.append(lambda at: health.alive(SEQUENCER, at))
    transcript.on_traffic = stop.is_alive
    with ExitStack() as stack:
        stack.enter_context(station_lock(station, "drill", clock))
        bench = open_bench(station, clock, transcript, seed=0, links=False)
        stack.callback(bench.close)
        identities = begin_safely(bench, clock)
        brief = brief_of(station, Path(folder) / DIARY)
        stack.enter_context(GuardProcess(brief, health, stop, clock, lambda event: None))
        health.begin(station.safe_order)
        stack.callback(
            lambda: health.over(states_of(make_safe(bench.instruments, station.safe_order, clock, live=stop.is_alive)))
        )
        stimulate(bench)
        _say(on=stimulated(bench.instruments), identities={role: asdict(who) for role, who in identities.items()})
        _wait(clock, stop)
    return 0


def _wait(clock: Clock, stop: StopSwitch) -> None:
    while not select.select([sys.stdin], [], [], 0)[0]:
        stop.check()
        clock.sleep(_LOOK_S)


def _say(**fields: Any) -> None:
    sys.stdout.write(json.dumps(fields) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    try:
        sys.exit(main(*sys.argv[1:]))
    except BenchError as problem:
        _say(error=str(problem))
        sys.exit(problem.exit_status)
