"""Tables of a report: verdicts by class, own coefficients, and the budget."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from bench.analysis import Documents, Table, number, with_uncertainty
from bench.maths.verdict import coverage_factor, verdict

from resistance_thermometer.system.comparison import Comparison, Part
from resistance_thermometer.system.estimators.callendar import NAMES
from resistance_thermometer.system.estimators.iec60751 import CLASSES, IEC_60751

_SEVERITY = ("pass", "conditional_pass", "conditional_fail", "fail")
_TO_PPM = (1.0, 1e6, 1e6, 1e6)


def tables_of(comparisons: Sequence[Comparison], doubts: Sequence[str], rule: str) -> list[Table]:
    """Return all tables: those of the classes, of the coefficients and of doubts, if there are any, are read first."""
    return [_classes(comparisons, rule), _coefficients(comparisons), *_doubts(doubts), _comparisons(comparisons)]


def components_of(comparisons: Sequence[Comparison]) -> Documents:
    """Return the budget of the deviations at the coldest and the hottest point, by the worst thermometer."""
    compared = [comparison for comparison in comparisons if comparison.t_degC.size]
    by_name: dict[str, list[tuple[Part, float, float]]] = {}
    for comparison in compared:
        ends = int(comparison.t_degC.argmin()), int(comparison.t_degC.argmax())
        for part in comparison.parts:
            coldest, hottest = (abs(float(part.std_degC[end])) for end in ends)
            by_name.setdefault(part.name, []).append((part, coldest, hottest))
    return [
        {
            "component": name,
            "evaluation": parts[0][0].evaluation,
            "same_at_all_temperatures": parts[0][0].common,
            "std_uncertainty_coldest_degC": max(coldest for _, coldest, _ in parts),
            "std_uncertainty_hottest_degC": max(hottest for _, _, hottest in parts),
        }
        for name, parts in by_name.items()
    ]


def _doubts(doubts: Sequence[str]) -> list[Table]:
    if not doubts:
        return []
    caption = "What the readings say against what is stated of thermometers, reference and wiring."
    rows = [[count, doubt] for count, doubt in enumerate(doubts, 1)]
    return [Table("Doubts", caption, ["no.", "doubt"], rows, prose=True, lead=True)]


def _classes(comparisons: Sequence[Comparison], rule: str) -> Table:
    rows = []
    for comparison in comparisons:
        stated = comparison.thermometer.tolerance_class
        worst = np.abs(comparison.deviation_degC).argmax() if comparison.deviation_degC.size else None
        largest = "–"
        if worst is not None:
            expanded = coverage_factor() * float(comparison.std_degC[worst])
            largest = with_uncertainty(float(comparison.deviation_degC[worst]), expanded)
            largest += f" at {comparison.setpoint_degC[worst]:g}"
        verdicts = [_worst_verdict(comparison, name, rule).replace("_", " ") for name in CLASSES]
        rows.append([comparison.thermometer.serial, comparison.thermometer.channel, stated, largest, *verdicts])
    caption = (
        "Deviation from IEC 60751: temperature by the nominal curve, less the self-heating, minus that of the "
        f"reference probe. Class A allows 0.15 + 0.002 |t|, class B 0.30 + 0.005 |t|, degC; "
        f"rule of decision: {rule.replace('_', ' ')}."
    )
    headers = ["thermometer", "channel", "stated class", "largest deviation, degC", *(f"class {c}" for c in CLASSES)]
    return Table("Tolerance classes", caption, headers, rows, lead=True)


def _worst_verdict(comparison: Comparison, name: str, rule: str) -> str:
    verdicts = {
        verdict(float(deviation), coverage_factor() * float(std), CLASSES[name].degC(float(t_degC)), rule)
        for deviation, std, t_degC in zip(
            comparison.deviation_degC, comparison.std_degC, comparison.t_degC, strict=True
        )
    }
    return max(verdicts, key=_SEVERITY.index, default="none")


def _coefficients(comparisons: Sequence[Comparison]) -> Table:
    rows = []
    for comparison in comparisons:
        fit, cells = comparison.fit, ["–"] * len(NAMES)
        if fit is not None and not comparison.refused:
            scaled = zip(fit.values, fit.std, _TO_PPM, strict=False)
            cells[: fit.values.size] = [with_uncertainty(f * v, coverage_factor() * f * s) for v, s, f in scaled]
            cells[fit.values.size :] = [number(1e6 * IEC_60751.c) + " (held)"] * (len(NAMES) - fit.values.size)
        quality = ["–", "–"] if fit is None else [f"{fit.chi2:.2f} / {fit.dof}", f"{fit.probability:.2g}"]
        rows.append([comparison.thermometer.serial, *cells, *quality])
    standard = (number(1e6 * IEC_60751.a, 1), number(1e6 * IEC_60751.b, 4), number(1e6 * IEC_60751.c))
    rows.append(["IEC 60751", "100", *standard, "", ""])
    caption = "Callendar-Van Dusen equation of each thermometer, intervals of 95 %; improbable: it does not hold."
    headers = [
        "thermometer", "R0 / ohm", "a / ppm/°C", "b / ppm/°C²", "c / ppm/°C⁴", "chi-square / dof", "probability",
    ]  # fmt: skip
    return Table("Coefficients", caption, headers, rows, lead=True)


def _comparisons(comparisons: Sequence[Comparison]) -> Table:
    rows = [row for comparison in comparisons for row in _rows(comparison)]
    headers = [
        "thermometer", "set-point, degC", "reference, degC", "resistance / ohm", "deviation, degC", "limit, degC",
        "readings",
    ]  # fmt: skip
    caption = "Each thermometer beside the reference probe; limits are those of its stated class."
    return Table("Comparison with the reference probe", caption, headers, rows)


def _rows(comparison: Comparison) -> list[list[Any]]:
    tolerance, expanded = comparison.thermometer.tolerance, coverage_factor() * comparison.std_degC
    columns = (comparison.setpoint_degC, comparison.t_degC, comparison.resistance_ohm, comparison.deviation_degC)
    return [
        [
            comparison.thermometer.serial, number(setpoint), number(t_degC, 3), number(ohm, 4),
            with_uncertainty(deviation, reach), number(tolerance.degC(t_degC), 3), n,
        ]
        for setpoint, t_degC, ohm, deviation, reach, n in zip(
            *(column.tolist() for column in columns), expanded.tolist(), comparison.n, strict=True
        )
    ]  # fmt: skip
