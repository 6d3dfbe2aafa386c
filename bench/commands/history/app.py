"""Arguments of ``bench history``; the work is imported when it is asked for."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from bench.commands.requests import AsJson, Campaign, Place, Quantity, Unit, Wanted
from bench.commands.usage import App

app = App(help="Earlier calibrations: drift, agreement, control charts, due dates, approvals, export.")

_LONGEST_DAYS = 365
_DAY = ["%Y-%m-%d"]

Session = Annotated[str, Argument(help="name or folder of a session, or the beginning of its SHA-256")]
Longest = Annotated[int, Option("--max-interval", metavar="DAYS", min=1, max=3653, help="longest interval")]


@app.command("list", work="history.show", epilog="Example: bench history list --uut SIM-1 --quantity dsf_n")
def list_all(wanted: Wanted, place: Place, as_json: AsJson = False) -> None:
    """One line per calibration, in order of time."""


@app.command(work="history.show", epilog="Example: bench history show 20260401T080000Z_scale_factor_38h_A1")
def show(session: Session, place: Place, as_json: AsJson = False) -> None:
    """One calibration: revisions, approvals, standards, every estimate."""


@app.command(work="history.show", epilog="Example: bench history compare --uut SIM-1 --quantity dsf_n --plot drift.svg")
def compare(
    *,
    sessions: Annotated[list[str] | None, Argument(help="two sessions; without them all of a unit")] = None,
    wanted: Wanted,
    plot: Annotated[Path | None, Option(help="draw the clearest drifts as .svg or .png")] = None,
    max_interval: Longest = _LONGEST_DAYS,
    place: Place,
    as_json: AsJson = False,
) -> None:
    """Drift with its interval, E_n, control limits and due date of a unit; or two of its calibrations."""


@app.command(work="history.show", epilog="Example: bench history due --max-interval 730")
def due(*, wanted: Wanted, max_interval: Longest = _LONGEST_DAYS, place: Place, as_json: AsJson = False) -> None:
    """When each unit is due again by its drift; exit status 1 if a real one is overdue."""


@app.command(work="history.show", epilog="Example: bench history export history.csv --uut SIM-1")
def export(
    path: Annotated[Path, Argument(metavar="FILE", help="a .csv or .parquet file")],
    wanted: Wanted,
    place: Place,
    as_json: AsJson = False,
) -> None:
    """Every estimate of every revision, one a row."""


@app.command("import", work="history.entering", epilog="Example: bench history import sessions/*")
def import_sessions(
    *,
    sessions: Annotated[list[Path], Argument(help="folders of sessions")],
    reason: Annotated[str, Option(metavar="TEXT", help="why there is a new revision")] = "",
    place: Place,
    as_json: AsJson = False,
) -> None:
    """Add recorded sessions with their results; one that is known already changes nothing."""


@app.command(
    "approve",
    work="history.show",
    epilog='Example: bench history approve SESSION --by "A. Meyer" --statement "checked and released"',
)
def approve_session(
    session: Session,
    by: Annotated[str, Option(metavar="NAME", help="who approves")],
    statement: Annotated[str, Option(help="what is approved, and for what use")],
    place: Place,
    as_json: AsJson = False,
) -> None:
    """Approve the newest revision of a session; earlier approvals stay."""


@app.command(work="history.charts", epilog="Example: bench history charts --uut SIM-1 --plot charts.svg")
def charts(
    *,
    uut: Unit = None,
    certificates: Annotated[bool, Option("--certificates", help="those of all standards, by all units")] = False,
    station: Annotated[str | None, Option("--bench", metavar="STATION", help="all calibrations on a station")] = None,
    campaign: Campaign = None,
    quantity: Quantity = None,
    run_length: Annotated[
        float | None, Option(min=2.0, help="points to the first false signal; default: as frozen, or 200")
    ] = None,
    plot: Annotated[Path | None, Option(help="draw the charts as .svg or .png")] = None,
    place: Place,
    as_json: AsJson = False,
) -> None:
    """Control charts: Shewhart, EWMA and CUSUM; exit status 1 if a real one signals."""


@app.command(
    work="history.charts",
    epilog='Example: bench history freeze --uut SIM-1 --until 2026-03-31 --by "A. Meyer" --reason "first year"',
)
def freeze(
    *,
    until: Annotated[datetime, Option(formats=_DAY, help="last day of the first phase")],
    by: Annotated[str, Option(metavar="NAME", help="who states it")],
    reason: Annotated[str, Option(metavar="TEXT", help="why this phase, or why a new one")],
    since: Annotated[datetime | None, Option("--from", formats=_DAY, help="first day; default: all")] = None,
    uut: Unit = None,
    station: Annotated[str | None, Option("--bench", metavar="STATION", help="a station instead of a unit")] = None,
    run_length: Annotated[float, Option(help="points to the first false signal")] = 200.0,
    place: Place,
    as_json: AsJson = False,
) -> None:
    """State the first phase of control charts; another statement begins a new one."""


@app.command(
    work="history.charts",
    epilog='Example: bench history adjusted SESSION as_left --what "gain of channel 3" --by "A. Meyer"',
)
def adjusted(
    session: Session,
    state: Annotated[str, Argument(help="as_found (before an adjustment) or as_left (after it)")],
    what: Annotated[str, Option(metavar="TEXT", help="what was adjusted or repaired")],
    by: Annotated[str, Option(metavar="NAME", help="who says so")],
    place: Place,
    as_json: AsJson = False,
) -> None:
    """Mark a calibration as found or as left; drift never crosses an adjustment."""
