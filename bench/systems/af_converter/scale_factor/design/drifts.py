"""How surely the repeats of a campaign show that the calibrator moved: steadily, or in one step, by what costs 1 U.

How surely a campaign would show what else could be true: each listed rival, at the size that costs 1 U.

A rival is put into the counts of a nominal unit; the fit itself says how far it moves the results and how large its
chi-square becomes. Both grow with the size, chi-square with its square, which gives the one that costs 1 U.
Source: docs/decisions/0025-doubt.md; noncentral chi-square: Scheffé, The Analysis of Variance (1959), 2.8.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy import special

from bench.analysis import FALSE_DOUBT, Estimates
from bench.design import Power
from bench.maths.arrays import Floats
from bench.maths.verdict import coverage_factor
from bench.systems.af_converter.constants import Campaign, Standards
from bench.systems.af_converter.estimators.readings import Readings
from bench.systems.af_converter.estimators.scale_factor import fit_scale_factor
from bench.systems.af_converter.group_fit import QUANTITIES
from bench.systems.af_converter.scale_factor.design.template import Point, Stop

_TRIED = 1e-3  # relative size of a rival in the counts: far above a whole pulse
_NO_MOVE = 1e-4  # of its size: what moves a result less than that costs it nothing
_CHECKS_OF_A_VISIT = 3


def visit_readings(points: Sequence[Point], length_s: float, channel: int, campaign: Campaign) -> Readings:
    """Return what a nominal unit counts in the closed records of a visit."""
    closed = [point for point in points if point.conditions.get("route", "closed") != "open"]
    level_A = np.array([point.level_A for point in closed])
    polarity, range_A = (
        np.array([float(point.conditions[name]) for point in closed]) for name in ("polarity", "range_A")
    )
    pulses = level_A * length_s / campaign.channel(channel).k0_C
    nothing, gate_s = np.zeros(level_A.size), np.full(level_A.size, length_s)
    return Readings(
        polarity=polarity,
        level_A=level_A,
        range_A=range_A,
        n_count=np.where(polarity > 0, pulses, 0.0),
        p_count=np.where(polarity < 0, pulses, 0.0),
        af_count=campaign.af_clock_Hz * gate_s,
        gate_s=gate_s,
        gaps=nothing,
        time_s=np.cumsum([point.lead_s + length_s for point in closed]),
        unit_temperature_degC=nothing,
        temperature_std_degC=nothing,
        temperature_gap=nothing,
        scatter=nothing,
        scatter_dof=nothing,
        halves=np.full(level_A.size, np.nan),
    )


def rivals(rows: Readings) -> Iterator[tuple[str, Floats]]:
    """Yield the rivals of a straight line through the levels: name, and relative error of each row, (m,)."""
    share = rows.level_A / rows.level_A.max()
    yield "soft end of the converter", -(share**4)
    yield "saturation of the largest level", -1.0 * (share == 1.0)
    yield "bend of even order", rows.polarity * share
    yield "one polarity lost in part", -share * (rows.polarity < 0)
    for range_A in sorted(set(rows.range_A.tolist())):
        inside = (rows.range_A == range_A) & (rows.level_A > 0)
        if inside.any():
            smallest = rows.level_A[inside].min()
            yield (
                f"first record of the range {range_A:g} A",
                -1.0 * (inside & (rows.level_A == smallest) & (rows.polarity > 0)),
            )
            yield (
                f"offset of the range {range_A:g} A",
                np.where(inside, smallest / np.where(inside, rows.level_A, 1.0), 0.0),
            )


def visit_powers(
    rows: Readings, channel: int, campaign: Campaign, standards: Standards, U_ppm: Mapping[str, float], visits: int
) -> Iterator[tuple[str, str, float]]:
    """Yield rival, quantity and power for the quantities that ``U_ppm`` has: dsf_n, dsf_p, dsf_asymmetry.

    ``visits``: of the campaign, whose checks share the chance of a false doubt.
    """
    converter = campaign.converter(channel)
    base = fit_scale_factor(rows, converter, standards.ranges)
    limit = special.chdtri(base.dof, FALSE_DOUBT / (_CHECKS_OF_A_VISIT * visits))
    for name, pattern in rivals(rows):
        counts = 1.0 + _TRIED * pattern
        wrong = replace(rows, n_count=rows.n_count * counts, p_count=rows.p_count * counts)
        fit = fit_scale_factor(wrong, converter, standards.ranges)
        n_ppm, p_ppm = fit.dsf_ppm - base.dsf_ppm
        for quantity, move_ppm in (("dsf_n", n_ppm), ("dsf_p", p_ppm), ("dsf_asymmetry", n_ppm - p_ppm)):
            if abs(move_ppm) > 1e6 * _TRIED * _NO_MOVE:
                noncentrality = fit.chi2 * (U_ppm[quantity] / move_ppm) ** 2
                yield name, quantity, float(1.0 - special.chndtr(limit, base.dof, noncentrality))


def power_of_change(change: float, std: float) -> float:
    """Return the probability that a change is seen outside of its expanded uncertainty (95 %)."""
    return float(special.ndtr(abs(change) / std - coverage_factor()))


def drift_powers(
    stops: Sequence[Stop],
    at_s: Sequence[float],
    again: Sequence[tuple[int, int]],
    reference_degC: float,
    estimates: Estimates,
) -> list[Power]:
    """Return how surely a steady drift, and one step at the worst time, would be seen by the repeats.

    Args:    at_s: mean time of each stop, second.   again: stop and channel of each repeat.   estimates: of the
             campaign, which hold U and what a repeat resolves.
    """
    share = (np.array(at_s) - at_s[0]) / (at_s[-1] - at_s[0])
    steps = [np.asarray(np.arange(len(stops)) > last, float) for last in range(len(stops) - 1)]
    stds_ppm = [entry.std_uncertainty for entry in estimates if entry.quantity == "calibrator_drift"]
    resolved = [(_first(stops, number), number, std) for (number, _), std in zip(again, stds_ppm, strict=True)]
    powers = []
    for name, patterns in (("steady drift of the calibrator", [share]), ("one step of the calibrator", steps)):
        for quantity in (f"{QUANTITIES[0]}_tc1", f"{QUANTITIES[0]}_tc2"):
            sizes = [_size_ppm(pattern, stops, reference_degC, quantity, estimates) for pattern in patterns]
            worst = min(_power(size, pattern, resolved) for size, pattern in zip(sizes, patterns, strict=True))
            powers.append(Power(name, quantity, worst))
    return powers


def coefficients_at_least(
    stops: Sequence[Stop], at_s: Sequence[float], noise_ppm: float, resolved_ppm: float, reference_degC: float
) -> tuple[float, float]:
    """Return about what the coefficients of first and second order are uncertain by, 95 %: to choose what is fitted.

    Args:    noise_ppm: standard uncertainty of a visit.   resolved_ppm: that of the change between first and last stop.
    """
    visits = [number for number, stop in enumerate(stops) if not stop.repeat]
    warmth = np.array([stops[number].temperature_degC for number in visits]) - reference_degC
    operator = np.linalg.pinv(np.vander(warmth, 3, increasing=True))[1:]
    share = (np.array(at_s)[visits] - at_s[0]) / (at_s[-1] - at_s[0])
    noise = noise_ppm * np.sqrt(np.sum(operator**2, axis=1))
    drift = coverage_factor() * resolved_ppm / 2.0 * np.abs(operator @ share)
    first, second = coverage_factor() * np.hypot(noise, drift)
    return float(first), float(second)


def _first(stops: Sequence[Stop], number: int) -> int:
    return next(
        at
        for at, stop in enumerate(stops)
        if (stop.temperature_degC, stop.repeat) == (stops[number].temperature_degC, 0)
    )


def _size_ppm(
    pattern: Floats, stops: Sequence[Stop], reference_degC: float, quantity: str, estimates: Estimates
) -> float:
    """Return how large a change of the calibrator in this pattern costs a coefficient 1 U, ppm."""
    visits = [number for number, stop in enumerate(stops) if not stop.repeat]
    warmth = np.array([stops[number].temperature_degC for number in visits]) - reference_degC
    operator = np.linalg.pinv(np.vander(warmth, 3, increasing=True))
    move = abs(float(operator[int(quantity[-1])] @ pattern[visits]))
    U = min(entry.expanded_uncertainty for entry in estimates if entry.quantity == quantity)
    return U / move if move > 1e-12 else np.inf


def _power(size_ppm: float, pattern: Floats, resolved: Sequence[tuple[int, int, float]]) -> float:
    if size_ppm == np.inf:
        return 1.0
    changes = [(size_ppm * float(pattern[last] - float(pattern[first])), std_ppm) for first, last, std_ppm in resolved]
    return max((power_of_change(change, std_ppm) for change, std_ppm in changes), default=0.0)
