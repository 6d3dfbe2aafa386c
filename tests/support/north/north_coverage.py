"""Campaigns of eight samples by the second simulation, for the coverage of every interval that is stated.

Constant parameters, and amplitude and swing that change slowly by 20 %; noise of the paper, or less of it.
"""

from __future__ import annotations

from collections.abc import Iterator

import north_simulation as sim
import numpy as np
from fog_material import record_row
from numpy.typing import NDArray

from bench.maths.verdict import coverage_factor
from bench.record import RecordRow
from bench.systems.north.estimators.phasors import wrapped_deg
from bench.systems.north.sets import NorthSet
from bench.systems.north.solution import Site, Solution
from bench.systems.north.solve import solve

FS_Hz, MARK_deg = 40, 20.0
Float = NDArray[np.float64]
Plan = dict[str, tuple[float, ...]]  # heads of each item, one for each set
METHODS = ("least_squares", "likelihood", "quadrant", "literal")
TIMES_S = np.arange(0.5 / FS_Hz, sim.TURNS, 1.0 / FS_Hz)
RECORDS = np.repeat(np.arange(4), sim.TURNS * FS_Hz // 4)


def campaigns(kind: str, count: int, noise: float, plan: Plan, seed: int) -> Iterator[tuple[Solution, Float]]:
    """Yield solutions with the true heading of each set."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        field_deg = rng.uniform(-180.0, 180.0)
        sets, true_deg = [], []
        for item, heads in plan.items():
            for repeat, head_deg in enumerate(heads, 1):
                heading_deg = field_deg if item == "search" else MARK_deg + head_deg
                place = "field" if item == "search" else "mark"
                u_V, theta_deg = waveform_of(kind, heading_deg, noise, rng)
                u1, u2 = eight_of(u_V)
                t_s = float(len(sets))
                own = NorthSet(item, place, head_deg, repeat, 360.0, u1, u2, begin_s=t_s, end_s=t_s)
                own.rows = rows_of(u_V, theta_deg)
                sets.append(own)
                true_deg.append(heading_deg)
        yield solve(sets, Site(37.0, MARK_deg)), np.array(true_deg)


def waveform_of(kind: str, heading_deg: float, noise: float, rng: np.random.Generator) -> tuple[Float, Float]:
    """Output in volt and table angle in degrees of the four records of a set, one behind the other."""
    gain = 1.0 + sim.wander(kind, TIMES_S, rng)
    theta = 2 * np.pi * TIMES_S + np.pi / 2 * RECORDS
    u_V = gain * np.cos(np.deg2rad(heading_deg) - theta) + noise * rng.standard_normal(TIMES_S.size)
    return u_V, np.rad2deg(theta)


def eight_of(u_V: Float) -> tuple[Float, Float]:
    """Eight samples (4,) of lock-in 1 and 2: references are sines, no index pulse is misplaced."""
    at = 2 * np.pi * TIMES_S
    means = [np.array([2.0 * np.mean((u_V * one)[k == RECORDS]) for k in range(4)]) for one in (np.cos(at), np.sin(at))]
    return means[0], means[1]


def rows_of(u_V: Float, theta_deg: Float) -> dict[int, RecordRow]:
    """The same as records by index position."""
    return {k + 1: record_row(0.0, [], u_V[k == RECORDS], theta_deg[k == RECORDS], {}, FS_Hz) for k in range(4)}


def covered(kind: str, count: int, noise: float, plan: Plan, seed: int) -> tuple[dict[str, int], dict[str, float]]:
    """Return how many intervals hold the true heading and their median half-width, degrees, by method.

    One interval of each campaign: that of its last heading.
    """
    hits, widths = {}, {}
    for method in METHODS:
        hits[method], widths[method] = 0, []
    for solution, true_deg in campaigns(kind, count, noise, plan, seed):
        for method in METHODS:
            mean = solution.means(method)[-1]
            width_deg = coverage_factor(mean.dof) * mean.std_deg
            widths[method].append(width_deg)
            hits[method] += int(abs(wrapped_deg(mean.azimuth_deg - true_deg[-1])) <= width_deg)
    half = {method: float(np.median(each)) for method, each in widths.items()}
    print(
        f"{kind}, {noise:.3g} V, {count} campaigns: "
        + ", ".join(f"{method} {hits[method]} within {half[method]:.3g} deg" for method in METHODS)
    )
    return hits, half
