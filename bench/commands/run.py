"""``bench run``: from the words of the command line to results.json and report.html."""

from __future__ import annotations

import json
import os

from rich.console import Console

from bench.commands.check import checked_plan
from bench.commands.conducting import conduct_watched, ended, wall_clock
from bench.commands.console import console
from bench.commands.requests import RunRequest
from bench.model.clock import Clock, VirtualClock
from bench.model.errors import InputError
from bench.model.events import event_of
from bench.plan import Plan
from bench.run.session import Conducted, texts_of
from bench.session.history import check_history_url, chosen_url
from bench.session.output import make_folder, write_file
from bench.session.view import SessionView


def run(request: RunRequest) -> int:
    """Run a campaign and return the exit status of the contract."""
    plan, done = conducted(request, console(stderr=True))
    left = f"{len(done.outcome.rows)} of {plan.record_count} records are in {done.folder}"
    url = chosen_url(request.history, request.out, os.environ)
    return ended(done, lambda: view_of(plan, done), left, url, request.json)


def conducted(request: RunRequest, errors: Console) -> tuple[Plan, Conducted]:
    """Run a campaign to its end and write simulated truth if it is asked for; a person is told on ``errors``.

    Raises: InputErrors, before anything is switched on; what ends a run early is part of what is returned.
    """
    if request.clock not in (None, "virtual", "wall"):
        raise InputError(
            "B-CLI-004", f"{request.clock!r} is no clock", where="--clock", next_step="use virtual or wall"
        )
    plan = checked_plan(request.sequence, request.station, request.settings)
    check_history_url(chosen_url(request.history, request.out, os.environ))
    virtual = plan.station.in_process if request.clock is None else request.clock == "virtual"
    clock: Clock = VirtualClock() if virtual else wall_clock()
    make_folder(request.out)
    done = conduct_watched(
        plan, clock, seed=request.seed, out=request.out, errors=errors, ask=request.ask,
        uncommissioned=request.uncommissioned,
    )  # fmt: skip
    if request.truth and done.truth:
        path = done.folder.with_name(done.folder.name + ".truth.json")
        write_file(path, json.dumps({"estimates": done.truth}, sort_keys=True, indent=1) + "\n")
    return plan, done


def view_of(plan: Plan, done: Conducted) -> SessionView:
    """Return what the run itself knows about its session."""
    return SessionView(
        manifest=done.manifest,
        rows=done.outcome.rows,
        counts=done.counts,
        session_sha256=done.session_sha256,
        plan_steps=plan.steps,
        events=[(t_ns, event_of(kind, fields)) for kind, t_ns, fields in done.events],
        texts=texts_of(plan, done.manifest),
        utc_offset_ns=done.utc_offset_ns,
    )
