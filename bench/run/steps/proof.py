"""What a unit must prove before the first stimulus: wiring and polarity of every channel, and who sits in which slot.

A current moves the right counter of the right channel the right way; where several units share a campaign it moves
nothing in any other one, and each says the serial number of its slot.
"""

from __future__ import annotations

import re

import numpy as np

from bench.model.errors import RunError
from bench.model.quantities import Values
from bench.plan import UNIT, Plan, PlannedCommand, PlannedUnit
from bench.record import RecordRow

TOLERANCE = 0.1


def check_wiring(row: RecordRow, plan: Plan, where: str) -> None:
    """Judge one wiring record.

    No other channel may count more than a tenth of what the current would give it; the channel under current must
    count within 10 % of current x time / charge per pulse on NPP (positive current) or PPP (negative current) and
    almost nothing on the other. Of a unit beside the one under current no channel may count.

    Raises: RunError B-RUN-052 (current reached another unit), B-RUN-051 (another channel), B-RUN-050 (wrong counter,
            polarity or amount).
    """
    conditions = row.window.conditions
    beside = next((unit for unit in plan.units if unit.slot == conditions.get("beside")), None)
    if beside is not None:
        _check_unit_beside(row, plan, beside, where)
        return
    _check_others(row, plan.campaign, where)
    _check_own(row, plan.campaign, where)


def _check_unit_beside(row: RecordRow, plan: Plan, driven: PlannedUnit, where: str) -> None:
    """Judge the record of a unit while another one is driven."""
    charges, conditions = charges_C(plan.campaign), row.window.conditions
    charge_C = float(conditions["current_A"]) * row.frames / float(plan.campaign["rate_Hz"])
    counts = row.sums["npp"] + row.sums["ppp"]
    number = max(charges, key=lambda channel: counts[channel - 1] * charges[channel])
    moved, found = counts[number - 1], plan.unit_of(conditions[UNIT])
    if found is not None and moved > TOLERANCE * charge_C / charges[number]:
        raise RunError(
            "B-RUN-052",
            f"the current for unit {driven.serial} in slot {driven.slot} moves channel {number} of unit {found.serial} "
            f"in slot {found.slot}: counted {moved} there; cables or links of the two slots are exchanged",
            where=where,
            next_step="check the cables of both slots from the switch and from their ports, then start again",
        )


def _check_own(row: RecordRow, campaign: Values, where: str) -> None:
    conditions = row.window.conditions
    channel, polarity = int(conditions["channel"]), int(conditions["polarity"])
    charges = charges_C(campaign)
    seconds = row.frames / float(campaign["rate_Hz"])
    expected = float(conditions["current_A"]) * seconds / charges[channel]
    moved, still = ("npp", "ppp") if polarity > 0 else ("ppp", "npp")
    right, wrong = int(row.sums[moved][channel - 1]), int(row.sums[still][channel - 1])
    level = f"{'+' if polarity > 0 else '-'}{conditions['current_A']:g} A"
    if abs(right - expected) > TOLERANCE * expected or wrong > TOLERANCE * expected:
        raise RunError(
            "B-RUN-050",
            f"channel {channel}, {level}: counted {right} {moved} and {wrong} {still}, "
            f"expected {expected:.0f} {moved} within {TOLERANCE:.0%}",
            where=where,
            next_step="check polarity and channel of the cable between switch and unit, then start again",
        )


def _check_others(row: RecordRow, campaign: Values, where: str) -> None:
    conditions = row.window.conditions
    channel = int(conditions["channel"])
    charges = charges_C(campaign)
    charge_C = float(conditions["current_A"]) * row.frames / float(campaign["rate_Hz"])
    counts = row.sums["npp"] + row.sums["ppp"]
    limits = [TOLERANCE * charge_C / charges.get(number, charges[channel]) for number in range(1, len(counts) + 1)]
    excess = counts - np.array(limits)
    excess[channel - 1] = 0.0
    if (excess > 0).any():
        guilty = int(np.argmax(excess)) + 1
        raise RunError(
            "B-RUN-051",
            f"the current of channel {channel} moves channel {guilty}: counted {counts[guilty - 1]} there and "
            f"{counts[channel - 1]} on channel {channel}",
            where=where,
            next_step="check the cable and the crosspoints, then start again",
        )


def charges_C(campaign: Values) -> dict[int, float]:
    """Return charge per pulse by channel, coulomb."""
    return {int(entry["number"]): float(entry["k0_C"]) for entry in campaign["channels"]}


def names(answer: bytes, serial: str) -> bool:
    """Return whether a serial number is a word of what a unit answers."""
    return serial in re.split(r"[\s,;]+", answer.decode("ascii", "replace"))


def check_identity(plan: Plan, step: PlannedCommand, answer: bytes) -> None:
    """Judge what a unit says of itself against the serial number of its slot; nothing to judge where there is one unit.

    Raises: RunError B-RUN-026, naming the slot where the unit that answers should be.
    """
    unit = plan.unit_of(step.role)
    if unit is None or names(answer, unit.serial):
        return
    other = next((other for other in plan.units if names(answer, other.serial)), None)
    exchanged = "" if other is None else f"; it is the unit of slot {other.slot}: links or units are exchanged"
    raise RunError(
        "B-RUN-026",
        f"slot {unit.slot} answers {answer.decode('ascii', 'replace')!r}, expected {unit.serial}{exchanged}",
        where=step.role,
        next_step="check the links of the slots and the serial numbers under 'units', then start again",
    )
