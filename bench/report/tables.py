"""Tables of a report: rows of text, with the units in the header."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bench.report.model import ReportModel
from bench.report.numbers import cell, decimals_for, header, number, unit_text, with_uncertainty

_SCALE_FACTOR = ("dsf_n", "dsf_p", "dsf_asymmetry")
_COEFFICIENTS = ("tc0", "tc1", "tc2", "tc3")
_COLUMNS = (
    *("role", "manufacturer", "model", "serial", "firmware"),
    *("step", "text", "value", "unit", "low", "high", "by"),
    *("kind", "quantity", "component", "evaluation", "distribution", "std_uncertainty_ppm"),
    *("range_A", "gain", "offset_A"),
)
_PROSE = 40  # characters of a cell that is a sentence rather than a value
_PIVOT = {"channel", "temperature_degC"}
_AMPERE = re.compile(r"A(?![A-Za-z])")
_NUMERAL = re.compile(r"-(?=[0-9])")
_NO_SIZE = re.compile(r"-(0(?:\.0+)?)$")
_COMMA_UNIT = re.compile(r", (?=(?:°C|nA|ppm|ppb|min|h|s|A|%)$)")


@dataclass(frozen=True)
class Table:
    """A captioned table; the first ``stub`` columns head their row and are set flush left, all of them if ``prose``."""

    caption: str
    headers: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    stub: int = 1
    prose: bool = False


def scale_factor_tables(model: ReportModel) -> list[Table]:
    """One table per kind of sensor: errors in ppm, and at full scale in nA and in the sensor's unit."""
    by_number = {entry["number"]: entry for entry in model.campaign.get("channels", ())}
    kinds = dict.fromkeys(row["conditions"].get("kind", "") for row in model.estimates("dsf_n"))
    return [table for kind in kinds if (table := _scale_factor_table(model, str(kind), by_number)).rows]


def _scale_factor_table(model: ReportModel, kind: str, by_number: Mapping[int, Mapping[str, Any]]) -> Table:
    found: dict[tuple[Any, Any], dict[str, Mapping[str, Any]]] = {}
    for quantity in _SCALE_FACTOR:
        for row in model.estimates(quantity):
            conditions = row["conditions"]
            if conditions.get("kind", "") == kind:
                key = (conditions["channel"], conditions.get("temperature_degC"))
                found.setdefault(key, {})[quantity] = row
    sensor_unit = next((c["sensor_unit"] for c in by_number.values() if c.get("kind") == kind), "")
    rows = tuple(_scale_factor_row(key, entry, by_number.get(key[0], {})) for key, entry in sorted(found.items()))
    headers = ("channel", "set / °C", "unit / °C", "N / ppm", "P / ppm", "N − P / ppm", "N / nA", "P / nA")
    sensor = (f"N / {sensor_unit}", f"P / {sensor_unit}") if sensor_unit else ()
    caption = (
        f"Scale-factor errors, {kind or 'all'} channels: value ± expanded uncertainty. "
        f"nA{' and ' + sensor_unit if sensor_unit else ''}: the error at full scale."
    )
    return Table(caption, (*headers, *sensor, "rows"), rows, stub=2)


def _scale_factor_row(
    key: tuple[Any, Any], entry: Mapping[str, Mapping[str, Any]], channel: Mapping[str, Any]
) -> tuple[str, ...]:
    first = next(iter(entry.values()))
    ppm = [
        with_uncertainty(entry[name]["value"], entry[name].get("expanded_uncertainty")) if name in entry else "–"
        for name in _SCALE_FACTOR
    ]
    at_full_scale = [_at_full_scale(entry.get(name), channel.get("full_scale_A"), 1e9) for name in _SCALE_FACTOR[:2]]
    if channel.get("sensor_unit"):
        at_full_scale += [
            _at_full_scale(entry.get(name), channel.get("sensor_full_scale"), 1.0) for name in _SCALE_FACTOR[:2]
        ]
    used = f"{first.get('n', '–')}" + (f" (−{first['dropped']})" if first.get("dropped") else "")
    measured = first["conditions"].get("unit_temperature_degC")
    return (str(key[0]), number(key[1], 1), number(measured, 2), *ppm, *at_full_scale, used)


def _at_full_scale(row: Mapping[str, Any] | None, full_scale: float | None, factor: float) -> str:
    if row is None or full_scale is None:
        return "–"
    scale = 1e-6 * full_scale * factor
    return number(row["value"] * scale, decimals_for((row.get("expanded_uncertainty") or 0.0) * scale))


def coefficient_table(model: ReportModel) -> Table | None:
    """Temperature coefficients, one row per channel and quantity, about the reference temperature."""
    found: dict[tuple[str, str], dict[str, Mapping[str, Any]]] = {}
    for row in model.results.get("estimates", ()):
        quantity, _, order = row["quantity"].rpartition("_")
        if order in _COEFFICIENTS:
            found.setdefault((str(row["conditions"].get("channel", "–")), quantity), {})[order] = row
    _add_reference_values(model, found)
    if not found:
        return None
    orders = [order for order in _COEFFICIENTS if any(order in entry for entry in found.values())]
    lines = []
    for (channel, quantity), entry in found.items():
        scale, unit = _readable(list(entry.values()))
        values = (_value(entry.get(order), scale) for order in orders)
        lines.append((channel, f"{quantity} / {unit.partition('/')[0]}", *values))
    conditions = next(iter(next(iter(found.values())).values()))["conditions"]
    reference = conditions.get("reference_temperature_degC", model.campaign.get("reference_temperature_degC"))
    caption = f"Value at {cell(reference)} °C and coefficients about it: value ± expanded uncertainty."
    heads = dict(zip(_COEFFICIENTS, (f"at {cell(reference)} °C", "per °C", "per °C²", "per °C³"), strict=True))
    return Table(caption, ("channel", "quantity", *(heads[order] for order in orders)), tuple(lines), stub=2)


def _add_reference_values(model: ReportModel, found: dict[tuple[str, str], dict[str, Mapping[str, Any]]]) -> None:
    """Where a fit gives no constant, the value of the quantity at its reference temperature stands for it."""
    for row in model.results.get("estimates", ()):
        conditions = row["conditions"]
        entry = found.get((str(conditions.get("channel", "–")), row["quantity"]))
        if entry and "tc0" not in entry:
            reference = next(iter(entry.values()))["conditions"].get("reference_temperature_degC")
            if reference is not None and conditions.get("temperature_degC") == reference:
                entry["tc0"] = row


def _value(row: Mapping[str, Any] | None, scale: float = 1.0) -> str:
    if row is None:
        return "–"
    expanded = row.get("expanded_uncertainty")
    return with_uncertainty(row["value"] * scale, None if expanded is None else expanded * scale)


def pivot_tables(model: ReportModel) -> list[Table]:
    """One table per further quantity known by channel and temperature: channels down, set temperatures across."""
    tables = []
    by_quantity: dict[str, list[Mapping[str, Any]]] = {}
    for row in _further(model):
        if _pivots(row):
            by_quantity.setdefault(row["quantity"], []).append(row)
    for quantity, rows in by_quantity.items():
        scale, unit = _readable(rows)
        temperatures = sorted({row["conditions"]["temperature_degC"] for row in rows})
        cells: dict[Any, dict[Any, str]] = {}
        for row in rows:
            where = row["conditions"]
            cells.setdefault(where["channel"], {})[where["temperature_degC"]] = _value(row, scale)
        body = tuple((str(key), *(line.get(t, "–") for t in temperatures)) for key, line in sorted(cells.items()))
        caption = f"{quantity} / {unit_text(unit)}: value ± expanded uncertainty, per channel and set temperature."
        tables.append(Table(caption, ("channel", *(f"{number(t, 1)} °C" for t in temperatures)), body))
    return tables


def _further(model: ReportModel) -> list[Mapping[str, Any]]:
    return [
        row
        for row in model.results.get("estimates", ())
        if row["quantity"] not in _SCALE_FACTOR and row["quantity"].rpartition("_")[2] not in _COEFFICIENTS
    ]


def _pivots(row: Mapping[str, Any]) -> bool:
    """True for a quantity known once by channel and set temperature."""
    return row["conditions"].keys() >= _PIVOT and "repeat" not in row["conditions"]


def _readable(rows: Sequence[Mapping[str, Any]]) -> tuple[float, str]:
    """Factor and unit for printing: currents of the unit under test read best in nanoampere."""
    unit = str(rows[0]["unit"])
    small = _AMPERE.match(unit) and max(abs(row["value"]) for row in rows) < 1e-3
    return (1e9, f"n{unit}") if small else (1.0, unit)


def channel_table(model: ReportModel) -> Table | None:
    """Quantities known once per channel: channels down, quantities across."""
    found: dict[str, dict[Any, Mapping[str, Any]]] = {}
    for row in _further(model):
        if _once_per_channel(row):
            found.setdefault(row["quantity"], {})[row["conditions"]["channel"]] = row
    if not found:
        return None
    scales = {quantity: _readable(list(rows.values())) for quantity, rows in found.items()}
    channels = sorted({channel for rows in found.values() for channel in rows})
    body = tuple(
        (str(channel), *(_value(rows.get(channel), scales[quantity][0]) for quantity, rows in found.items()))
        for channel in channels
    )
    headers = (f"{quantity} / {unit_text(scales[quantity][1])}" for quantity in found)
    return Table("Per channel: value ± expanded uncertainty.", ("channel", *headers), body)


def _once_per_channel(row: Mapping[str, Any]) -> bool:
    conditions = row["conditions"]
    return "channel" in conditions and not {"temperature_degC", "repeat"} & conditions.keys()


def other_table(model: ReportModel) -> Table | None:
    """Every estimate that has no table of its own, with its conditions."""
    rows = []
    for row in _further(model):
        if not _pivots(row) and not _once_per_channel(row):
            scale, unit = _readable([row])
            rows.append((row["quantity"], _conditions(row["conditions"]), _value(row, scale), unit_text(unit)))
    headers = ("quantity", "conditions", "value ± expanded uncertainty", "unit")
    caption = "Quantities of the campaign as a whole, or of one condition."
    return Table(caption, headers, tuple(rows), stub=2) if rows else None


def verdict_table(model: ReportModel) -> Table | None:
    """What is judged, one row per quantity and channel: the estimate nearest to its limit; None without verdicts."""
    judged: dict[tuple[str, Any], list[Mapping[str, Any]]] = {}
    for row in model.results.get("estimates", ()):
        if row.get("verdict", "none") != "none":
            judged.setdefault((row["quantity"], row["conditions"].get("channel", "–")), []).append(row)
    rows = tuple(_verdict_row(quantity, channel, group) for (quantity, channel), group in judged.items())
    rule = model.results.get("decision_rule")
    headers = ("quantity", "channel", "judged", "worst: value ± U", "limit", "unit", "conformance", "verdicts")
    caption = (
        "Judged by a limit: the estimate nearest to it stands for its channel, all are in results.json. "
        + (f"Decision rule: {str(rule).replace('_', ' ')}. " if rule else "")
        + "Conformance: probability that the true value is inside the limit."
    )
    return Table(caption, headers, rows, stub=2) if rows else None


def _verdict_row(quantity: str, channel: Any, group: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    worst = max(group, key=lambda row: (abs(row["value"]) + row["expanded_uncertainty"]) / (row["limit"] or math.inf))
    scale, unit = _readable([worst])
    counted = Counter(str(row["verdict"]).replace("_", " ") for row in group)
    limit = worst.get("limit")
    probability = worst.get("conformance_probability")
    return (
        quantity,
        str(channel),
        str(len(group)),
        _value(worst, scale),
        number(None if limit is None else limit * scale),
        unit_text(unit),
        "–" if probability is None else _percent(probability),
        ", ".join(f"{count} {name}" for name, count in sorted(counted.items())),
    )


def _percent(probability: float) -> str:
    """Per cent, never rounded up to certainty."""
    return "> 99.99 %" if probability > 0.9999 else f"{100.0 * probability:.2f} %"


def analysis_tables(documents: Sequence[Mapping[str, Any]]) -> list[Table]:
    """The tables an analysis describes as plain documents; one of words says ``prose``."""
    return [
        Table(
            ". ".join(text for text in (str(one["title"]), str(one.get("caption", ""))) if text),
            tuple(label(str(text)) for text in one["headers"]),
            tuple(tuple(_plain(value) for value in row) for row in one["rows"]),
            prose=bool(one.get("prose"))
            or any(isinstance(value, str) and len(value) > _PROSE for row in one["rows"] for value in row),
        )
        for one in documents
    ]


def label(text: str) -> str:
    """A heading of an analysis as the page prints it: ``width, degC`` becomes ``width / °C``."""
    return _COMMA_UNIT.sub(" / ", unit_text(text))


def _plain(value: Any) -> str:
    """A cell: four significant digits; a number that comes as text gets its minus sign, and nothing is minus zero."""
    if isinstance(value, str) and value[:1] == "-":
        return _NUMERAL.sub("−", _NO_SIZE.sub(r"\1", value))
    if isinstance(value, float) and 0.0 < abs(value) < math.inf:
        return number(value, min(9, max(0, 3 - math.floor(math.log10(abs(value))))))
    return cell(value)


def _conditions(conditions: Mapping[str, Any]) -> str:
    return ", ".join(f"{header(name)}: {cell(value)}" for name, value in conditions.items() if name != "kind")


def standards_table(model: ReportModel) -> Table | None:
    """The standards register: which instrument, which certificate, until when, which corrections were applied."""
    rows = tuple(
        (
            role,
            cell(entry.get("model", entry.get("driver"))),
            cell(entry.get("serial")),
            cell(entry.get("certificate")),
            cell(entry.get("calibrated")),
            cell(entry.get("due")),
            _corrections(entry.get("corrections") or ()),
        )
        for role, entry in sorted(model.standards.items())
    )
    headers = ("role", "model", "serial number", "certificate", "calibrated", "due", "corrections applied")
    return Table("Register of the station file.", headers, rows, prose=True) if rows else None


def _corrections(corrections: Iterable[Mapping[str, Any]]) -> str:
    """Corrections that change a number; a register full of zeros reads "none"."""
    applied = [one for one in corrections if any(value for name, value in one.items() if not name.startswith("range"))]
    return "; ".join(cell(dict(sorted(one.items(), key=lambda item: _rank(item[0])))) for one in applied) or "none"


def documents_table(caption: str, documents: Sequence[Mapping[str, Any]]) -> Table | None:
    """A table of like documents: their keys are the columns, in an order that does not depend on who wrote them."""
    if not documents:
        return None
    keys = sorted({key for one in documents for key in one}, key=_rank)
    rows = tuple(tuple(cell(one.get(key)) for key in keys) for one in documents)
    return Table(caption, tuple(header(key) for key in keys), rows, prose=True)


def _rank(key: str) -> tuple[int, str]:
    return (_COLUMNS.index(key) if key in _COLUMNS else len(_COLUMNS), key)


def pairs_table(caption: str, headers: tuple[str, str], pairs: Mapping[str, Any], prose: bool = True) -> Table | None:
    """A two-column table of names and values; nested documents become dotted names."""
    rows = tuple(_flat("", pairs))
    return Table(caption, headers, rows, prose=prose) if rows else None


def _flat(prefix: str, pairs: Mapping[str, Any]) -> Iterable[tuple[str, str]]:
    for name, value in pairs.items():
        if isinstance(value, Mapping):
            yield from _flat(f"{prefix}{name}.", dict(sorted(value.items())))
        else:
            yield f"{prefix}{name}".replace("_", " "), cell(value)
