"""Tables of estimates: scale factor, coefficients, every further quantity by channel and temperature, and those
that belong to no channel: what they are down, units or axes across.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from bench.analysis import Estimate, cell, decimals_for, is_sound, number, significant, stated_value, unit_text
from bench.model.texts import Texts, condition_title, told, value_title
from bench.model.units import read_quantity
from bench.report.model import ReportModel
from bench.report.tables import (
    Table,
    alike_of,
    brief,
    channel_title,
    documents_table,
    grouped,
    kind_of,
    named,
    table_of,
)

_SCALE_FACTOR = ("dsf_n", "dsf_p", "dsf_asymmetry")
_COEFFICIENTS = ("tc0", "tc1", "tc2", "tc3")
_PIVOT = {"channel", "temperature_degC"}
_COMMON = {*_PIVOT, "kind", "unit_temperature_degC"}  # told by the row and the column
_RESIDUAL = "residual"
PIVOTS = ("unit", "column", "axis")
_PREFIXED = re.compile(r"(A|V|s|m|ohm|Hz)(?![A-Za-z0-9])")
_PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
_WITHIN = {"A": (-9, 0), "s": (-12, 0), "m": (-12, 0)}  # powers in use: microseconds, but no kiloseconds
_LAST_UNIT = re.compile(r"(.+)_(degC_min|deg_s|[A-Za-z]+)$")
_MOST_ACROSS = 3  # units side by side that a page has room for
_CAPTIONS = {"unit": "others.by_unit", "column": "others.by_axis", "axis": "others.by_axis"}
Channel = Mapping[str, Any]  # of the campaign


def scale_factor_tables(model: ReportModel, words: Texts) -> list[Table]:
    """Return one table per kind of sensor: errors in ppm, and at full scale in nA and in the sensor's unit."""
    by_number = {entry["number"]: entry for entry in model.campaign.get("channels", ())}
    kinds = dict.fromkeys(row.conditions.get("kind", "") for row in model.estimates("dsf_n"))
    return [table for kind in kinds if (table := _scale_factor_table(model, words, str(kind), by_number)).rows]


def _scale_factor_table(model: ReportModel, words: Texts, kind: str, by_number: Mapping[int, Channel]) -> Table:
    entries: dict[tuple[Any, Any], dict[str, Estimate]] = {}
    for quantity in _SCALE_FACTOR:
        for row in model.estimates(quantity):
            conditions = row.conditions
            if conditions.get("kind", "") == kind:
                key = (conditions["channel"], conditions.get("temperature_degC"))
                entries.setdefault(key, {})[quantity] = row
    sensor_unit = next((c["sensor_unit"] for c in by_number.values() if c.get("kind") == kind), "")
    scale, ampere = prefixed("A", _currents(entries, by_number))
    rows = tuple(
        _scale_factor_row(key, entry, by_number.get(key[0], {}), scale) for key, entry in sorted(entries.items())
    )
    headers = (
        *(words("column.channel"), words("scale_factor.set"), words("scale_factor.unit")),
        *("N / ppm", "P / ppm", "N − P / ppm", f"N / {ampere}", f"P / {ampere}"),
    )
    sensor = (f"N / {sensor_unit}", f"P / {sensor_unit}") if sensor_unit else ()
    at_full_scale = ampere + (f", {sensor_unit}" if sensor_unit else "")
    caption = words("scale_factor.table", kind=kind_of(words, kind), units=at_full_scale)
    return Table(caption, (*headers, *sensor, words("scale_factor.rows")), rows, stub=2)


def _currents(entries: Mapping[Any, Mapping[str, Estimate]], by_number: Mapping[int, Channel]) -> list[float]:
    """Return the errors at full scale, ampere, as far as they are known."""
    pairs = [
        (row, by_number.get(number, {}).get("full_scale_A")) for (number, _), entry in entries.items()
        for name, row in entry.items() if name in _SCALE_FACTOR[:2]
    ]  # fmt: skip
    known = [1e-6 * row.value * full_A for row, full_A in pairs if row.value is not None and full_A]
    return known or [1e-9]


def _scale_factor_row(
    key: tuple[Any, Any], entry: Mapping[str, Estimate], channel: Channel, scale: float
) -> tuple[str, ...]:
    first = next(iter(entry.values()))
    ppm = [value_text(entry.get(name)) for name in _SCALE_FACTOR]
    at_full_scale = [_at_full_scale(entry.get(name), channel.get("full_scale_A"), scale) for name in _SCALE_FACTOR[:2]]
    if channel.get("sensor_unit"):
        at_full_scale += [
            _at_full_scale(entry.get(name), channel.get("sensor_full_scale"), 1.0) for name in _SCALE_FACTOR[:2]
        ]
    used = str(first.n) + (f" (−{first.dropped})" if first.dropped else "")
    measured = first.conditions.get("unit_temperature_degC")
    return (str(key[0]), number(key[1], 1), number(measured, 2), *ppm, *at_full_scale, used)


def _at_full_scale(row: Estimate | None, full_scale: float | None, factor: float) -> str:
    if row is None or full_scale is None or not is_sound(row):
        return "–"
    scale = 1e-6 * full_scale * factor
    return number(row.value * scale, decimals_for((row.expanded_uncertainty or 0.0) * scale))


def coefficient_table(model: ReportModel, words: Texts) -> Table | None:
    """Return temperature coefficients, one row per channel and quantity, about the reference temperature."""
    entries: dict[tuple[str, str], dict[str, Estimate]] = {}
    for row in model.rows:
        quantity, _, order = row.quantity.rpartition("_")
        if order in _COEFFICIENTS:
            entries.setdefault((str(row.conditions.get("channel", "–")), quantity), {})[order] = row
    _add_reference_values(model, entries)
    if not entries:
        return None
    orders = [order for order in _COEFFICIENTS if any(order in entry for entry in entries.values())]
    lines = []
    for (channel, quantity), entry in entries.items():
        scale, unit = readable(list(entry.values()))
        values = (value_text(entry.get(order), scale) for order in orders)
        lines.append((channel, f"{model.title_of(quantity, words.language)} / {unit.partition('/')[0]}", *values))
    conditions = next(iter(next(iter(entries.values())).values())).conditions
    reference = conditions.get("reference_temperature_degC", model.campaign.get("reference_temperature_degC"))
    at = words("coefficients.at", degC=cell(reference))
    heads = {order: at if order == "tc0" else words(f"coefficients.{order}") for order in _COEFFICIENTS}
    headers = (words("column.channel"), words("column.quantity"), *(heads[order] for order in orders))
    caption = words("coefficients.table" if "tc0" in orders else "coefficients.alone", degC=cell(reference))
    return Table(caption, headers, tuple(lines), stub=2)


def _add_reference_values(model: ReportModel, entries: dict[tuple[str, str], dict[str, Estimate]]) -> None:
    """Add the value of a quantity at its reference temperature where the fit gives no constant."""
    for row in model.rows:
        conditions = row.conditions
        entry = entries.get((str(conditions.get("channel", "–")), row.quantity))
        if entry and "tc0" not in entry:
            reference = next(iter(entry.values())).conditions.get("reference_temperature_degC")
            if reference is not None and conditions.get("temperature_degC") == reference:
                entry["tc0"] = row


def value_text(row: Estimate | None, scale: float = 1.0) -> str:
    """Return a value with its expanded uncertainty, times ``scale``; a dash for none."""
    return "–" if row is None else stated_value(brief(row), scale)


def pivot_tables(model: ReportModel, words: Texts, *, residuals: bool = False) -> list[Table]:
    """Return one table per further quantity by channel and temperature: channels down, set temperatures across.

    ``residuals``: those that a fit left, in place of all others.
    """
    tables = []
    chosen = [
        row for row in _further(model) if _pivots(row) and (row.quantity.rpartition("_")[2] == _RESIDUAL) == residuals
    ]
    for title, rows in _by_title(model, words, chosen):
        scale, unit = readable(rows)
        temperatures = sorted({row.conditions["temperature_degC"] for row in rows})
        cells: dict[Any, dict[Any, str]] = {}
        for row in rows:
            where = row.conditions
            cells.setdefault(where["channel"], {})[where["temperature_degC"]] = value_text(row, scale)
        body = tuple((str(key), *(line.get(t, "–") for t in temperatures)) for key, line in sorted(cells.items()))
        caption = words("others.pivot", quantity=title, unit=unit_text(unit))
        tables.append(Table(caption, (words("column.channel"), *(f"{number(t, 1)} °C" for t in temperatures)), body))
    return tables


def _by_title(model: ReportModel, words: Texts, rows: Sequence[Estimate]) -> list[tuple[str, list[Estimate]]]:
    """Return rows by quantity; where a further condition tells several apart, such as the polarity, by that too."""
    values: dict[tuple[str, str], set[str]] = {}
    for row in rows:
        for name, value in row.conditions.items():
            if name not in _COMMON:
                values.setdefault((row.quantity, name), set()).add(str(value))
    titled: dict[str, list[Estimate]] = {}
    for row in rows:
        quantity, conditions = row.quantity, row.conditions
        apart = {name: value for name, value in conditions.items() if len(values.get((quantity, name), ())) > 1}
        parts = (model.title_of(quantity, words.language), conditions_text(words, apart))
        titled.setdefault(", ".join(filter(None, parts)), []).append(row)
    return list(titled.items())


def _further(model: ReportModel) -> list[Estimate]:
    return [
        row
        for row in model.rows
        if row.quantity not in _SCALE_FACTOR and row.quantity.rpartition("_")[2] not in _COEFFICIENTS
    ]


def _pivots(row: Estimate) -> bool:
    """Return True for a quantity known once by channel and set temperature."""
    return row.conditions.keys() >= _PIVOT and "repeat" not in row.conditions


def readable(rows: Sequence[Estimate]) -> tuple[float, str]:
    """Return factor and unit for printing values of one quantity with their uncertainties."""
    return prefixed(rows[0].unit, [size or 0.0 for row in rows for size in (row.value, row.expanded_uncertainty)])


def prefixed(unit: str, values: Iterable[float]) -> tuple[float, str]:
    """Return factor and unit for printing, with the prefix that leaves one to three digits before the point.

    Currents are in nanoampere at least, times and lengths in seconds and metres at most.
    """
    match = _PREFIXED.match(unit)
    largest = max(map(abs, values))
    if match is None or not 0.0 < largest < math.inf:
        return 1.0, unit
    least, most = _WITHIN.get(match[1], (-12, 9))
    power = min(most, max(least, 3 * math.floor(math.log10(largest * (1.0 + 1e-12)) / 3.0)))
    return 10.0**-power, f"{_PREFIXES[power]}{unit}"


def channel_table(model: ReportModel, words: Texts) -> Table | None:
    """Return quantities known once per channel: channels down, quantities across."""
    chosen = [row for row in _further(model) if _once_per_channel(row)]
    if not chosen:
        return None
    by_title = {
        title: {row.conditions["channel"]: row for row in rows} for title, rows in _by_title(model, words, chosen)
    }
    scales = {title: readable(list(rows.values())) for title, rows in by_title.items()}
    channels = sorted({channel for rows in by_title.values() for channel in rows})
    body = tuple(
        (str(channel), *(value_text(rows.get(channel), scales[title][0]) for title, rows in by_title.items()))
        for channel in channels
    )
    headers = (f"{title} / {unit_text(scales[title][1])}" for title in by_title)
    return Table(words("others.by_channel"), (words("column.channel"), *headers), body)


def _once_per_channel(row: Estimate) -> bool:
    conditions = row.conditions
    return "channel" in conditions and not {"temperature_degC", "repeat"} & conditions.keys()


def other_table(model: ReportModel, words: Texts) -> Table | None:
    """Return every estimate that has no table of its own; conditions that all of them share stand in the caption."""
    chosen = [row for row in without_channel(model) if pivot_of(row) is None]
    alike, rows = alike_of([row.conditions for row in chosen]), []
    for row in chosen:
        scale, unit = readable([row])
        apart = {name: value for name, value in row.conditions.items() if name not in alike}
        where = conditions_text(words, apart, model.analysis)
        title = model.title_of(row.quantity, words.language)
        stated = "–" if row.value is None else unit_text(unit)  # of nothing no unit is stated
        rows.append((title, where or "–", value_text(row, scale), stated))
    headers = ("column.quantity", "column.conditions", "column.value_expanded", "column.unit")
    shared = words("others.alike", conditions=conditions_text(words, alike, model.analysis)) if alike else ""
    return table_of(words, f"{words('others.table')} {shared}".rstrip(), headers, rows, stub=2)


def without_channel(model: ReportModel) -> list[Estimate]:
    """Return estimates that no table of channels shows."""
    return [row for row in _further(model) if not _pivots(row) and not _once_per_channel(row)]


def pivot_of(row: Estimate) -> str | None:
    """Return the condition that is set across: the unit, the column of a matrix, an axis; None if there is none."""
    return next((name for name in PIVOTS if name in row.conditions), None)


def conditions_text(words: Texts, conditions: Mapping[str, Any], campaign: str = "") -> str:
    """Return conditions in words: ``channel 1, gyro, set temperature −10 °C``; ``campaign``: whose system has words."""
    parts = []
    for name, value in conditions.items():
        if name == "channel":
            parts.append(channel_title(words, value, conditions.get("kind")))
        elif name != "kind" or "channel" not in conditions:
            parts.append(_condition(words, name, value, campaign))
    return ", ".join(parts)


def _condition(words: Texts, name: str, value: Any, campaign: str) -> str:
    if name == "kind":
        return condition_value(words, name, value, campaign)
    label, unit = _label_and_unit(words, name, campaign)
    if not unit or not isinstance(value, int | float) or isinstance(value, bool):
        return f"{label} {condition_value(words, name, value, campaign)}"
    scale, shown = prefixed(unit, [value])
    return f"{label} {number(scale * value) if unit != 'degC' else number(round(value, 2))}\u00a0{unit_text(shown)}"


def condition_value(words: Texts, name: str, value: Any, campaign: str) -> str:
    """Return the value of a condition as text: a word of the system's, yes or no, a number."""
    if isinstance(value, bool):
        return words("yes" if value else "no")
    value = told(value, words.language)
    word = value_title(campaign, name, value, words.language) if isinstance(value, str) else cell(value)
    return kind_of(words, value) if name == "kind" and word == value else word


def condition_scale(words: Texts, name: str, values: Sequence[Any], campaign: str) -> tuple[float, str]:
    """Return factor and unit for printing all values of a condition: hertz in megahertz; 1 and "" for words."""
    unit = _label_and_unit(words, name, campaign)[1]
    known = bool(unit) and all(isinstance(value, int | float) for value in values)
    return prefixed(unit, values) if known else (1.0, unit)


def condition_head(words: Texts, name: str, campaign: str, unit: str = "") -> str:
    """Return the heading of a condition with its unit; ``unit``: the one its values are printed in."""
    label, own = _label_and_unit(words, name, campaign)
    return f"{label} / {unit_text(unit or own)}" if own else label


def _label_and_unit(words: Texts, name: str, campaign: str) -> tuple[str, str]:
    match = _LAST_UNIT.match(name)
    unit = match[2].replace("_", "/") if match else ""
    unit = unit if read_quantity(f"1 {unit}") is not None else ""
    own = condition_title(campaign, name, words.language) or words.all.get(f"condition.{name}")
    own = own or ("" if unit else words.all.get(f"column.{name}"))
    return own or (match[1] if match and unit else name).replace("_", " "), unit


def coverage_table(model: ReportModel, words: Texts) -> Table | None:
    """Return what is stated for each quantity: how many values, their standard and expanded uncertainties, and k."""
    rows = []
    for quantity, group in grouped(model.rows, lambda row: row.quantity).items():
        if not any(row.expanded_uncertainty for row in group):
            continue  # a count, or what nobody stated an uncertainty of
        scale, unit = readable(group)
        spans = (
            span(words, [scale * row.std_uncertainty for row in group if row.std_uncertainty], significant),
            span(words, [row.coverage_factor for row in group if row.coverage_factor], two_places),
            span(words, [scale * row.expanded_uncertainty for row in group if row.expanded_uncertainty],
                  significant),
        )  # fmt: skip
        title = model.title_of(quantity, words.language)
        rows.append((title, unit_text(unit), str(len(group)), *spans))
    headers = ("column.quantity", "column.unit", "coverage.count", "coverage.u", "coverage.k", "coverage.U")
    return table_of(words, words("coverage.table"), headers, rows, stub=2)


def span(words: Texts, values: Sequence[float], text_of: Callable[[float], str]) -> str:
    """Return least to greatest; once if they read the same."""
    if not values:
        return "–"
    low, high = text_of(min(values)), text_of(max(values))
    return low if low == high else words("coverage.span", low=low, high=high)


def two_places(value: float) -> str:
    """Return a number to hundredths, as a coverage factor or a ratio is told."""
    return number(value, 2)


def components_table(model: ReportModel, words: Texts) -> Table | None:
    """Return components with two significant digits: more of an uncertainty says nothing."""
    title = partial(model.title_of, language=words.language)
    rounded = [
        {name: _component_text(name, value, title) for name, value in component.items()}
        for component in told(list(model.components), words.language)
    ]
    return documents_table(words, words("components.table"), rounded)


def _component_text(name: str, value: Any, title: Callable[[str], str]) -> Any:
    if name == "quantity":
        return ", ".join(map(title, value.split(", ")))
    if isinstance(value, float) and math.isfinite(value):
        return significant(value) if value else "0"
    return named(value, title) if isinstance(value, str) else value


def across_tables(model: ReportModel, words: Texts) -> list[Table]:
    """Return units or axes across, one table for each three of them; () if no estimate has such a condition."""
    pivoted = [row for row in without_channel(model) if pivot_of(row) is not None]
    by_caption = grouped(pivoted, lambda row: _CAPTIONS[str(pivot_of(row))])
    return [table for caption, rows in by_caption.items() for table in _tables(model, words, caption, rows)]


def _tables(model: ReportModel, words: Texts, caption: str, rows: Sequence[Estimate]) -> list[Table]:
    names = list(dict.fromkeys(_across(row) for row in rows))
    parts = [names[start : start + _MOST_ACROSS] for start in range(0, len(names), _MOST_ACROSS)]
    captions = [words(caption), *(words("table.continued", caption=words(caption)) for _ in parts[1:])]
    return [
        replace(_table(model, words, text, [row for row in rows if _across(row) in part], part), goes_on=index > 0)
        for index, (text, part) in enumerate(zip(captions, parts, strict=True))
    ]


def _table(model: ReportModel, words: Texts, caption: str, rows: Sequence[Estimate], names: Sequence[str]) -> Table:

    def line(row: Estimate) -> tuple[str, str]:
        rest = {name: value for name, value in row.conditions.items() if name != pivot_of(row)}
        return row.quantity, conditions_text(words, rest, model.analysis)

    body = []
    for (quantity, where), group in grouped(rows, line).items():
        scale, unit = readable(group)
        by_name = {_across(row): value_text(row, scale) for row in group}
        title = model.title_of(quantity, words.language)
        body.append((title, where or "–", unit_text(unit), *(by_name.get(name, "–") for name in names)))
    across, campaign = str(pivot_of(rows[0])), model.analysis
    shown = (condition_value(words, across, name, campaign) for name in names)
    headers = (words("column.quantity"), words("column.conditions"), words("column.unit"), *shown)
    return Table(caption, headers, tuple(body), stub=3)


def _across(row: Estimate) -> str:
    return str(row.conditions[str(pivot_of(row))])
