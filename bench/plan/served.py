"""The station file of a simulated bench that a process of its own serves in real time."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from datetime import date, timedelta
from pathlib import Path
from typing import Any

from pydantic import RootModel

from bench.model.yamlio import parse_yaml
from bench.plan.station import Station

CALIBRATED = timedelta(days=30)  # before the day it is served
DUE = timedelta(days=335)  # after it
_SECTION = re.compile(r"([a-z_]+):")
_ANEW = (
    *("station", "title", "simulated", "visa", "control", "world", "bus_time_factor", "instruments", "standards"),
    "links",
)


def served_station(
    station: Station, resources: Mapping[str, str], urls: Mapping[str, str], control: Path, today: date
) -> str:
    """Return YAML text of a station with the same roles, standards, limits and options, without a world.

    What has nothing to do with where things are is taken over as it is written.

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
    written = parse_yaml(station.document.text.encode(), station.name, RootModel[dict[str, Any]]).model.root
    for role, entry in written["instruments"].items():
        served = {name: value for name, value in entry.items() if name != "serial_line"} | {"resource": resources[role]}
        if "standard" in entry:
            served["standard"] = _dated(entry["standard"], today)
        lines.append(f"  {role}: {json.dumps(served)}")
    if file.standards:
        register = {name: _dated(standard, today) for name, standard in written["standards"].items()}
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


def _dated(standard: Mapping[str, Any], today: date) -> dict[str, Any]:
    """Return an entry of the register as it is written, but for its dates."""
    return {**standard, "calibrated": (today - CALIBRATED).isoformat(), "due": (today + DUE).isoformat()}
