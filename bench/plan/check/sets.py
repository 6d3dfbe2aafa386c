"""Static check of what prompts say a person changes: a bench that cannot do it must not find out after hours."""

from __future__ import annotations

import re
from importlib import import_module
from typing import Any

from bench.model.errors import InputError
from bench.model.installed import offers
from bench.plan.check.stations import SIMULATION
from bench.plan.findings import Findings
from bench.plan.plan import Plan
from bench.plan.station import Station
from bench.plan.step_kinds import PlannedPrompt

SERIAL = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,39}")  # a folder of the session is named after it
NO_SERIAL = "is not a serial number: letters, digits, '.', '_' and '-', at most 40"
_UNIT = "unit"


def check_sets(plan: Plan, station: Station, findings: Findings) -> None:
    """Note units without a serial number (B-PLAN-025) and what nobody can do at a simulated bench (B-PLAN-094)."""
    for step in plan.steps:
        for name, value in step.sets.items() if isinstance(step, PlannedPrompt) else ():
            if value is None:
                continue  # its mistake is noted already
            if name == _UNIT and not SERIAL.fullmatch(str(value)):
                findings.add("B-PLAN-025", step.where, f"unit {short(value)} {NO_SERIAL}")
            elif station.file.world is not None:
                _possible(station.file.world.name, name, value, step.where, findings)


def _possible(world: str, name: str, value: Any, where: str, findings: Findings) -> None:
    if world not in offers("worlds"):
        return  # the check of the station says so
    simulation = import_module(SIMULATION)
    try:
        simulation.check_operation(world, name, value)
    except InputError as error:
        findings.add("B-PLAN-094", where, f"'sets': {error.message}", error.next_step)


def short(value: Any) -> str:
    """A value in quotes, cut where it is too long to be read."""
    text = repr(str(value))
    return text if len(text) <= 60 else f"{text[:56]}...'"
