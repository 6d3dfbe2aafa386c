"""Static check of a campaign that several units share: what proves each of them before the first stimulus."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from bench.plan.findings import Findings
from bench.plan.plan import Plan, PlannedUnit, Step
from bench.plan.station import Station
from bench.plan.step_kinds import MEASUREMENT, WIRING, PlannedCommand, PlannedRecord
from bench.plan.values import UNIT

IDENTIFY = "identify"  # the command whose answer says who the unit is


def check_units(plan: Plan, station: Station, findings: Findings) -> None:
    """Note a unit whose serial number or wiring nothing proves before it is measured (B-PLAN-142)."""
    where = station.document.where(("slots",)) if plan.units else ""
    for unit in plan.units:
        own = [step for step in plan.steps if step.conditions.get(UNIT) == unit.serial]
        for missing in _missing(unit, own):
            message = f"unit {unit.serial} in slot {unit.slot}: {missing}"
            findings.add("B-PLAN-142", where, message, "add it to 'prepare', inside 'for: unit', 'in: units'")


def _missing(unit: PlannedUnit, steps: Sequence[Step]) -> Iterator[str]:
    """Yield what is not proved of a unit, in words."""
    records = [step for step in steps if isinstance(step, PlannedRecord)]
    measured = [record for record in records if record.purpose == MEASUREMENT]
    if not measured:
        yield "nothing of it is measured"
        return
    before = [step for step in steps if step.number < measured[0].number]
    if not any(isinstance(step, PlannedCommand) and step.name == IDENTIFY for step in before):
        yield f"it is not asked for its serial number ({IDENTIFY!r}) before it is measured"
    wired = {_input(record) for record in before if isinstance(record, PlannedRecord) and record.purpose == WIRING}
    driven = {_input(record) for record in measured if record.conditions.get("polarity")}
    if unproved := sorted(driven - wired, key=str):
        channel, polarity = unproved[0]
        yield f"no wiring record proves channel {channel}, polarity {polarity}, before it is measured"


def _input(record: PlannedRecord) -> tuple[object, object]:
    return record.conditions.get("channel"), record.conditions.get("polarity")
