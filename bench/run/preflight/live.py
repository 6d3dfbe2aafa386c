"""``bench check --live``: opens what of a bench can be opened, looks at it and leaves everything as it is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from bench.model.clock import Clock
from bench.model.errors import BenchError, InstrumentError
from bench.model.ports import ByteLink, Instrument
from bench.plan import Plan, Station
from bench.run.bench.opener import open_bench, open_instrument, open_port, open_visa
from bench.run.guard.lock import BenchLock, bus_keys
from bench.run.preflight.context import PreflightContext, Surroundings
from bench.run.preflight.finding import Finding, Report, Status
from bench.run.preflight.host import Host
from bench.run.preflight.of_disk import write_speed
from bench.run.preflight.of_links import line_settings, quiet
from bench.run.preflight.survey import ALWAYS, MACHINE, ON_THE_MACHINE, OverdueError, survey, within

OPEN_LIMIT_S = 5.0  # for each instrument and port
SEED = 1  # of a bench that is simulated in this process


def examine(plan: Plan, clock: Clock, out: Path, host: Host | None = None) -> Report:
    """Return everything the pre-flight of a run would find now; no output is switched, nothing is made safe.

    Instruments and ports that another controller uses are not touched: nothing of the bench is opened then.
    """
    context = PreflightContext(
        plan=plan, clock=clock, out=out, instruments={}, links={}, host=Host() if host is None else host
    )
    if plan.station.in_process:
        bench = open_bench(plan.station, clock, _unheard, seed=SEED)
        try:
            return survey(replace(context, instruments=bench.instruments, links=bench.links))
        finally:
            bench.close()
    lock = BenchLock(bus_keys(entry.resource for entry in plan.station.instruments.values()), "check", clock)
    try:
        lock.take()
    except BenchError as error:
        return _untouched(context, error)
    try:
        free = Finding("second controller", Status.OK, "none", "the bench is free")
        with _opened(plan.station, clock) as (instruments, links, absent):
            report = survey(replace(context, instruments=instruments, links=links, absent=absent))
        return Report((free, *report.findings))
    finally:
        lock.release()


def examine_machine(around: Surroundings) -> Report:
    """Return what can be said of a machine without a plan or a bench."""
    return Report(tuple(look(around) for _, look in MACHINE))


def _unheard(role: str, direction: str, text: str, t_mono_ns: int) -> None:
    """There is no session that the traffic could go to."""


def _untouched(context: PreflightContext, error: BenchError) -> Report:
    """Return what can be said about a bench that somebody else is using; not even its disk is kept busy."""
    used = Finding("second controller", Status.FAIL, error.code, "the bench is free", error.message)
    skipped = Finding("instruments and links", Status.SKIPPED, text="not touched while the bench is in use")
    harmless = [check for check in (*ALWAYS, *ON_THE_MACHINE) if not check.on_bus and check.look not in _TOUCHING]
    return Report((used, skipped, *survey(context, harmless).findings))


_TOUCHING = (line_settings, quiet, write_speed)

Opened = tuple[dict[str, Instrument], dict[str, ByteLink], dict[str, BenchError]]


@contextmanager
def _opened(station: Station, clock: Clock) -> Iterator[Opened]:
    """Every instrument and port that opens, and the errors of those that do not."""
    instruments: dict[str, Instrument] = {}
    links: dict[str, ByteLink] = {}
    absent: dict[str, BenchError] = {}
    closers: list[Callable[[], Any]] = []
    try:
        for name, link in station.links.items():
            if link.baud is None:  # read from an instrument: it has no port
                continue
            with _noted(absent, name):
                open_link = partial(open_port, name, str(link.url), link.baud, exclusive=True)
                links[name] = within(OPEN_LIMIT_S, open_link)
                closers.append(links[name].close)
        try:
            visa = open_visa(station.file.visa)
        except BenchError as error:
            absent.update(dict.fromkeys(station.instruments, error))
        else:
            closers.insert(0, visa.close)
            for role, entry in station.instruments.items():
                with _noted(absent, role):
                    instruments[role] = within(
                        OPEN_LIMIT_S, partial(open_instrument, visa, role, entry, clock, _unheard)
                    )
                    closers.append(instruments[role].close)
        yield instruments, links, absent
    finally:
        for close in reversed(closers):
            with suppress(Exception):  # one that is gone already, or hangs, keeps nothing else open
                within(OPEN_LIMIT_S, close)


@contextmanager
def _noted(absent: dict[str, BenchError], name: str) -> Iterator[None]:
    try:
        yield
    except BenchError as error:
        absent[name] = error
    except OverdueError:
        text = f"it does not open within {OPEN_LIMIT_S:g} s"
        absent[name] = InstrumentError("B-RUN-002", text, where=name, next_step="check its address and its power")
