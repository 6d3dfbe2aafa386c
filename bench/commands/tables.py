"""The result table at the end of a run.

Scale-factor errors by channel and temperature; else the tables that an analysis wants to be read first; else channels
down, quantities across, and the rest in lines.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table as TerminalTable
from rich.text import Text

from bench import analysis
from bench.analysis import Analysis, Estimate, doubt_lines, estimates_of, is_sound, limits_of, stated_value
from bench.commands.console import plain_table, warn
from bench.maths.verdict import count_verdicts, passed, verdict_words, worst
from bench.model.errors import BenchError, ExitStatus, InstallationError

if TYPE_CHECKING:
    from bench.report import Table
    from bench.session.finish import Finished
from bench.session.units import UnitFinished

WIDTH = 110
_COLUMNS = (
    "channel", "kind", "set degC", "unit degC", "DSF_N ppm", "DSF_P ppm", "N - P ppm", "U 95 % ppm", "verdict",
)  # fmt: skip
_SCALE_FACTORS = ("dsf_n", "dsf_p", "dsf_asymmetry")
_MOST_ROWS = 24
_NOT_TESTED = "not tested"
_VERDICTS = {"PASS": "green", "FAIL": "bold red", "CONDITIONAL FAIL": "bold red"}
_HOLD = ("\u00a0", "\u202f")  # a log or a terminal without them shows something else
_MOST_COLUMNS = 6
_MOST_LINES = 24
_SMALL_A = 1e-3
_AMPERE = re.compile(r"A(?![A-Za-z])")
_CURVATURES = ("_tc2", "_tc3")


def print_results(out: Console, results: Mapping[str, Any], analysis: Analysis) -> None:
    """The results as a table, and what is missing: scale-factor errors per channel and temperature, the tables that an
    analysis wants to be read first, else a summary.

    "unit degC" is the measured temperature the values hold for; the verdict is the worst of what compensation leaves
    over and the change since the previous calibration.
    """
    simulated = " (SIMULATED, not a calibration)" if results["provenance"]["simulated"] else ""
    uut = f"{results['uut']['model']} {results['uut']['serial']}"
    title = f"{results['campaign']} of {uut}{simulated}, method {analysis.method}"
    entries = estimates_of(results)
    rows = _rows(entries)
    lead = [table for table in analysis.tables if table.lead]
    _print_doubt(out, entries)
    if rows:
        _print_scale_factors(out, title, rows)
    elif lead:
        out.print(title)
        _print_lead_tables(out, lead)
        _print_verdicts(out, entries)
    else:
        print_summary(out, title, entries, _reference_degC(entries))
        if any(limits_of(estimate) is not None for estimate in entries):
            _print_verdicts(out, entries)
    if (not lead or rows) and not results.get("incomplete") and all(limits_of(entry) is None for entry in entries):
        out.print("not judged: no estimate of this campaign has a limit")
    _print_missing(out, analysis.missing)
    quality = results["quality"]
    if not quality["records"] and not quality["frames"]:
        return  # an imported log has none
    out.print(
        f"{quality['records']} records, {quality['frames']} frames, {quality['frames_bad']} bad, "
        f"{quality['frames_lost']} lost, {quality['retaken']} retaken"
    )


def print_finished(finished: Finished, out: Console, as_json: bool = False) -> int:
    """Print the results, as a table or as results.json, and what was written; return the exit status."""
    if as_json:
        sys.stdout.write(analysis.results_json(finished.results))
    else:
        print_results(out, finished.results, finished.analysis)
    print_written(finished, out)
    return verdict_status(finished.results, finished.analysis.missing)


def print_written(finished: Finished, out: Console) -> None:
    """Name the files that were written, then the trouble."""
    for kind, where in finished.written:
        out.print(f"{kind:<8} {where}")
    for text in finished.trouble:
        warn(text)


def print_without_results(error: BenchError, folder: Path, out: Console, left: str) -> int:
    """Tell where a whole session without any result is and what is left to do; return the exit status.

    ``left``: how the bench was left, "" where that is not known.
    """
    warn(error)
    if isinstance(error, InstallationError):
        done = (
            f"the session {folder} is whole: once that is mended, 'bench fit' computes its results and 'bench resume' "
            "writes them"
        )
    else:
        done = (
            f"no result can be computed from {folder}: 'bench recover {folder}' says which records are not valid and "
            "can write a sequence for them"
        )
    out.print(f"{left}Every step was done; {done}")
    return ExitStatus.VERDICT_FAIL


def print_units(outcomes: Sequence[UnitFinished], out: Console) -> int:
    """Tell what came of each unit of a session that several share; returns the worst exit status."""
    statuses = [int(ExitStatus.PASS)]
    for done in outcomes:
        out.print()
        if done.finished is None:
            warn(f"unit {done.serial}: {done.error}")
            statuses.append(ExitStatus.VERDICT_FAIL)
            continue
        statuses.append(print_finished(done.finished, out))
        if done.finished.results.get("incomplete"):
            out.print(f"unit {done.serial} was left out: its report says why and what there is of it")
            statuses.append(ExitStatus.VERDICT_FAIL)
    out.print(f"session  {outcomes[0].folder.parents[1]}")
    return max(statuses)


def verdict_status(results: Mapping[str, Any], missing: Sequence[str]) -> int:
    """Return 1 if a verdict fails or is indeterminate or a result that the records promise is missing, else 0."""
    well = passed(estimate.verdict for estimate in estimates_of(results))
    return ExitStatus.PASS if well and not missing else ExitStatus.VERDICT_FAIL


def _print_verdicts(out: Console, estimates: Sequence[Estimate]) -> None:
    counts = count_verdicts(estimate.verdict for estimate in estimates)
    shown = ", ".join(f"{count} {verdict_words(name)}" for name, count in counts.items())
    judged = f"verdicts: {shown}; " if shown else "not judged; "
    out.print(f"{judged}{len(estimates)} values with their uncertainties in results.json")


def _print_doubt(out: Console, estimates: Sequence[Estimate]) -> None:
    """Say before anything else which estimates are not sound, and why."""
    for line in doubt_lines(estimates):
        out.print(line, style="bold red", width=min(out.width, WIDTH))


def _print_scale_factors(out: Console, title: str, rows: Sequence[tuple[str, ...]]) -> None:
    table = plain_table(title)
    for name in _COLUMNS:
        table.add_column(name, justify="left" if name in ("kind", "verdict") else "right", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    out.print(table)


def _reference_degC(estimates: Sequence[Estimate]) -> float | None:
    temperatures = (estimate.conditions.get("reference_temperature_degC") for estimate in estimates)
    return next((value for value in temperatures if value is not None), None)


def _print_missing(out: Console, missing: Sequence[str]) -> None:
    if missing:
        out.print(f"MISSING: {len(missing)} promised without a result")
    for sentence in missing:
        out.print(f"  {sentence}", width=min(out.width, WIDTH))


def _rows(estimates: Sequence[Estimate]) -> list[tuple[str, ...]]:
    groups: dict[tuple[int, float], dict[str, Estimate]] = {}
    verdicts: dict[tuple[int, float], set[str]] = {}
    for estimate in estimates:
        conditions = estimate.conditions
        if conditions.get("channel") is None or conditions.get("temperature_degC") is None:
            continue
        place = conditions["channel"], conditions["temperature_degC"]
        verdicts.setdefault(place, set()).add(estimate.verdict)
        if estimate.quantity in _SCALE_FACTORS:
            groups.setdefault(place, {})[estimate.quantity] = estimate
    return [
        (*_row(*place, group), _worst(verdicts[place]))
        for place, group in groups.items()
        if group.keys() >= {*_SCALE_FACTORS}
    ]


def _row(channel: int, temperature_degC: float, group: Mapping[str, Estimate]) -> tuple[str, ...]:
    known = group["dsf_n"]
    measured_degC = known.conditions.get("unit_temperature_degC")
    return (
        str(channel),
        str(known.conditions["kind"]),
        f"{temperature_degC:g}",
        "-" if measured_degC is None else f"{measured_degC:.2f}",
        *(("" if is_sound(group[name]) else "?") + number_text(group[name].value, "+.1f") for name in _SCALE_FACTORS),
        number_text(_largest(group[name].expanded_uncertainty for name in ("dsf_n", "dsf_p")), ".1f"),
    )


def number_text(value: float | None, form: str) -> str:
    """Return a number, a dash for none."""
    return "-" if value is None else format(value, form)


def _largest(values: Iterable[float | None]) -> float | None:
    """Return the largest of several uncertainties, None if one of them is not stated."""
    stated = list(values)
    return None if None in stated else max(value for value in stated if value is not None)


def _worst(verdicts: set[str]) -> str:
    return worst(verdicts).replace("_", " ")


def _print_lead_tables(out: Console, tables: Sequence[analysis.Table]) -> None:
    """Print them in their order; rows that end in "not tested" are counted, not shown; the report has them all."""
    from bench.report import analysis_tables

    for described, table in zip(tables, analysis_tables(tables), strict=True):
        rows = [row for row in table.rows if row[-1] != _NOT_TESTED]
        if rows or not table.rows:
            _print_table(out, described.title, table, rows[:_MOST_ROWS])
        _say_left_out(out, described.title, len(table.rows) - len(rows), len(rows) - _MOST_ROWS)


def _say_left_out(out: Console, title: str, not_tested: int, more: int) -> None:
    if not_tested:
        out.print(f"{title}: {not_tested} rows not tested")
    if more > 0:
        out.print(f"{title}: {more} more rows in the report")


def _print_table(out: Console, title: str, table: Table, rows: Sequence[tuple[str, ...]]) -> None:
    shown = plain_table(title)
    for index, text in enumerate(table.headers):
        left = table.prose or index < table.stub
        whole = None if table.prose else max((len(row[index]) for row in rows), default=1)  # a value is not broken
        shown.add_column(_plain(text), justify="left" if left else "right", overflow="fold", min_width=whole)
    for row in rows:
        shown.add_row(*(Text(_plain(text), style=_VERDICTS.get(text, "")) for text in row))
    out.print(shown)


def _plain(text: str) -> str:
    for mark in _HOLD:
        text = text.replace(mark, " ")
    return text


def print_summary(out: Console, title: str, estimates: Sequence[Estimate], reference_degC: float | None) -> None:
    """Estimates that hold for the campaign or its reference temperature: each channel, then those without a channel.

    Currents are in nA; every value stands with its expanded uncertainty. Curvatures are in results.json.
    """
    out.print(title)
    by_quantity: dict[str, dict[Any, Estimate]] = {}
    whole: list[Estimate] = []
    for estimate in estimates:
        conditions = estimate.conditions
        elsewhere = conditions.get("temperature_degC", reference_degC) != reference_degC
        if elsewhere or estimate.quantity.endswith(_CURVATURES):
            continue
        if "channel" not in conditions:
            whole.append(estimate)
        elif "repeat" not in conditions:
            by_quantity.setdefault(estimate.quantity, {}).setdefault(conditions["channel"], estimate)
    if by_quantity:
        out.print(_by_channel(by_quantity))
    for estimate in whole[:_MOST_LINES]:
        judged = [] if limits_of(estimate) is None else [verdict_words(estimate.verdict)]
        where = ", ".join(f"{name} {value}" for name, value in estimate.conditions.items())
        told = "  ".join(part for part in (where, *judged) if part)
        out.print(f"{estimate.quantity:<28} {_value(estimate)} {_unit(estimate)}  {told}".rstrip())
    if len(whole) > _MOST_LINES:
        out.print(f"... and {len(whole) - _MOST_LINES} more in results.json")


def _by_channel(by_quantity: Mapping[str, Mapping[Any, Estimate]]) -> TerminalTable:
    shown = list(by_quantity)[:_MOST_COLUMNS]
    table = plain_table("")
    table.add_column("ch", justify="right", no_wrap=True)
    for quantity in shown:
        unit = _unit(next(iter(by_quantity[quantity].values())))
        table.add_column(f"{quantity.replace('_', chr(10))}\n{unit}", justify="right", no_wrap=True)
    table.add_column("verdict")
    for channel in sorted({channel for by_channel in by_quantity.values() for channel in by_channel}):
        row = [_value(by_quantity[name][channel]) if channel in by_quantity[name] else "-" for name in shown]
        verdicts: set[str] = {
            by_channel[channel].verdict for by_channel in by_quantity.values() if channel in by_channel
        }
        table.add_row(str(channel), *row, _worst(verdicts))
    return table


def _scale(estimate: Estimate) -> float:
    """Return currents of a converter read best in nanoampere; that of a supply does not."""
    return 1e9 if _AMPERE.match(estimate.unit) and abs(estimate.value or 0.0) < _SMALL_A else 1.0


def _value(estimate: Estimate) -> str:
    return stated_value(estimate, _scale(estimate))


def _unit(estimate: Estimate) -> str:
    return ("n" if _scale(estimate) != 1.0 else "") + str(estimate.unit)
