"""What the inertial sensors of the simulated module are exposed to, as the mean over each sample's interval."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bench.model.clock import NS
from sim_instruments.worlds.common.attitude import (
    Site,
    Surroundings,
    Tilt,
    angles_deg,
    in_body_axes,
    in_inner_axes,
    lever_force_g,
    rates_in_inner_axes,
    turned_deg,
)

Float = NDArray[np.float64]
Int64 = NDArray[np.int64]

_STEP_NS = 5_000_000  # an interval is split into steps no longer than this
_NODES = (0.5 - 0.5 / np.sqrt(3.0), 0.5 + 0.5 / np.sqrt(3.0))  # Gauss and Legendre: exact to the third power of time


def true_inputs(
    surroundings: Surroundings,
    site: Site,
    tilt: Tilt | None,
    t_ns: Int64,
    interval_ns: int,
    lever_arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> tuple[Float, Float]:
    """Return mean rate (deg/s, against inertial space) and specific force (standard g) in body axes, (n, 3) each.

    The turn of a single axis enters as the exact difference of its angle over the interval. Earth's rate and gravity
    are turned into the body at two nodes of each 5 ms: at 400 deg/s that leaves 3e-10 of them.
    """
    first, last = angles_deg(surroundings.motion, t_ns - interval_ns), angles_deg(surroundings.motion, t_ns)
    if np.array_equal(first, last) and (first == first[:1]).all():
        rate, force = _in_place(surroundings, site, tilt, first[:1])
        return np.repeat(rate, t_ns.size, axis=0), np.repeat(force, t_ns.size, axis=0)
    mounting, interval_s = surroundings.mounting, interval_ns / NS
    steps = max(1, -(-interval_ns // _STEP_NS))
    edges = [t_ns - interval_ns + interval_ns * step // steps for step in range(steps + 1)]
    corners = [first, *(angles_deg(surroundings.motion, edge) for edge in edges[1:-1]), last]
    together = np.count_nonzero((first != last).any(axis=0)) > 1
    turn, rate, force = np.zeros_like(first), np.zeros_like(first), np.zeros_like(first)
    for step in range(steps):
        begin, length = edges[step], edges[step + 1] - edges[step]
        nodes = [begin + np.rint(node * length).astype(np.int64) for node in _NODES]
        between = np.stack([angles_deg(surroundings.motion, node) for node in nodes])
        gain_deg = _gain_deg(surroundings, nodes, length) if together else np.zeros_like(first)
        turn += turned_deg(corners[step], corners[step + 1], between, gain_deg)
        for node_angles in between:
            of_earth, at_rest = _in_place(surroundings, site, tilt, node_angles)
            rate += of_earth / (2 * steps)
            force += at_rest / (2 * steps)
    ends = [tilt.rad(first), tilt.rad(last)] if tilt else [np.zeros(3)] * 2
    tilts = (ends[0] + ends[1]) / 2.0 if tilt else None
    wobble = np.rad2deg(ends[1] - ends[0])
    rate += in_body_axes(turn + wobble, mounting, tilts) / interval_s
    if any(lever_arm_m):
        force += _lever(surroundings, t_ns, interval_ns, np.array(lever_arm_m))
    return rate, force


def _gain_deg(surroundings: Surroundings, nodes: list[Int64], length_ns: Int64) -> Float:
    """Rates at the second node minus those at the first, times the length, (n, 3); only for several moving axes."""
    rates = [np.stack([axis.rate_deg_s(node) for axis in surroundings.motion], axis=1) for node in nodes]
    return np.asarray((rates[1] - rates[0]) * (length_ns / NS)[:, None])


def _in_place(surroundings: Surroundings, site: Site, tilt: Tilt | None, angles: Float) -> tuple[Float, Float]:
    """Earth's rate (deg/s) and the force at rest (g) in body axes at table angles (n, 3)."""
    tilts = None if tilt is None else tilt.rad(angles)
    rate = in_body_axes(in_inner_axes(site.earth_rate_deg_s, angles, site), surroundings.mounting, tilts)
    force = in_body_axes(in_inner_axes(site.rest_force_g, angles, site), surroundings.mounting, tilts)
    return rate, force


def _lever(surroundings: Surroundings, t_ns: Int64, interval_ns: int, lever_arm_m: Float) -> Float:
    """Force of the lever arm from the table's rates at both ends of the interval (tilt and Earth left out)."""
    ends = [
        in_body_axes(rates_in_inner_axes(surroundings.motion, t), surroundings.mounting)
        for t in (t_ns - interval_ns, t_ns)
    ]
    change = (ends[1] - ends[0]) / (interval_ns / NS)
    return (lever_force_g(ends[0], change, lever_arm_m) + lever_force_g(ends[1], change, lever_arm_m)) / 2.0
