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
    worst, where = 0.0, ""
    groups: dict[tuple[Any, ...], list[RecordRow]] = {}
    for row in rows:
        if "channel" in row.window.conditions and row.frames:
            groups.setdefault(tuple(row.window.conditions.get(name) for name in POINT), []).append(row)
    pairs = [pair for group in groups.values() for pair in pairwise(group)]
    for first, second in pairs:
        channel = campaign.channel(int(first.window.conditions["channel"]))
        change = _change(first, second, channel.number, campaign)
        if change > worst:
            worst, where = change, f"records {first.window.number} and {second.window.number}, channel {channel.number}"
    if not pairs:
        return Check("repeated points", None, None, limit, "no point was measured twice yet")
    return Check("repeated points", worst <= limit, worst, limit, f"{len(pairs)} pairs; largest: {where or 'none'}")


def scatter_check(rows: Sequence[RecordRow], campaign: Campaign, limit: float) -> Check:
    """Scatter of neighbouring open records of the same channel against the declared noise.

    The median keeps a slow change and a few bad records out of it.
    """
    worst, where = 0.0, ""
    for number, pairs in _neighbours(rows, campaign):
        changes = [_change(first, second, number, campaign) for first, second in pairs]
        if len(changes) >= _ENOUGH and (scatter := float(np.median(changes)) / _MAD) > worst:
            worst, where = scatter, f"channel {number}, {len(changes)} neighbours"
    if not where:
        return Check("scatter of neighbours", None, None, limit, f"fewer than {_ENOUGH} neighbours so far")
    return Check("scatter of neighbours", worst <= limit, worst, limit, where)


def residual_check(analysis: Analysis, limit: float) -> Check:
    """The largest residual of a partial fit, in the standard deviation that the declared noise gives it."""
    judged = [
        (abs(residual["residual_ppm"]) / residual["std_ppm"], residual)
        for residual in analysis.residuals
        if math.isfinite(residual["residual_ppm"]) and residual["std_ppm"] > 0
    ]
    if not judged:
        return Check("residuals", None, None, limit, "nothing is fitted yet")
    worst, residual = max(judged, key=lambda pair: pair[0])
    text = f"record {residual['number']}, channel {residual['channel']} at {residual['temperature_degC']:g} degC"
    return Check("residuals", worst <= limit, worst, limit, text)


def drift_check(analysis: Analysis, limit: float) -> Check:
    """Return the largest drift between a first visit and its repeat, in its own standard uncertainty."""
    drifts = [
        (abs(entry.value) / entry.std_uncertainty, entry)
        for entry in analysis.estimates
        if str(entry.quantity).endswith("_drift") and entry.std_uncertainty
    ]
    if not drifts:
        return Check("drift", None, None, limit, "no channel was visited again yet")
    worst, entry = max(drifts, key=lambda pair: pair[0])
    return Check("drift", worst <= limit, worst, limit, f"{entry.quantity} is {entry.value:.3g} {entry.unit}")


def _neighbours(
    rows: Iterable[RecordRow], campaign: Campaign
) -> Iterator[tuple[int, list[tuple[RecordRow, RecordRow]]]]:
    """Yield pairs of open records that follow each other without a gap, for every channel: a ramp's windows."""
    opened = [row for row in rows if row.window.conditions.get("route") == "open" and row.frames]
    pairs = [
        (first, second)
        for first, second in pairwise(opened)
        if second.window.first_counter == first.window.first_counter + first.window.frames
    ]
    for channel in campaign.channels:
        yield channel.number, pairs


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
        variance += channel.noise.white_A_rtHz**2 / length_s + (channel.k0_C / length_s) ** 2 / 6.0
    return abs(second_A - first_A) / math.sqrt(variance)


def _current_A(row: RecordRow, number: int, k0_C: float) -> float:
    """Mean current of a record by the good frames it holds, ampere; nominal charge per pulse."""
    length_s = (row.window.t_end_ns - row.window.t_start_ns) / NS * row.frames / row.window.frames
    return float(row.sums["npp"][number - 1] - row.sums["ppp"][number - 1]) * k0_C / length_s
