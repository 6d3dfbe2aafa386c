"""Temperature of the unit during each record: measured, or interpolated over a short gap; never the set-point."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bench.record import UNIT_TEMPERATURE

if TYPE_CHECKING:
    from bench.record import RecordRow

LONGEST_REACH_s = 600.0
_WANDER_degC = 0.05  # standard: how far a unit that takes tens of minutes to follow its chamber leaves a straight line


@dataclass(frozen=True)
class UnitTemperature:
    """Mean temperature of the unit during a record.

    ``std_degC``: standard uncertainty of an interpolation, 0 where the temperature was measured; ``gap``: records with
    the same number share one error of interpolation, 0 where measured.
    """

    value_degC: float
    std_degC: float = 0.0
    gap: int = 0


def unit_temperatures(rows: Iterable[RecordRow]) -> dict[int, UnitTemperature]:
    """Return temperatures by record number; a record whose temperature is not known is not in the answer.

    A record without housekeeping takes the straight line in time between the nearest records of its link that have
    some, one before and one after, both at the same nominal temperature and, middle to middle, not more than
    ``LONGEST_REACH_s`` away. The uncertainty is that of a rectangular distribution between the two (standard deviation
    of their difference over sqrt(12)) and of ``_WANDER_degC``, and common to all records of the gap.
    """
    found: dict[int, UnitTemperature] = {}
    by_link: dict[str, list[RecordRow]] = {}
    for row in sorted(rows, key=lambda row: row.window.number):
        by_link.setdefault(row.window.link, []).append(row)
    for members in by_link.values():
        known = {index: value for index, row in enumerate(members) if (value := _measured(row)) is not None}
        for index, row in enumerate(members):
            one = UnitTemperature(known[index]) if index in known else _between(members, known, index)
            if one is not None:
                found[row.window.number] = one
    return found


def _measured(row: RecordRow) -> float | None:
    value = float(row.context.get(UNIT_TEMPERATURE, float("nan")))
    return value if np.isfinite(value) else None


def _between(members: list[RecordRow], known: Mapping[int, float], index: int) -> UnitTemperature | None:
    before = max((other for other in known if other < index), default=None)
    after = min((other for other in known if other > index), default=None)
    if before is None or after is None:
        return None
    nominal = [members[one].window.conditions.get("temperature_degC") for one in (before, index, after)]
    back_s, ahead_s = (
        _middle_s(members[index]) - _middle_s(members[before]),
        _middle_s(members[after]) - _middle_s(members[index]),
    )
    if len(set(nominal)) > 1 or not (0 < back_s <= LONGEST_REACH_s and 0 < ahead_s <= LONGEST_REACH_s):
        return None
    step_degC = known[after] - known[before]
    return UnitTemperature(
        value_degC=known[before] + step_degC * back_s / (back_s + ahead_s),
        std_degC=float(np.hypot(step_degC / np.sqrt(12.0), _WANDER_degC)),
        gap=before + 1,
    )


def _middle_s(row: RecordRow) -> float:
    return 0.5e-9 * (row.window.t_start_ns + row.window.t_end_ns)
