"""What a reader of the results of the DMM method must know, in sentences and a table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from bench.analysis import Table
from bench.systems.af_converter.constants import Campaign
from bench.systems.af_converter.dmm_method.estimates import DmmFit
from bench.systems.af_converter.dmm_method.readings import MeterLog
from bench.systems.af_converter.groups import Group

STEADY_degC = 0.05  # at 8 ppm/degC less than half a ppm between the first record of a channel and its last
_TESTS = {"repeat_shift": "points taken again", "switch_leakage": "zeros against the open input"}


def notes(
    fits: Sequence[DmmFit], groups: Iterable[Group], estimates: Sequence[Mapping[str, Any]], campaign: Campaign
) -> list[str]:
    """Return all notes but those on missing groups."""
    sentences = _refusal(fits) + [_assumption(name, estimates) for name in _TESTS]
    left_out: Counter[str] = Counter()
    for group in groups:
        left_out.update(group.left_out)
    sentences += [f"{count} records left out of the fits: {reason}." for reason, count in sorted(left_out.items())]
    without = sum(int(np.count_nonzero(np.isnan(fitted.meter.current_A))) for fitted in fits)
    if without:
        sentences.append(f"{without} records without a reading of the meter are left out of the fits.")
    if any(np.any(np.isnan(fitted.meter.zero_std_A[np.isfinite(fitted.meter.current_A)])) for fitted in fits):
        sentences.append(
            "The zero of the meter was not measured on every range; its specification stands in for it there."
        )
    moved_degC = max(float(np.ptp(fitted.group.closed.unit_temperature_degC)) for fitted in fits)
    if moved_degC > STEADY_degC:
        sentences.append(
            f"The unit's temperature moved by up to {moved_degC:.2f} degC during the records of a channel; the method "
            "has no temperature coefficients that would refer them to one temperature."
        )
    sentences += [
        "The gains of the meter's ranges are added as if they were fully correlated, because nothing says how far they "
        "are; the stated uncertainty is the largest that this can make.",
        "The uncertainty of the unit's temperature is not included: the method has no temperature coefficients.",
        "The bias is diagnostic: it comes from one open record and never enters the compensation.",
    ]
    return sentences


def _refusal(fits: Sequence[DmmFit]) -> list[str]:
    refused = [fitted for fitted in fits if fitted.fit.refusal]
    if not refused:
        return []
    reason = refused[0].fit.refusal
    conditions = sorted(fitted.fit.condition for fitted in refused)
    means = ", ".join(
        f"channel {fitted.group.channel} {fitted.fit.value_ppm['dsf_mean']:+.1f} "
        f"({1.96 * fitted.fit.std_ppm['dsf_mean']:.1f})"
        for fitted in refused
    )
    return [
        f"K_N and K_P are refused, only their mean (dsf_mean) is stated: {reason}. Over all channels the condition "
        f"number is {conditions[0]:.0f} to {conditions[-1]:.0f}.",
        f"Mean of both in ppm, with its expanded uncertainty: {means}.",
    ]


def _assumption(quantity: str, estimates: Sequence[Mapping[str, Any]]) -> str:
    tested = [estimate for estimate in estimates if estimate["quantity"] == quantity]
    what = _TESTS[quantity]
    if not tested:
        return f"Assumption 2 of the DMM method is not tested by {what}: the session holds none."
    seen = [estimate for estimate in tested if abs(estimate["value"]) > estimate["expanded_uncertainty"]]
    largest = max(tested, key=lambda estimate: abs(estimate["value"]))
    (value, expanded), unit = _shown(largest)
    verdict = "no more than chance explains" if _chance(len(seen), len(tested)) else "more than chance explains"
    return (
        f"Assumption 2, tested by {what} ({quantity}): {len(seen)} of {len(tested)} are outside of their 95 % "
        f"interval, {verdict}; the largest is {value:.3g} {unit} with an expanded uncertainty of {expanded:.2g} {unit}."
    )


def _shown(estimate: Mapping[str, Any]) -> tuple[tuple[float, float], str]:
    scale, unit = (1e9, "nA") if estimate["unit"] == "A" else (1.0, str(estimate["unit"]))
    return (scale * estimate["value"], scale * estimate["expanded_uncertainty"]), unit


def _chance(outside: int, tested: int) -> bool:
    """Whether so many of independent 95 % intervals may miss zero by chance, at about three standard deviations."""
    return bool(outside <= 0.05 * tested + 3.0 * (0.05 * 0.95 * tested) ** 0.5)


def zero_table(log: MeterLog) -> list[Table]:
    """Zeros of the meter's ranges."""
    rows = [[1e3 * range_A, 1e9 * zero_A, 1e9 * std_A] for range_A, (zero_A, std_A) in sorted(log.zeros_A.items())]
    if not rows:
        return []
    headers = ["range, mA", "zero, nA", "standard uncertainty, nA"]
    caption = "Measured with nothing connected, and subtracted: the meter sees one polarity, so no zero cancels."
    return [Table("Zeros of the meter", caption, headers, rows)]
