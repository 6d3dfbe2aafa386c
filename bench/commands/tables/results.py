"""The result table at the end of a run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from bench.analysis import Analysis
from bench.commands.tables.lead import lead_tables, print_lead_tables
from bench.commands.tables.summary import print_summary
from bench.model.errors import ExitStatus, FitError
from bench.session.finish import Finished

WIDTH = 110
_COLUMNS = (
    "channel", "kind", "set degC", "unit degC", "DSF_N ppm", "DSF_P ppm", "N - P ppm", "U 95 % ppm", "verdict",
)  # fmt: skip
_SCALE_FACTORS = ("dsf_n", "dsf_p", "dsf_asymmetry")
_SEVERITY = ("fail", "conditional_fail", "conditional_pass", "pass")
Group = Mapping[str, Mapping[str, Any]]


def print_results(out: Console, results: Mapping[str, Any], analysis: Analysis) -> None:
    """The results as a table, and what is missing: scale-factor errors per channel and temperature, the tables that an
    analysis wants to be read first, else a summary.

    "unit degC" is the measured temperature the values hold for; the verdict is the worst of what compensation leaves
    over and the change since the previous calibration.
    """
    simulated = " (SIMULATED, not a calibration)" if results["provenance"]["simulated"] else ""
    uut = f"{results['uut']['model']} {results['uut']['serial']}"
    title = f"{results['campaign']} of {uut}{simulated}, method {analysis.method}"
    rows = _rows(results["estimates"])
    lead = lead_tables(analysis.tables)
    if rows:
        _print_scale_factors(out, title, rows)
    elif lead:
        out.print(title, highlight=False)
        print_lead_tables(out, lead)
        _print_verdicts(out, results["estimates"])
    else:
        print_summary(out, title, results["estimates"], _reference_degC(results["estimates"]))
    _print_missing(out, analysis.missing)
    quality = results["quality"]
    if not quality["records"] and not quality["frames"]:
        return  # an imported log has none
    out.print(
        f"{quality['records']} records, {quality['frames']} frames, {quality['frames_bad']} bad, "
        f"{quality['frames_lost']} lost, {quality['retaken']} retaken"
    )


def print_written(finished: Finished, out: Console, errors: Console) -> None:
    """Name the files that were written, then the trouble."""
    for kind, where in finished.written:
        out.print(f"{kind:<8} {where}")
    for text in finished.trouble:
        errors.print(text)


def print_without_results(error: FitError, folder: Path, out: Console, errors: Console) -> int:
    """Tell where a whole session without any result is and what is left to do; return the exit status."""
    errors.print(str(error))
    out.print(
        f"Every step was done, the bench is safe; no result can be computed from {folder}: "
        f"'bench recover {folder}' says which records are not valid and can write a sequence for them"
    )
    return ExitStatus.VERDICT_FAIL


def _print_verdicts(out: Console, estimates: Sequence[Mapping[str, Any]]) -> None:
    counts = Counter(one["verdict"] for one in estimates if one["verdict"] != "none")
    found = ", ".join(f"{counts[name]} {name.replace('_', ' ')}" for name in _SEVERITY if counts[name])
    judged = f"verdicts: {found}; " if found else "nothing is judged; "
    out.print(f"{judged}{len(estimates)} values with their uncertainties in results.json", highlight=False)


def _print_scale_factors(out: Console, title: str, rows: Sequence[tuple[str, ...]]) -> None:
    table = Table(title=title, box=box.SIMPLE, title_justify="left", collapse_padding=True, pad_edge=False)
    for name in _COLUMNS:
        table.add_column(name, justify="left" if name in ("kind", "verdict") else "right", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    out.print(table)


def _reference_degC(estimates: Sequence[Mapping[str, Any]]) -> float | None:
    found = (one["conditions"].get("reference_temperature_degC") for one in estimates)
    return next((value for value in found if value is not None), None)


def _print_missing(out: Console, missing: Sequence[str]) -> None:
    if missing:
        out.print(f"MISSING: {len(missing)} promised without a result", highlight=False)
    for one in missing:
        out.print(f"  {one}", markup=False, highlight=False, width=min(out.width, WIDTH))


def _rows(estimates: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    groups: dict[tuple[int, float], dict[str, Mapping[str, Any]]] = {}
    verdicts: dict[tuple[int, float], set[str]] = {}
    for one in estimates:
        conditions = one["conditions"]
        if conditions.get("channel") is None or conditions.get("temperature_degC") is None:
            continue
        place = conditions["channel"], conditions["temperature_degC"]
        verdicts.setdefault(place, set()).add(one["verdict"])
        if one["quantity"] in _SCALE_FACTORS:
            groups.setdefault(place, {})[one["quantity"]] = one
    return [
        (*_row(*place, found), _worst(verdicts[place]))
        for place, found in groups.items()
        if found.keys() >= set(_SCALE_FACTORS)
    ]


def _row(channel: int, temperature_degC: float, found: Group) -> tuple[str, ...]:
    known = found["dsf_n"]
    measured_degC = known["conditions"].get("unit_temperature_degC")
    return (
        str(channel),
        str(known["conditions"]["kind"]),
        f"{temperature_degC:g}",
        "-" if measured_degC is None else f"{measured_degC:.2f}",
        _value(found["dsf_n"]),
        _value(found["dsf_p"]),
        _value(found["dsf_asymmetry"], 3),
        f"{max(found[name]['expanded_uncertainty'] for name in ('dsf_n', 'dsf_p')):.1f}",
    )


def _worst(verdicts: set[str]) -> str:
    return next((one for one in _SEVERITY if one in verdicts), "none").replace("_", " ")


def _value(estimate: Mapping[str, Any], decimals: int = 2) -> str:
    return f"{estimate['value']:+.{decimals}f}"
