"""Counts of a ring laser from an imported log: rate, angle random walk and quantisation (docs/importing.md).

Counts that were latched at the same place of each dither period, or of a gyroscope without dither.

Source: IEEE Std 647 and 952-1997 annex C (noise terms); lock-in paper equation (1) for the alignment error by bias.
"""

from __future__ import annotations

import numpy as np

from bench.analysis import (
    Analysis,
    Document,
    Estimates,
    Figure,
    Floats,
    Material,
    Table,
    curve,
    estimate,
    noise_evidence,
    possible_terms,
    with_uncertainty,
    worded_table,
)
from bench.maths.allan_terms import GYRO_TERMS
from bench.maths.long_terms import NoiseAtRest, noise_at_rest
from bench.model.errors import FitError
from bench.systems.lock_in.estimators.steadiness import bias_alignment_error_deg
from bench.systems.lock_in.wording import say

METHODS = ("allan",)
_UNEVEN = 0.05  # of the interval: rows that are further from even times are no record of counts over one interval


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Return mean rate and noise terms of one ring laser.

    Raises: FitError B-FIT-169 if the log holds no counts at even times; B-FIT-030, -031.
    """
    rate_deg_h, interval_s = _rates(material)
    noise = noise_at_rest(rate_deg_h, interval_s)
    entries = _estimates(rate_deg_h, noise) + _alignment(noise, material.campaign.get("laser"), rate_deg_h.size)
    possible = [say(f"term.{GYRO_TERMS[name][0]}") for name in noise.long.possible]
    sensor, terms = say("log.sensor"), [entry.quantity for entry in entries[1:]]  # behind the mean rate
    return Analysis(
        "rlg_count_log",
        method,
        material.campaign["uut"],
        entries,
        notes=[
            say("log.intervals", count=rate_deg_h.size, seconds=interval_s),
            say("log.latched"),
            *possible_terms(noise, sensor, possible),
        ],
        tables=[_table(entries)],
        figures=[_figure(noise)],
        evidence=list(noise_evidence(noise, sensor, terms, {})),
    )


def _rates(material: Material) -> tuple[Floats, float]:
    """Return the rate over each interval, (n,), deg/h, NaN where a count is missing, and the interval."""
    t_s = material.series.get("t_s", np.empty(0))
    roles = ("count", "count_increment")
    columns = [column for column in material.campaign.get("columns", ()) if column.get("role") in roles]
    if len(columns) != 1:
        raise _unusable(f"{len(columns)} columns of counts, one is due")
    if t_s.size < 4:
        raise _unusable(f"{t_s.size} rows are too few")
    interval_s = float(np.mean(np.diff(t_s)))
    off_s = np.abs(t_s - t_s[0] - interval_s * np.arange(t_s.size)).max()
    if off_s > _UNEVEN * interval_s:
        raise _unusable(f"the rows do not lie {interval_s:.6g} s apart, one is {off_s:.3g} s off")
    counts = material.series[str(columns[0]["name"])]
    turned = np.diff(counts) if columns[0]["role"] == "count" else counts
    if not np.nanstd(turned) > 0.0:
        raise _unusable("it advances by the same number in every interval")
    return turned * float(material.campaign["count_scale_deg"]) * 3600.0 / interval_s, interval_s


def _estimates(rate_deg_h: Floats, noise: NoiseAtRest) -> Estimates:
    n, long = int(np.isfinite(rate_deg_h).sum()), noise.long
    counted, place = {"n": n, "dropped": rate_deg_h.size - n}, {"kind": "gyro"}
    mean = float(np.nanmean(rate_deg_h))
    entries = [estimate("mean_rate", "deg/h", mean, long.std, place, factor=long.expanded / long.std, **counted)]
    for term in noise.stated:
        name, unit, factor = GYRO_TERMS[term.name]
        value, std = factor * term.coefficient, factor * term.std_uncertainty
        entries.append(estimate(name, unit, value, std, place, **counted))
    return entries


def _alignment(noise: NoiseAtRest, laser: Document | None, n: int) -> Estimates:
    """Return the alignment error that the bias leaves, where the log shows one and the mapping says the latitude."""
    for term in noise.stated:
        if laser and term.name == "bias_instability":
            of_one = bias_alignment_error_deg(1.0, float(laser["latitude_deg"]))
            value, std = of_one * term.coefficient, of_one * term.std_uncertainty
            return [estimate("bias_alignment_error", "deg", value, std, {"kind": "gyro"}, n=n)]
    return []


def _table(entries: Estimates) -> Table:
    rows = [
        [
            say(f"term.{entry.quantity}"),
            entry.unit,
            with_uncertainty(entry.value, entry.expanded_uncertainty),
        ]
        for entry in entries
    ]
    return worded_table(say, "log", ["quantity", "unit", "value"], rows, lead=True)


def _figure(noise: NoiseAtRest) -> Figure:
    parts = [
        curve(say("log.measured"), noise.deviation.tau_s, noise.deviation.deviation, "points"),
        curve(say("log.fit"), *noise.fitted),
    ]
    return Figure(say("log.figure"), "", say("axis.averaging_time"), "deg/h", parts, x_log=True, y_log=True)


def _unusable(why: str) -> FitError:
    return FitError(
        "B-FIT-169",
        f"the log is no record of a ring laser's counts: {why}",
        next_step="map one column of the role count or count_increment, read at even times (docs/importing.md)",
    )
