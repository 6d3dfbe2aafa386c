"""The bench in Python, stable from version to version: ``import bench; session = bench.load(path)``.

What the command line does, with the same words and the same errors, which are exceptions here (``BenchError`` with
``code``, ``where`` and ``next_step``). ``bench`` hands these names on; what runs and fits is loaded when it is called.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.analysis import estimates_of
from bench.model.errors import BenchError
from bench.tables import Session, table_of_estimates, to_xarray, watch

if TYPE_CHECKING:
    from pandas import DataFrame

    from bench.plan import Summary
    from bench.run.session import Conducted

__all__ = ["BenchError", "Checked", "Fit", "Session", "check", "fit", "load", "run", "to_xarray", "watch"]

Settings = Mapping[str, object]


@dataclass(frozen=True)
class Checked:
    """A sequence in which no mistake was found: its plan in figures, as ``bench check`` prints them."""

    sequence: str
    title: str
    station: str
    simulated: bool
    plan_sha256: str
    summary: Summary


@dataclass(frozen=True)
class Fit:
    """Results of a session by a method: the document results.json, and what a person should know beside it."""

    results: Mapping[str, Any]
    remarks: Sequence[str]

    @cached_property
    def estimates(self) -> DataFrame:
        """Return the estimates as ``Session.estimates``. Raises: InputError B-TAB-001 if pandas is missing."""
        return table_of_estimates(estimates_of(self.results))


def load(path: str | Path) -> Session:
    """Open a recorded session; what it holds is read when it is asked for.

    Raises: InputError B-REC-010 if the folder holds no session; SessionDamaged B-REC-013.
    """
    return Session(path)


def check(sequence: str | Path, station: str | Path | None = None, settings: Settings | None = None) -> Checked:
    """Load, compile and check everything without touching an instrument, as ``bench check``.

    Args:   sequence, station: a file, or the name of a shipped one; the station that the sequence names if None.
            settings: as ``--set``, for example ``{"dwell": "10 s"}``.
    Raises: InputErrors with every mistake; ``str`` of it has a line for each.
    """
    from bench.commands.check import checked_plan, start_utc_ns
    from bench.plan import summarise

    plan = checked_plan(str(sequence), _text(station), _pairs(settings))
    return Checked(
        plan.name, plan.title, plan.station.name, plan.station.simulated, plan.sha256,
        summarise(plan, start_utc_ns(plan)),
    )  # fmt: skip


def fit(path: str | Path, method: str | None = None, *, make_up: Sequence[str | Path] = (), fresh: bool = False) -> Fit:
    """Fit a session, as ``bench fit``; nothing is written into it.

    Args:   method: of the analysis; a wrong one lists them.   make_up: sessions that complete it.
            fresh: compute again what is kept from before.
    Raises: InputError B-REC-010 (no session), B-CLI-008 (no analysis); FitError; SessionDamaged.
    """
    from bench.session.fitted import Fitted

    shown = Fitted(Path(path), method, [Path(other) for other in make_up], fresh=fresh).shown
    return Fit(shown.results, tuple(shown.remarks))


def run(
    sequence: str | Path, station: str | Path | None = None, *, settings: Settings | None = None,
    clock: str | None = None, seed: int = 1, out: str | Path = "sessions", truth: bool = False,
    history: str | None = None, ask: bool = False, uncommissioned: str = "",
) -> Session:  # fmt: skip
    """Run a campaign to its end, as ``bench run``: session, results.json, report.html, a line in the history.

    A verdict that fails is no error: it stands in ``estimates`` of the session.

    Args:   as of ``bench run``; ``settings`` are those of ``--set``.
    Raises: InputErrors before anything is switched on; what ended the run early (RunError, InstrumentError, LinkError,
            OperatorStop), with its session in a note, or that the bench could not be confirmed safe; FitError.
    """
    from rich.console import Console

    from bench.commands import run as run_command
    from bench.commands.requests import RunRequest
    from bench.session.finish import finish
    from bench.session.history import chosen_url

    request = RunRequest(
        str(sequence), _text(station), _pairs(settings), clock, seed, Path(out), truth, json=False, history=history,
        ask=ask, uncommissioned=uncommissioned,
    )  # fmt: skip
    plan, done = run_command.conducted(request, Console(stderr=True, quiet=True))
    if done.outcome.error is None and (view := run_command.view_of(plan, done)).has_analysis:
        finish(done.folder, view, chosen_url(history, Path(out), os.environ))
    _raise_trouble(done)
    return Session(done.folder)


def _raise_trouble(done: Conducted) -> None:
    """Raise what ended a run early, or that its bench is not confirmed safe; all else is told in notes."""
    trouble = [error for error in (done.outcome.error, *done.outcome.unsafe) if error is not None]
    if trouble:
        for other in trouble[1:]:
            trouble[0].add_note(str(other))
        trouble[0].add_note(f"The session is {done.folder}.")
        raise trouble[0]


def _pairs(settings: Settings | None) -> list[str]:
    return [f"{name}={value}" for name, value in (settings or {}).items()]


def _text(name: str | Path | None) -> str | None:
    return None if name is None else str(name)
