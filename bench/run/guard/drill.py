"""Kill drill: a controller that drives a harmless stimulus is killed, and the bench must be safe within 5 s.

What counts is read back by the drill itself, after the guard has said that it is done; the guard's word is not enough.
"""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from bench.model.clock import NS, Clock, VirtualClock, to_ns, utc_moment, utc_stamp
from bench.model.drivers import driver_class
from bench.model.errors import BenchError, RunError
from bench.model.events import Event
from bench.model.ports import Instrument
from bench.model.posix import DRILL_CONTROLLER, own_process, signals
from bench.plan import Station
from bench.run.bus.beginning import begin_safely, identities_of
from bench.run.bus.opener import open_bench
from bench.run.context import InUse
from bench.run.guard.diary import DIARY, read_diary
from bench.run.guard.drill_controller import stimulate, stimulated
from bench.run.guard.guarding import GuardTask, station_lock
from bench.run.observers import HeldTranscript, new_folder
from bench.run.provenance import lab_of, software
from bench.run.setpoints import drives
from bench.run.stop import CHAMBER_AIR, Health, StopSwitch

SAFE_S = 5.0  # how soon after the kill every output must be off
READ_BACK_S = 4.0  # the drill reads back by then, whatever the guard says
SIGNALS = signals("SIGKILL", "SIGSTOP")
RESULT = "drill.json"
_BEATING_S = 1.2  # a few heartbeats
_END_S = 90.0
_LOOK_S = 0.02


@dataclass(frozen=True)
class Trial:
    """One kill: when the guard was done by its own word and when the drill read back, seconds after the kill.

    ``still_on`` names the outputs that are on by the drill's own read-back.
    """

    kill: str
    guard_s: float | None  # None: it did not say within the drill's time that all is safe
    confirmed_s: float
    still_on: Mapping[str, object]

    @property
    def passed(self) -> bool:
        """Every output off by read-back in time, and the guard done."""
        return self.guard_s is not None and not self.still_on and self.confirmed_s <= SAFE_S


def drill(station: Station, station_path: Path, out: Path, clock: Clock, *, take_over: bool = False) -> dict[str, Any]:
    """Run every trial and write ``drill.json`` into a folder of its own; returns what it holds.

    Raises: InputError B-RUN-092 (the bench is in use), RunError B-RUN-096 (it cannot be brought into the stimulus).
    """
    with station_lock(station, "drill", clock, take_over=take_over):
        pass  # whoever uses the bench is named before anything is begun
    start_ns = clock.utc_ns()
    folder = new_folder(out, f"{utc_stamp(start_ns)}_drill_{station.name}")
    folder.mkdir(parents=True)
    if station.in_process:
        identities, trials = _virtual_drill(station)
    else:
        identities, trials = {}, []
        for number in SIGNALS:
            identities, trial = _trial(station, station_path, folder, number, clock)
            trials.append(trial)
    document = {
        "schema": 1,
        "station": station.name,
        "simulated": station.simulated,
        "utc": utc_moment(start_ns).isoformat(),
        "passed": all(trial.passed for trial in trials),
        "limit_s": SAFE_S,
        "trials": [{**asdict(trial), "passed": trial.passed} for trial in trials],
        "identities": identities,
        "software": software(),
        **lab_of(station),
    }
    (folder / RESULT).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return {**document, "folder": str(folder)}


def latest_drill(out: Path, station: Station) -> dict[str, Any] | None:
    """Return the newest drill of a station in the folder of sessions, passed or not; None if there is none.

    ``utc`` is when it began, in ISO form.
    """
    documents = []
    for path in out.glob(f"*_drill_{station.name}*/{RESULT}"):
        with suppress(OSError, ValueError):
            document = json.loads(path.read_text(encoding="utf-8"))
            if document["station"] == station.name:
                documents.append(document)
    return max(documents, key=lambda document: str(document["utc"]), default=None)


def drill_age(document: Mapping[str, Any], clock: Clock) -> timedelta:
    """Return how long ago a drill was."""
    return utc_moment(clock.utc_ns()) - datetime.fromisoformat(str(document["utc"]))


def _trial(
    station: Station, station_path: Path, folder: Path, number: signal.Signals, clock: Clock
) -> tuple[dict[str, Any], Trial]:
    own = folder / number.name
    own.mkdir()
    with _controller(station_path, own) as (process, said):
        clock.sleep(_BEATING_S)
        killed_ns, killed_utc_ns = clock.now_ns(), clock.utc_ns()
        os.kill(process.pid, number)
        _wait_for(lambda: _guard_s(own, killed_utc_ns)[1], clock, killed_ns + to_ns(READ_BACK_S))
        still_on, confirmed_s = _read_back(station, clock, killed_ns)
        _wait_for(lambda: _guard_s(own, killed_utc_ns)[1], clock, killed_ns + to_ns(_END_S))
    guard_s, _ = _guard_s(own, killed_utc_ns)
    return said["identities"], Trial(number.name, guard_s, confirmed_s, still_on)


@contextmanager
def _controller(station_path: Path, folder: Path) -> Iterator[tuple[subprocess.Popen[str], dict[str, Any]]]:
    """A controller in the stimulus, and what it said. Raises: RunError B-RUN-096."""
    places = [str(station_path.absolute()), str(folder.absolute())]
    command = own_process(DRILL_CONTROLLER, *places)
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            said = json.loads(line) if line else {"error": "it ended without a word"}
            if "error" in said or not said["on"]:
                problem = said.get("error", "no output reads back as on")
                raise RunError(
                    "B-RUN-096",
                    f"the drill could not bring the bench into its stimulus: {problem}",
                    where="drill",
                    next_step="correct this first; nothing was proved",
                )
            yield process, said
        finally:
            with suppress(OSError):
                process.send_signal(signal.SIGCONT)
            if process.stdin is not None:
                with suppress(OSError):
                    process.stdin.close()  # one that was not killed makes the bench safe and ends
            try:
                process.wait(_END_S)
            except subprocess.TimeoutExpired:
                process.kill()


def _wait_for(done: Callable[[], bool], clock: Clock, until_ns: int) -> None:
    while not done() and clock.now_ns() < until_ns:
        clock.sleep(_LOOK_S)


def _guard_s(folder: Path, killed_utc_ns: int) -> tuple[float | None, bool]:
    """Return when the guard had confirmed every instrument, seconds after the kill, and whether it is done."""
    for entry in read_diary(folder / DIARY):
        if entry["what"] in ("safe", "unsafe"):
            after_s = datetime.fromisoformat(entry["utc"]).timestamp() - killed_utc_ns / NS
            return (round(after_s, 3) if entry["what"] == "safe" else None), True
    return None, False


def _read_back(station: Station, clock: Clock, killed_ns: int) -> tuple[dict[str, object], float]:
    """Return what is still on, by sessions of the drill's own, and when that was known."""
    roles = [role for role in station.safe_order if drives(driver_class(station.instruments[role].driver))]
    bench = open_bench(station, clock, HeldTranscript(), seed=0, links=False, roles=roles)
    try:
        still_on = stimulated(bench.instruments)
    except BenchError as error:
        still_on = {"read-back": str(error)}
    finally:
        bench.close()
    return still_on, round((clock.now_ns() - killed_ns) / NS, 3)


@dataclass
class _Bare:
    """As much of a run as the guard's task needs."""

    instruments: dict[str, Instrument]
    clock: Clock
    stop: StopSwitch
    health: Health
    in_use: InUse
    unit_temperature_degC: float = math.nan

    def event(self, event: Event) -> None:
        """Nobody records a drill's events."""


def _virtual_drill(station: Station) -> tuple[dict[str, Any], list[Trial]]:
    """A bench inside this process has the guard's task only: a hard limit is reached while the stimulus is on."""
    clock, stop = VirtualClock(), StopSwitch()
    bench = open_bench(station, clock, HeldTranscript(), seed=1, links=False)
    try:
        identities = identities_of(begin_safely(bench, clock))
        stimulate(bench)
        limits_degC = {CHAMBER_AIR: 0.0, **station.guard_limits_degC}  # any does where the station has none
        run = _Bare(bench.instruments, clock, stop, Health(clock), InUse())
        with GuardTask(run, limits_degC) as guard:
            reached_ns = clock.now_ns()
            run.health.note(CHAMBER_AIR, limits_degC[CHAMBER_AIR])
            guard.look()
            guard_s = None if stop.fault is None else (clock.now_ns() - reached_ns) / NS
        still_on = stimulated(bench.instruments)
        return identities, [Trial("LIMIT", guard_s, (clock.now_ns() - reached_ns) / NS, still_on)]
    finally:
        bench.close()
