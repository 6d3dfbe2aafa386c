"""Units under test that share a campaign: each sits in a slot of the station, with links and instruments of its own."""

from __future__ import annotations

from dataclasses import replace

from bench.model.shipped import folder_name
from bench.plan.check.everything import NO_SERIAL, SERIAL, short
from bench.plan.expand import Expander, Node
from bench.plan.findings import suggestion
from bench.plan.language.interlocks import OF_UNIT, InterlockRule
from bench.plan.plan import PlannedUnit
from bench.plan.station import Slot
from bench.plan.values import UnitInSlot, plain

UNITS = "units"  # key of a sequence, and what a loop over them names


def planned_units(outer: Node) -> tuple[PlannedUnit, ...]:
    """Return the units of a sequence in order of the station's slots, () where it has no section ``units``.

    An empty text leaves its slot empty. Mistakes are noted: B-PLAN-140 (no slot, no unit, a link that a slot lacks, or
    something that is not done for several units), B-PLAN-025 (a serial number that is none, or stands twice).
    """
    node, plan = outer.below(UNITS), outer.plan
    named, station = plan.model.units, plan.station
    if named is None:
        return ()
    serials = node.resolve(named)
    texts = [str(plain(serial)) for serial in serials] if isinstance(serials, tuple) else []
    slots = sorted(station.file.slots.items())
    if len(texts) > len(slots) or not any(texts):
        message = f"station {station.name} has {len(slots)} slots for units; {len(texts)} are named"
        node.fail("B-PLAN-140", message, "name a serial number for each slot, '' for an empty one")
        return ()
    _check_possible(node)
    units: list[PlannedUnit] = []
    for (letter, slot), serial in zip(slots, texts, strict=False):
        if serial and _is_complete(plan, letter, slot) and _is_serial(node, serial, units):
            units.append(PlannedUnit(letter, serial, slot.links, slot.roles, slot.card, slot.gradient))
    return tuple(units)


def _check_possible(node: Node) -> None:
    """Note what a sequence of several units cannot have: each of these would have to say which unit it means."""
    plan = node.plan
    if not plan.model.frame:
        node.fail("B-PLAN-140", "the sequence names no link, and units are told apart by theirs")
    for name in ("check_standard", "early", "fits"):
        if getattr(plan.model, name):
            plan.fail("B-PLAN-140", (name,), f"{name!r} is not done for several units", "take it out")


def _is_complete(plan: Expander, letter: str, slot: Slot) -> bool:
    """Note links of the sequence that a slot does not have."""
    missing = [link for link in plan.model.frame if link not in slot.links]
    for link in missing:
        message = f"slot {letter} of station {plan.station.name} has no link {link!r}{suggestion(link, slot.links)}"
        plan.fail("B-PLAN-140", ("frame", link), message, "add it to 'links' of the slot")
    return not missing


def _is_serial(node: Node, serial: str, before: list[PlannedUnit]) -> bool:
    if not SERIAL.fullmatch(serial):
        node.fail("B-PLAN-025", f"{short(serial)} {NO_SERIAL}")
        return False
    if folder_name(serial) in [folder_name(unit.serial) for unit in before]:
        node.fail("B-PLAN-025", f"the unit {serial!r} stands in two slots", "correct one of them")
        return False
    return True


def in_slot(unit: PlannedUnit) -> UnitInSlot:
    """Return the unit as the value of a loop over ``units``."""
    return UnitInSlot(unit.serial, unit.slot, unit.card)


def rules_of_units(rules: tuple[InterlockRule, ...], units: tuple[PlannedUnit, ...]) -> tuple[InterlockRule, ...]:
    """Return the interlocks with one of each unit for what a unit tells of itself; it is ``of`` the unit's first link.

    The name gets the slot: ``unit_hot`` becomes ``unit_hot_a``.
    """
    if not units:
        return rules
    several = []
    for rule in rules:
        if rule.signal in OF_UNIT:
            several += [
                replace(rule, name=f"{rule.name}_{unit.slot.lower()}", of=next(iter(unit.links.values())))
                for unit in units
            ]
        else:
            several.append(rule)
    return tuple(several)
