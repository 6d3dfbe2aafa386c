"""The station file of a simulated bench that a process of its own serves in real time."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from datetime import date, timedelta
from pathlib import Path
from typing import Any

from bench.plan.language.standards import Standard
from bench.plan.station import InstrumentEntry, Station

CALIBRATED = timedelta(days=30)  # before the day it is served
DUE = timedelta(days=335)  # after it
_SECTION = re.compile(r"([a-z_]+):")
_ANEW = (
    *("station", "title", "simulated", "visa", "control", "world", "bus_time_factor", "instruments", "standards"),
    "links",
)
_UNITS = {"range": "A", "floor": "A", "offset": "A", "relative": "1", "gain": "1", "age": "s", "certificate_U": "1"}


def served_station(
    station: Station, resources: Mapping[str, str], urls: Mapping[str, str], control: Path, today: date
) -> str:
    """Return YAML text of a station with the same roles, standards, limits and options, without a world.

    Sections that have nothing to do with where things are (interlocks, guard, notifications) are taken over as text.

    Args:
        resources: VISA address of each role.   urls: of each link.   control: socket of the process that serves it.
        today: the standards of a simulated bench were calibrated 30 days before and are due 335 days after it.
    """
    file = station.file
    head = {
        "station": file.station,
        "title": ", ".join(filter(None, (file.title, "served"))),
        "simulated": True,
        "visa": "@py",
        "control": str(control),
        "bus_time_factor": file.bus_time_factor,
    }
    lines = [f"{key}: {json.dumps(value)}" for key, value in head.items()]
    lines.append("instruments:")
    for role, entry in station.instruments.items():
        lines.append(f"  {role}: {json.dumps(_instrument(entry, resources[role], today))}")
    if file.standards:
        register = {name: _standard(standard, today) for name, standard in file.standards.items()}
        lines.append(f"standards: {json.dumps(register)}")
    lines.append("links:" if station.links else "links: {}")
    for name, link in station.links.items():
        port = {"baud": link.baud, "url": urls[name]} if link.instrument is None else {"instrument": link.instrument}
        lines.append(f"  {name}: {json.dumps({'frame': link.frame, **port})}")
    return "\n".join([*lines, *_others(station.document.text)]) + "\n"


def _others(text: str) -> list[str]:
    """Return lines of the top-level sections that are not written anew."""
    lines: list[str] = []
    section = ""
    for line in text.splitlines():
        if match := _SECTION.match(line):
            section = match[1]
        if section and section not in _ANEW:
            lines.append(line)
    return lines


def _instrument(entry: InstrumentEntry, resource: str, today: date) -> dict[str, Any]:
    document: dict[str, Any] = {
        "driver": entry.driver,
        "resource": resource,
        "safe_order": entry.safe_order,
        "options": entry.options,
        "limits": entry.limits,
    }
    if entry.standard is not None:
        document["standard"] = _standard(entry.standard, today)
    return document


def _standard(standard: Standard, today: date) -> dict[str, Any]:
    document: dict[str, Any] = {
        "model": standard.model,
        "serial": standard.serial,
        "certificate": standard.certificate,
        "calibrated": (today - CALIBRATED).isoformat(),
        "due": (today + DUE).isoformat(),
        "uncertainty": [_with_units(line.model_dump(exclude_unset=True)) for line in standard.uncertainty],
        "corrections": [_with_units(dict(line)) for line in standard.corrections],
    }
    for name in ("traceability", "drift"):
        value = getattr(standard, name)
        if value is not None:
            document[name] = f"{value!r} 1"
    if standard.degrees_of_freedom is not None:
        document["degrees_of_freedom"] = standard.degrees_of_freedom
    if standard.stated:
        document["stated"] = {name: f"{value!r} {unit}" for name, (value, unit) in standard.stated.items()}
    return document


def _with_units(line: Mapping[str, Any]) -> dict[str, Any]:
    return {name: f"{value!r} {_UNITS[name]}" if name in _UNITS else value for name, value in line.items()}
