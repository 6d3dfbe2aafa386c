"""``bench history charts``, ``freeze`` and ``adjusted``: whether units, certificates and benches are in control."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

from rich.console import Console

from bench.commands.console import console, print_sorted_json, say
from bench.commands.history.show import named, rows_table
from bench.commands.requests import Place
from bench.maths.control.limits import KINDS
from bench.model.clock import NS, utc_text
from bench.model.errors import ExitStatus, InputError
from bench.store import YEAR_S, Filters, state_calibration
from bench.store import charts as control

_HEADS = ("parameter", "point", "rules", "since", "size", "U 95 %", "unit")


def charts(
    uut: str | None,
    certificates: bool,
    station: str | None,
    campaign: str | None,
    quantity: str | None,
    run_length: float | None,
    plot: Path | None,
    place: Place,
    as_json: bool,
) -> int:
    """Chart a unit, a station or all certificates; exit status 1 if a real one gives a signal."""
    if certificates + (station is not None) + (uut is not None) > 1:
        raise InputError(
            "B-CLI-011",
            "charts are of one unit, of one bench, or of the certificates",
            where="bench history charts",
            next_step="give one of --uut SERIAL, --bench STATION and --certificates",
        )
    url, filters = place.of(), Filters(uut, campaign, quantity)
    if certificates:
        subject = control.chart_certificates(url, filters, run_length)
    elif station is not None:
        subject = control.chart_station(url, station, filters, run_length)
    else:
        subject = control.chart_unit(url, filters, run_length)
    if plot is not None:
        from bench.commands.history.plots import draw_charts  # matplotlib takes longer to load than the charts

        draw_charts(subject, plot)
    if as_json:
        print_sorted_json(subject.as_json())
    else:
        _print(console(), subject)
    signalled = any(series.signals for series in subject.shown)
    return ExitStatus.VERDICT_FAIL if signalled and not subject.simulated else ExitStatus.PASS


def freeze(
    until: datetime,
    by: str,
    reason: str,
    since: datetime | None,
    uut: str | None,
    station: str | None,
    run_length: float,
    place: Place,
    as_json: bool,
) -> None:
    """State the first phase of a unit or a station."""
    subject = ("unit", uut) if station is None else ("station", station)
    days = None if since is None else since.date(), until.date()
    done = control.freeze(place.of(), subject, days, run_length, by, reason)
    if as_json:
        print_sorted_json(done)
    else:
        say(f"{done['name']}: {done['calibrations']} calibrations until {done['until_utc'][:10]}, by {by}")


def adjusted(session: str, state: str, what: str, by: str, place: Place, as_json: bool) -> None:
    """State that a calibration shows its unit before or after an adjustment."""
    done = state_calibration(place.of([session]), named(session), state, what, by)
    if as_json:
        print_sorted_json({"session": done["session"], "state": state, "what": what, "stated_by": by})
    else:
        say(f"{done['session']}: {state.replace('_', ' ')}, {what}")


def _print(out: Console, subject: control.ChartedSubject) -> None:
    together = len(KINDS) * len(subject.series)
    mark = " (SIMULATED)" if subject.simulated else ""
    out.print(
        f"{subject.name}{mark}: {together} charts, one false signal in {subject.run_length:g} points of all together"
    )
    if subject.phase is not None:
        phase = subject.phase
        out.print(
            f"  first phase {phase['from_utc'][:10]} to {phase['until_utc'][:10]}, stated by {phase['stated_by']}: "
            f"{phase['reason']}",
        )
    rows = [row for series in subject.shown for row in _rows(series)]
    if rows:
        out.print(rows_table(f"{len(rows)} points with signals", _HEADS, rows))
    else:
        judged = sum(series.judged for series in subject.shown)
        out.print(f"no signal: {judged} points on {len(subject.shown)} series judged")
    for note in subject.notes:
        out.print(note)


def _rows(series: control.ChartedSeries) -> list[tuple[str, ...]]:
    """Return a line for each point with signals: which rules, since when and how large."""
    rules: dict[int, list[str]] = {}
    changes = {}
    for signal, point, change in series.signals:
        rules.setdefault(point, []).append(signal.kind)
        changes[point] = change
    rows: list[tuple[str, ...]] = []
    for point, kinds in rules.items():
        change, since = changes[point], ("-", "-", "-")
        if change is not None:
            day = utc_text(round(series.t_year[change.since] * YEAR_S * NS))[:10]
            since = (day, f"{change.size:+.3g}", f"{change.expanded:.2g}")
        rows.append((series.label, series.names[point], ", ".join(kinds), *since, series.parameter.unit))
    return rows
