"""``bench resume``: go on with a run that was stopped, from its own plan, and compute the results from the session."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from bench.commands.conducting import conduct_watched, ended, tell_results, wall_clock
from bench.commands.console import console, named_file
from bench.commands.control import release
from bench.model.clock import Clock, VirtualClock
from bench.model.errors import ExitStatus, InputError
from bench.model.events import Resume
from bench.plan import Plan, compile_sequence
from bench.run.guard.guarding import station_lock
from bench.run.guard.last_words import guard_lines
from bench.run.resume import Stopped, changed_files, read_stopped, resumption, same_plan
from bench.session.history import check_history_url, chosen_url
from bench.session.service import read_view

ENDED = "B-RES-001"
BEGUN = "the run that is gone on with had begun so"
RESULTS = ("results.json", "report.html")  # a run that was killed behind its last step may lack them
WARM_UP_S = 600.0  # a calibrator that was off for longer is not warm any more


def resume(folder: Path, sequence: str | None, history: str | None, as_json: bool, *, take_over: bool = False) -> int:
    """Go on with a session and return the exit status of the contract; a living run that was paused only goes on.

    ``take_over``: the bench is taken from a guard that still tries to make it safe.
    """
    if release(folder):
        return ExitStatus.PASS
    out = console(stderr=True)
    url = chosen_url(history, folder.parent, os.environ)
    check_history_url(url)
    try:
        stopped = read_stopped(folder)
    except InputError as error:
        if error.code != ENDED or all((folder / name).is_file() for name in RESULTS):
            raise
        return tell_results(read_view(folder, of_several=True), folder, url, as_json)
    for line in guard_lines(folder):
        out.print(line)
    plan = stopped.plan if sequence is None else _given(stopped, sequence)
    clock = _clock(stopped)
    resumed = resumption(stopped, clock.utc_ns())
    _tell(stopped, plan, resumed.event, out)
    with station_lock(plan.station, "resume", clock, take_over=take_over):
        pass
    seed = int(stopped.manifest.get("seed") or 0)
    done = conduct_watched(plan, clock, seed=seed, out=folder.parent, errors=out, resumed=resumed, uncommissioned=BEGUN)
    left = f"{done.folder} can be gone on with: bench resume {done.folder}"
    # memory knows its last part only
    return ended(done, lambda: read_view(done.folder, of_several=True), left, url, as_json)


def _given(stopped: Stopped, sequence: str) -> Plan:
    """Return the frozen plan, if the sequence that was named is the same; its files are the ones to compare with."""
    path = named_file("sequences", sequence)
    given = compile_sequence(path, stopped.plan.station, dict(stopped.manifest.get("settings", {})))
    same_plan(stopped.plan, given, str(path))
    files = {name: place for name, place in given.files.items() if not name.startswith("stations/")}
    return replace(stopped.plan, files={**stopped.plan.files, **files})


def _clock(stopped: Stopped) -> Clock:
    """Virtual time goes on where the session ends."""
    if stopped.manifest.get("clock") != "virtual":
        return wall_clock()
    clock = VirtualClock()
    clock.sleep_until_ns(stopped.last_ns)
    return clock


def _tell(stopped: Stopped, plan: Plan, event: Resume, out: Console) -> None:
    away_s, back_s = event.away_s, event.utc_back_s
    away = " an unknown time ago" if away_s is None else f" {away_s:.0f} s ago"
    out.print(f"stopped{away} ({stopped.reason}); going on at step {event.start} of {len(plan.steps)}")
    if away_s is None:
        why = "UTC of the stop is not recorded" if back_s is None else f"UTC is {back_s:.0f} s behind what was recorded"
        out.print(f"{why}: times go on right behind it; a result that depends on the time away will be doubtful")
    for place in stopped.damage:
        out.print(f"damaged: {place}")
    for name, change in changed_files(plan.files, plan.texts).items():
        out.print(f"{name} is {change} on the disk; the session's own copy is gone on with")
    if not plan.station.simulated and (away_s is None or away_s > WARM_UP_S):
        out.print("prompts are not asked again: if the calibrator was off, stop now and let it warm up first")
