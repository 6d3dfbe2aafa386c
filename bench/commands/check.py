"""``bench check``: from the words of the command line to a checked plan, without touching an instrument; with
``--live`` the bench is looked at, too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from bench.commands.console import console, print_json, say_origins
from bench.commands.requests import CheckRequest
from bench.frame import Pace, pace_of
from bench.model.clock import NS, VIRTUAL_START_UTC_NS, WallClock
from bench.model.errors import InputError, InputErrors
from bench.model.lab import find_shipped
from bench.model.stopping import UNTIL
from bench.model.systems import assumptions_of, declared_by
from bench.model.units import hours
from bench.plan import Plan, PlannedSoak, Summary, check_plan, compile_sequence, decisions_of, load_station, summarise
from bench.session.output import writing

if TYPE_CHECKING:
    from bench.run.preflight import Report


def check(request: CheckRequest) -> None:
    """Check a sequence; print steps, duration, finish time, disk use and hazards; draw the timetable if asked.

    Raises: InputErrors; with ``live``, after the table, InputError B-RUN-080 or InstrumentError B-RUN-081.
    """
    plan = checked_plan(request.sequence, request.station, request.settings)
    summary = summarise(plan, start_utc_ns(plan))
    if request.plot is not None:
        from bench.report import plots  # matplotlib takes longer to load than a sequence to check

        with writing(request.plot):
            plots.plot_timetable(plan, request.plot)
    decoding = {link: pace_of(frame, WallClock()) for link, frame in sorted(plan.definitions().items())}
    report = _examined(plan, request) if request.live else None
    told, lines = _predicted(plan, request.predict)
    if request.json:
        document = {"sequence": plan.name, "station": plan.station.name, "plan_sha256": plan.sha256, **asdict(summary)}
        document["decoding"] = {link: asdict(pace) for link, pace in decoding.items()}
        document["assumptions"] = [asdict(taken) for taken in assumptions_of(plan.campaign)]
        document |= {name: plan.campaign[name] for name in ("expected", "fits") if name in plan.campaign}
        document["predicted"] = told
        live = {} if report is None else {"preflight": report.event().document()}
        print_json({**document, **live})
    else:
        _print(console(), plan, summary, decoding, request.plot, report, lines)
    if report is not None and (refusal := report.refusal()) is not None:
        raise refusal


def start_utc_ns(plan: Plan) -> int:
    """Return UTC at which a run would start, ns: now, or where the virtual clock begins."""
    return VIRTUAL_START_UTC_NS if plan.station.in_process else WallClock().utc_ns()


def _examined(plan: Plan, request: CheckRequest) -> Report:
    from bench.run.preflight import (
        examine,  # a whole room of the house: loading it takes longer than the check of a sequence
    )

    return examine(plan, WallClock(), request.out, uncommissioned=request.uncommissioned)


def _print(out: Console, plan: Plan, summary: Summary, decoding: Mapping[str, Pace], plot: Path | None,
           report: Report | None, predicted: Sequence[str]) -> None:  # fmt: skip
    finish = datetime.fromtimestamp(summary.finish_utc_ns / NS, UTC).strftime("%Y-%m-%d %H:%M:%SZ")
    out.print(f"{plan.name}: {plan.title}")
    out.print(f"  station      {plan.station.name}{' (simulated)' if plan.station.simulated else ''}")
    out.print(f"  steps        {summary.steps}, {summary.records} records")
    for unit in plan.units:
        out.print(f"  unit         {unit.serial} in slot {unit.slot}")
    out.print(f"  preparation  {hours(summary.prepare_s)}")
    out.print(f"  campaign     {hours(summary.duration_s)} = {summary.duration_s:.0f} s")
    out.print(f"  afterwards   {hours(summary.finally_s)}")
    out.print(f"  finish       {finish} if started {'at the virtual start' if plan.station.in_process else 'now'}")
    if decisions := sum(decision.word != UNTIL for decision in decisions_of(plan.steps)):
        out.print(f"  decisions    {decisions}: steps and records are those of all branches, times of the longest way")
    if any(isinstance(step, PlannedSoak) and step.least_s is not None for step in plan.steps):
        out.print("  soaks        times are the longest: the lag of the unit may end soaks before their slots are over")
    out.print(f"  disk         at most {summary.disk_bytes / 1e6:.0f} MB")
    for link, pace in decoding.items():
        out.print(f"  decoding     {link}: {pace}")
    for sentence in summary.stops:
        out.print(f"  stop rule    {sentence}")
    for hazard in summary.hazards:
        out.print(f"  hazard       {hazard}")
    for sentence in (*summary.unwatched, *summary.slips):
        out.print(f"  warning      {sentence}")
    if plot is not None:
        out.print(f"  timetable    {plot}")
    for taken in assumptions_of(plan.campaign):
        out.print(f"  unseen       {taken.taken_for_granted} {taken.unseen} {taken.shown_by}")
    if plan.campaign.get("expected"):
        _print_expected(out, plan)
    for line in predicted:
        out.print(f"  predicted    {line}")
    out.print("no mistake found")
    if report is not None:
        from bench.commands.doctor import print_preflight

        print_preflight(out, report)


def _print_expected(out: Console, plan: Plan) -> None:
    from bench.session.judged import judged_lines, not_judged  # brings the analysis, which most checks need not

    for line in judged_lines(plan):
        out.print(f"  expected     {line}")
    if not_judged(plan.campaign):
        out.print("  not judged   no value and no fit has a limit; write 'expect' beside a reading")


def _predicted(plan: Plan, however_long: bool) -> tuple[dict[str, Any] | None, list[str]]:
    """Return what is predicted of a plan, for JSON and as lines; None where nothing is, or where that takes long."""
    declared = declared_by(plan.campaign)
    if declared is None or not declared.predicted:
        return None, []
    if declared.predicts_long and not however_long:
        return None, ["takes much longer than a check; --predict asks for it"]
    from bench.session.predicted import predicted, predicted_document, predicted_lines  # brings the analysis

    prediction = predicted(plan, start_utc_ns(plan) / NS)
    return predicted_document(plan, prediction), list(predicted_lines(plan, prediction))


def settings_of(pairs: Sequence[str]) -> dict[str, str]:
    """Return ``["key=value"]`` as a dictionary. Raises InputError B-CLI-001."""
    settings = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals or not key:
            raise InputError(
                "B-CLI-001", f"{pair!r} is not KEY=VALUE", where="--set", next_step="for example --set dwell='10 s'"
            )
        settings[key.strip()] = value.strip()
    return settings


def checked_plan(sequence: str, station: str | None, settings: Sequence[str] | None = None) -> Plan:
    """Compile and check a sequence. Raises InputErrors with every mistake."""
    bench = None if station is None else load_station(find_shipped("stations", station))
    plan = compile_sequence(find_shipped("sequences", sequence), bench, settings_of(settings or ()))
    say_origins(plan.files)
    if mistakes := check_plan(plan, plan.station):
        raise InputErrors(mistakes)
    return plan
