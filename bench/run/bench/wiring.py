"""Wiring check: a small known current must move the right counter of the right channel the right way."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bench.model.errors import RunError
from bench.record import RecordRow

TOLERANCE = 0.1


def check_wiring(row: RecordRow, campaign: Mapping[str, Any], where: str) -> None:
    """Judge one wiring record.

    No other channel may count more than a tenth of what the current would give it; the channel under current must
    count within 10 % of current x time / charge per pulse on NPP (positive current) or PPP (negative current) and
    almost nothing on the other.

    Raises: RunError B-RUN-051 (current reached another channel), B-RUN-050 (wrong counter, polarity or amount).
    """
    _check_others(row, campaign, where)
    _check_own(row, campaign, where)


def _check_own(row: RecordRow, campaign: Mapping[str, Any], where: str) -> None:
    conditions = row.window.conditions
    channel, polarity = int(conditions["channel"]), int(conditions["polarity"])
    charges = _charges_C(campaign)
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


def _check_others(row: RecordRow, campaign: Mapping[str, Any], where: str) -> None:
    conditions = row.window.conditions
    channel = int(conditions["channel"])
    charges = _charges_C(campaign)
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


def _charges_C(campaign: Mapping[str, Any]) -> dict[int, float]:
    """Charge per pulse by channel, coulomb."""
    return {int(entry["number"]): float(entry["k0_C"]) for entry in campaign["channels"]}
