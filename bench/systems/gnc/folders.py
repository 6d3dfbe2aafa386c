"""What is filed of each unit: a folder per test item with its result and its log, and a summary.

Source: GNC-module paper, section 5.2 (results in a folder per test item) and section 4.1 (what a test log shows).
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from bench.systems.gnc.unit_test.tables import title_of

if TYPE_CHECKING:
    from bench.analysis import Material
    from bench.systems.gnc.unit_test.units import ItemResult, UnitResult


def folders_of(units: Sequence[UnitResult], material: Material) -> dict[str, str]:
    """Relative path to text: ``<unit>/<item>/result.json``, ``<unit>/<item>/log.txt``, ``<unit>/summary.json``."""
    offset_s = material.utc_offset_s
    found = {}
    for unit in units:
        folder = folder_name(unit.unit)
        for item in unit.all:
            if item.runs:
                found[f"{folder}/{item.item}/result.json"] = _json(_result(unit.unit, item, offset_s))
                found[f"{folder}/{item.item}/log.txt"] = _log(unit.unit, item, offset_s)
        found[f"{folder}/summary.json"] = _json(_summary(unit, offset_s))
    return found


def folder_name(text: str) -> str:
    """A serial number as the name of a folder: letters, digits, dot, dash and underscore only, no leading dot."""
    return re.sub(r"[^A-Za-z0-9._-]", "_", text).lstrip(".") or "_"


def _result(unit: str, item: ItemResult, offset_s: float | None) -> dict[str, Any]:
    return {
        "unit": unit,
        "item": item.item,
        "verdict": item.verdict,
        "exchanges": item.runs,
        "repeated": item.retries,
        **_times(item.begin_s, item.end_s, offset_s),
        "wrong": [
            {"at_s": one.at_s, "what": one.what, "sent": one.sent, "expected": one.expected, "received": one.received}
            for one in item.findings.wrong
        ],
        "measured": [
            {"quantity": one.quantity, "unit": one.unit, "value": one.value, "conditions": dict(one.conditions),
             "limit": one.limit}
            for one in item.findings.measured
        ],
        "remarks": item.findings.remarks,
    }  # fmt: skip


def _summary(unit: UnitResult, offset_s: float | None) -> dict[str, Any]:
    begin_s, end_s = unit.span_s or (None, None)
    items = {one.item: one.verdict for one in unit.all}
    return {"unit": unit.unit, "verdict": unit.verdict, **_times(begin_s, end_s, offset_s), "items": items}


def _times(begin_s: float | None, end_s: float | None, offset_s: float | None) -> dict[str, Any]:
    """Return times of the bench clock; UTC labels beside them where the session says how the two belong together."""
    if begin_s is None or end_s is None:
        return {"begin_s": None, "elapsed_s": None, "end_s": None}
    found: dict[str, Any] = {"begin_s": begin_s, "elapsed_s": end_s - begin_s, "end_s": end_s}
    if offset_s is not None:
        found |= {"begin_utc": _utc(begin_s + offset_s), "end_utc": _utc(end_s + offset_s)}
    return found


def _log(unit: str, item: ItemResult, offset_s: float | None) -> str:
    times = _times(item.begin_s, item.end_s, offset_s)
    lines = [
        f"unit     {unit}",
        f"item     {title_of(item.item)}",
        f"start    {_stamp(times, 'begin')}",
        f"elapsed  {times['elapsed_s']:.3f} s",
        f"end      {_stamp(times, 'end')}",
        f"verdict  {item.verdict.upper()}: {len(item.findings.wrong)} wrong in {item.runs} exchanges, "
        f"{item.retries} repeated",
    ]
    for one in item.findings.wrong:
        lines += ["", f"{one.at_s:.3f} s  {one.what}", f"  sent      {one.sent or 'nothing'}"]
        lines += [f"  expected  {one.expected}", f"  received  {one.received}"]
    return "\n".join([*lines, *(f"remark   {one}" for one in item.findings.remarks)]) + "\n"


def _stamp(times: Mapping[str, Any], name: str) -> str:
    utc = times.get(f"{name}_utc")
    return f"{times[f'{name}_s']:.3f} s" + (f"  {utc}" if utc else "")


def _utc(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3] + "Z"


def _json(document: Mapping[str, Any]) -> str:
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False, sort_keys=True) + "\n"
