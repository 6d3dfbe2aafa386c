"""Arguments of ``bench history``; the work is imported when it is asked for."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer

from bench.commands.usage import App

app = App(help="Earlier calibrations: drift, agreement, control charts, due dates, approvals, export.")

_LONGEST_DAYS = 365
_DAY = ["%Y-%m-%d"]

History = Annotated[
    str | None,
    typer.Option("--history", metavar="URL", help="sqlite:///FILE or postgresql://...; default: $BENCH_HISTORY"),
]
Out = Annotated[
    Path | None, typer.Option("--out", help="folder of the sessions, with history.sqlite; default: sessions")
]
Unit = Annotated[str | None, typer.Option("--uut", metavar="SERIAL", help="serial number, or 'MODEL SERIAL'")]
Campaign = Annotated[str | None, typer.Option("--campaign", help="such as scale_factor")]
Quantity = Annotated[str | None, typer.Option("--quantity", help="such as dsf_n")]
Session = Annotated[str, typer.Argument(help="name or folder of a session, or the beginning of its SHA-256")]
AsJson = Annotated[bool, typer.Option("--json", help="print one JSON document on standard output and nothing else")]
Longest = Annotated[int, typer.Option("--max-interval", metavar="DAYS", min=1, max=3653, help="longest interval")]


def history_url(history: str | None, out: Path | None) -> str:
    """Return the URL of the history that the options name."""
    from bench.commands.history.show import Place

    return Place(history, out).of()


@app.command("list", epilog="Example: bench history list --uut SIM-1 --quantity dsf_n")
def list_all(
    uut: Unit = None,
    campaign: Campaign = None,
    quantity: Quantity = None,
    history: History = None,
    out: Out = None,
    json: AsJson = False,
) -> int:
    """One line per calibration, in order of time."""
    from bench.commands.history import show as work
    from bench.store import Filters

    return work.list_all(work.Place(history, out), Filters(uut, campaign, quantity), json)


@app.command(epilog="Example: bench history show 20260401T080000Z_scale_factor_38h_A1")
def show(session: Session, history: History = None, out: Out = None, json: AsJson = False) -> int:
    """One calibration: revisions, approvals, standards, every estimate."""
    from bench.commands.history import show as work

    return work.show(work.Place(history, out), session, json)


@app.command(epilog="Example: bench history compare --uut SIM-1 --quantity dsf_n --plot drift.svg")
def compare(
    sessions: Annotated[list[str] | None, typer.Argument(help="two sessions; without them all of a unit")] = None,
    uut: Unit = None,
    campaign: Campaign = None,
    quantity: Quantity = None,
    plot: Annotated[Path | None, typer.Option("--plot", help="draw the clearest drifts as .svg or .png")] = None,
    max_interval: Longest = _LONGEST_DAYS,
    history: History = None,
    out: Out = None,
    json: AsJson = False,
) -> int:
    """Drift with its interval, E_n, control limits and due date of a unit; or two of its calibrations."""
    from bench.commands.history import show as work
    from bench.store import Filters

    filters = Filters(uut, campaign, quantity)
    place = work.Place(history, out)
    return work.compare(place, sessions or [], filters, max_interval, plot, json)


@app.command(epilog="Example: bench history due --max-interval 730")
def due(
    uut: Unit = None,
    campaign: Campaign = None,
    quantity: Quantity = None,
    max_interval: Longest = _LONGEST_DAYS,
    history: History = None,
    out: Out = None,
    json: AsJson = False,
) -> int:
    """When each unit is due again by its drift; exit status 1 if a real one is overdue."""
    from bench.commands.history import show as work
    from bench.store import Filters

    place = work.Place(history, out)
    return work.due(place, Filters(uut, campaign, quantity), max_interval, json)


@app.command(epilog="Example: bench history export history.csv --uut SIM-1")
def export(
    file: Annotated[Path, typer.Argument(help="a .csv or .parquet file")],
    uut: Unit = None,
    campaign: Campaign = None,
    quantity: Quantity = None,
    history: History = None,
    out: Out = None,
    json: AsJson = False,
) -> int:
    """Every estimate of every revision, one a row."""
    from bench.commands.history import show as work
    from bench.store import Filters

    return work.export(work.Place(history, out), file, Filters(uut, campaign, quantity), json)


@app.command("import", epilog="Example: bench history import sessions/*")
def import_sessions(
    sessions: Annotated[list[Path], typer.Argument(help="folders of sessions")],
    reason: Annotated[str, typer.Option("--reason", metavar="TEXT", help="why there is a new revision")] = "",
    history: History = None,
    out: Out = None,
    json: AsJson = False,
) -> int:
    """Add recorded sessions with their results; one that is known already changes nothing."""
    from bench.commands.history import show as work
    from bench.commands.history.entering import import_sessions as add

    return add(work.Place(history, out), sessions, reason, json)


@app.command(epilog='Example: bench history approve SESSION --by "A. Meyer" --statement "checked and released"')
def approve(
    session: Session,
    by: Annotated[str, typer.Option("--by", metavar="NAME", help="who approves")],
    statement: Annotated[str, typer.Option("--statement", help="what is approved, and for what use")],
    history: History = None,
    out: Out = None,
    json: AsJson = False,
) -> int:
    """Approve the newest revision of a session; earlier approvals stay."""
    from bench.commands.history import show as work

    return work.approve_session(work.Place(history, out), session, by, statement, json)


@app.command(epilog="Example: bench history charts --uut SIM-1 --plot charts.svg")
def charts(
    uut: Unit = None,
    certificates: Annotated[bool, typer.Option("--certificates", help="those of all standards, by all units")] = False,
    bench: Annotated[
        str | None, typer.Option("--bench", metavar="STATION", help="all calibrations on a station")
    ] = None,
    campaign: Campaign = None,
    quantity: Quantity = None,
    run_length: Annotated[
        float | None,
        typer.Option("--run-length", min=2.0, help="points to the first false signal; default: as frozen, or 200"),
    ] = None,
    plot: Annotated[Path | None, typer.Option("--plot", help="draw the charts as .svg or .png")] = None,
    history: History = None,
    out: Out = None,
    json: AsJson = False,
) -> int:
    """Control charts: Shewhart, EWMA and CUSUM; exit status 1 if a real one signals."""
    from bench.commands.history import charts as work
    from bench.commands.history.show import Place
    from bench.store import Filters

    return work.charts(
        Place(history, out),
        Filters(uut, campaign, quantity),
        certificates=certificates,
        station=bench,
        run_length=run_length,
        plot=plot,
        as_json=json,
    )


@app.command(
    epilog='Example: bench history freeze --uut SIM-1 --until 2026-03-31 --by "A. Meyer" --reason "first year"'
)
def freeze(
    until: Annotated[datetime, typer.Option("--until", formats=_DAY, help="last day of the first phase")],
    by: Annotated[str, typer.Option("--by", metavar="NAME", help="who states it")],
    reason: Annotated[str, typer.Option("--reason", metavar="TEXT", help="why this phase, or why a new one")],
    since: Annotated[datetime | None, typer.Option("--from", formats=_DAY, help="first day; default: all")] = None,
    uut: Unit = None,
    bench: Annotated[str | None, typer.Option("--bench", metavar="STATION", help="a station instead of a unit")] = None,
    run_length: Annotated[float, typer.Option("--run-length", help="points to the first false signal")] = 200.0,
    history: History = None,
    out: Out = None,
    json: AsJson = False,
) -> int:
    """State the first phase of control charts; another statement begins a new one."""
    from bench.commands.history import charts as work
    from bench.commands.history.show import Place

    subject = ("unit", uut) if bench is None else ("station", bench)
    days = None if since is None else since.date(), until.date()
    return work.freeze_phase(Place(history, out), subject, days, run_length, by, reason, json)


@app.command(epilog='Example: bench history adjusted SESSION as_left --what "gain of channel 3" --by "A. Meyer"')
def adjusted(
    session: Session,
    state: Annotated[str, typer.Argument(help="as_found (before an adjustment) or as_left (after it)")],
    what: Annotated[str, typer.Option("--what", metavar="TEXT", help="what was adjusted or repaired")],
    by: Annotated[str, typer.Option("--by", metavar="NAME", help="who says so")],
    history: History = None,
    out: Out = None,
    json: AsJson = False,
) -> int:
    """Mark a calibration as found or as left; drift never crosses an adjustment."""
    from bench.commands.history import charts as work
    from bench.commands.history.show import Place

    return work.adjusted(Place(history, out), session, state, what, by, json)
