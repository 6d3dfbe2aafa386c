"""What a sequence expects of its values, whatever its analysis is: an estimate of each with its verdict, and doubt.

Source: JCGM 100:2008 sections 4.2, 4.3 and 5.1 (type A, type B, both together); docs/method-uncertainty.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from bench.analysis.doubt import CERTAIN, Evidence
from bench.analysis.estimates import Estimates, estimate
from bench.analysis.figures import Table, limits_text, number, significant, value_and_uncertainty, worded_table
from bench.analysis.material import Material
from bench.analysis.values import Value, absent, conditions_text, placed, values_of
from bench.analysis.wording import say
from bench.maths.tests import odd_one, trend

SPAN = "span"
_HEADERS = ("quantity", "conditions", "mean", "unit", "n", "scatter", "u_scatter", "u_specification", "expected")


@dataclass(frozen=True)
class Judged:
    """The values that a sequence names, as estimates with their evidence; ``missing`` were not read."""

    estimates: Estimates
    evidence: list[Evidence]
    missing: list[str]
    tables: list[Table]


def judged_values(material: Material) -> Judged:
    """Return what a sequence expects of its values; nothing if it names none."""
    values = values_of(material)
    return Judged(
        estimates=[entry for value in values for entry in _estimates(value)],
        evidence=[check for value in values for check in _evidence(value, material)],
        missing=absent(material, values),
        tables=[value_table(values)] if values else [],
    )


def _estimates(value: Value) -> Estimates:
    dropped, conditions = value.dropped, value.conditions
    mean = estimate(
        value.quantity, value.unit, value.mean, value.std, conditions, n=value.n, dropped=dropped, limit=value.limits,
        dof=value.dof,
    )  # fmt: skip
    if value.span is None:
        return [mean]
    span = float(value.readings.max() - value.readings.min())
    limit, name = (-math.inf, value.span), f"{value.quantity}_{SPAN}"  # of the readings as they are: a count of them
    return [mean, estimate(name, value.unit, span, 0.0, conditions, n=value.n, dropped=dropped, limit=limit)]


def _evidence(value: Value, material: Material) -> Iterable[Evidence]:
    """Yield what speaks against a value, and so against every fit through it: no specification, a drift, an odd one."""
    where = placed(value.quantity, value.conditions)
    bears_on = [value.quantity, f"{value.quantity}_{SPAN}"]
    for fit in material.campaign.get("fits", ()):
        if value.quantity in (fit["of"], fit["against"].get("quantity")):
            bears_on += [f"{fit['name']}_{result}" for result in fit["units"]]
            bears_on += [asked["quantity"] for asked in fit.get("read_back", ())]
    if value.unstated:
        sentence = say("value.unstated", where=where, why=value.unstated)
        yield Evidence("no_specification", sentence, None, CERTAIN, quantities=bears_on, conditions=value.conditions)
        return
    expanded = 2.0 * value.std
    t_s, readings = value.blocks
    if (drift := trend(t_s, readings)) is not None:
        sentence = say("value.drifts", where=where, size=drift.size, unit=value.unit)
        move = abs(drift.size) / 2.0 / expanded if expanded else math.inf
        yield Evidence(
            "drifts", sentence, drift.size, drift.probability, move, quantities=bears_on, conditions=value.conditions
        )
    if (odd := odd_one(readings)) is not None:
        sentence = say("value.odd", where=where, count=readings.size, size=odd.size, unit=value.unit)
        move = abs(odd.size) / expanded if expanded else math.inf
        yield Evidence(
            "odd_reading", sentence, odd.size, odd.probability, move,
            quantities=bears_on, conditions=value.conditions,
        )  # fmt: skip


def value_table(values: Sequence[Value]) -> Table:
    """Return all values with their scatter and both kinds of uncertainty."""
    return worded_table(say, "values", _HEADERS, [_row(value) for value in values])


def _row(value: Value) -> list[object]:
    conditions = conditions_text(value.conditions)
    std_b = say("value.not_stated") if value.unstated else significant(value.std_b)
    scatter = (value.scatter, value.std_a) if value.n > 1 else (None, None)
    told = ["–" if figure is None else significant(figure) for figure in scatter]
    expected = limits_text(value.limits)
    mean = number(value.mean) if value.unstated else value_and_uncertainty(value.mean, value.std)[0]
    mean = f"{mean} ({value.told})" if value.told else mean
    return [value.quantity, conditions, mean, value.unit, value.n, *told, std_b, expected]
