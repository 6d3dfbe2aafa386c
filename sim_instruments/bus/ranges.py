"""DC current ranges of the calibrator (Table 2): full scale, what each one holds, offset floor."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CurrentRange:
    """One range: full scale it is named after (ampere), decimals a setting has, 95 % floor of Table 2 (ampere)."""

    full_scale_A: float
    decimals: int
    floor_A: float


CURRENT_RANGES = (
    CurrentRange(2.2e-4, 10, 6e-9),
    CurrentRange(2.2e-3, 9, 7e-9),
    CurrentRange(2.2e-2, 8, 4e-8),
    CurrentRange(2.2e-1, 7, 7e-7),
    CurrentRange(2.2, 6, 1.2e-5),
)


def lowest_range(current_A: float) -> int | None:
    """Index of the lowest range that holds a current (either sign), None above 2.2 A."""
    return next((i for i, r in enumerate(CURRENT_RANGES) if abs(current_A) <= r.full_scale_A * (1 + 1e-12)), None)
