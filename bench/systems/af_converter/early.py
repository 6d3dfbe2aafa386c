"""Early verdicts: does what a run has recorded so far look like the beginning of a good campaign?"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from bench.analysis import Analysis, Check, Document
from bench.model.clock import NS
from bench.record import RecordRow
from bench.systems.af_converter.constants import Campaign, read_campaign

POINT = ("channel", "temperature_degC", "current_A", "polarity", "route", "range_A")
_ENOUGH = 8  # neighbours from which a scatter is judged
_MAD = 0.6745  # median of the absolute value of a standard normal variable


def checks(
    rows: Sequence[RecordRow], campaign: Document, fit: Callable[[], Analysis], limits: Mapping[str, float]
) -> Iterator[Check]:
    """Yield all checks of what is recorded so far; ``campaign``: that section of the manifest; ``fit``: a partial fit.

    Raises: BenchError after the checks that can be made; most often there are too few records yet.
    """
    constants = read_campaign(campaign)
    yield repeat_check(rows, constants, limits["max_dispersion"])
    yield scatter_check(rows, constants, limits["max_dispersion"])
    analysis = fit()
    yield residual_check(analysis, limits["max_residual"])
    yield drift_check(analysis, limits["max_dispersion"])


def repeat_check(rows: Sequence[RecordRow], campaign: Campaign, limit: float) -> Check:
    """The largest change of a point that was measured again, in its standard deviation.

    White noise, whole pulses, the walk of the bias over the time between, and the stability limit of the channel
    (taken as 95 %) explain a change; what is beyond them several times is drift.
    Source: JCGM 100:2008 section 5.1 (independent parts add in squares).
    """
    groups: dict[tuple[Any, ...], list[RecordRow]] = {}
    for row in rows:
        if "channel" in row.window.conditions and row.frames:
            groups.setdefault(tuple(row.window.conditions.get(name) for name in POINT), []).append(row)
    changes: list[tuple[float, str]] = []
    for first, second in (pair for group in groups.values() for pair in pairwise(group)):
        number = int(first.window.conditions["channel"])
        where = f"records {first.window.number} and {second.window.number}, channel {number}"
        changes.append((_change(first, second, number, campaign), where))
    found = [(change, f"{len(changes)} pairs; largest: {where if change else 'none'}") for change, where in changes]
    return _worst("repeated points", limit, found, "no point was measured twice yet")


def scatter_check(rows: Sequence[RecordRow], campaign: Campaign, limit: float) -> Check:
    """Scatter of neighbouring open records of the same channel against the declared noise.

    The median keeps a slow change and a few bad records out of it.
    """
    pairs, found = _neighbours(rows), []
    for channel in campaign.channels if len(pairs) >= _ENOUGH else ():
        scatter = float(np.median([_change(*pair, channel.number, campaign) for pair in pairs])) / _MAD
        if scatter > 0.0:
            found.append((scatter, f"channel {channel.number}, {len(pairs)} neighbours"))
    return _worst("scatter of neighbours", limit, found, f"fewer than {_ENOUGH} neighbours so far")


def residual_check(analysis: Analysis, limit: float) -> Check:
    """The largest residual of a partial fit, in the standard deviation that the declared noise gives it."""
    found = [
        (
            abs(one["residual_ppm"]) / one["std_ppm"],
            f"record {one['number']}, channel {one['channel']} at {one['temperature_degC']:g} degC",
        )
        for one in analysis.residuals
        if math.isfinite(one["residual_ppm"]) and one["std_ppm"] > 0
    ]
    return _worst("residuals", limit, found, "nothing is fitted yet")


def drift_check(analysis: Analysis, limit: float) -> Check:
    """Return the largest drift between a first visit and its repeat, in its own standard uncertainty."""
    found = [
        (abs(entry.value) / entry.std_uncertainty, f"{entry.quantity} is {entry.value:.3g} {entry.unit}")
        for entry in analysis.estimates
        if str(entry.quantity).endswith("_drift") and entry.std_uncertainty
    ]
    return _worst("drift", limit, found, "no channel was visited again yet")


def _worst(name: str, limit: float, found: Sequence[tuple[float, str]], none: str) -> Check:
    """Judge the largest figure that was found, with the words for it; ``none``: what to say without any."""
    if not found:
        return Check(name, None, None, limit, none)
    worst, text = max(found, key=lambda pair: pair[0])
    return Check(name, worst <= limit, worst, limit, text)


def _neighbours(rows: Iterable[RecordRow]) -> list[tuple[RecordRow, RecordRow]]:
    """Return pairs of open records that follow each other without a gap: a ramp's windows."""
    opened = [row for row in rows if row.window.conditions.get("route") == "open" and row.frames]
    return [
        (first, second)
        for first, second in pairwise(opened)
        if second.window.first_counter == first.window.first_counter + first.window.frames
    ]


def _change(first: RecordRow, second: RecordRow, number: int, campaign: Campaign) -> float:
    """|difference of two mean currents| in its standard deviation."""
    channel = campaign.channel(number)
    first_A, second_A = (_current_A(row, number, channel.k0_C) for row in (first, second))
    lengths_s = [(row.window.t_end_ns - row.window.t_start_ns) / NS for row in (first, second)]
    apart_h = abs(second.window.t_start_ns - first.window.t_start_ns) / NS / 3600.0
    variance = (
        channel.noise.walk_A_rth**2 * apart_h + ((channel.stability_limit_ppm or 0.0) * 1e-6 * first_A / 1.96) ** 2
    )
    for length_s in lengths_s:
        variance += channel.noise.white_A_rtHz**2 / (2.0 * length_s) + (channel.k0_C / length_s) ** 2 / 6.0
    return abs(second_A - first_A) / math.sqrt(variance)


def _current_A(row: RecordRow, number: int, k0_C: float) -> float:
    """Mean current of a record by the good frames it holds, ampere; nominal charge per pulse."""
    length_s = (row.window.t_end_ns - row.window.t_start_ns) / NS * row.frames / row.window.frames
    return float(row.sums["npp"][number - 1] - row.sums["ppp"][number - 1]) * k0_C / length_s
