"""The compensators one after the other on the edges of a simulation, as an analysis runs them on a record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from laser_edges import simulated_edges
from numpy.typing import NDArray

from bench.systems.lock_in.estimators.edges import EdgeLevels, edge_levels
from bench.systems.lock_in.estimators.global_constants import GlobalConstants, global_constants
from bench.systems.lock_in.estimators.random_walk import RandomWalk, cycle_increments, net_angle, random_walk
from bench.systems.lock_in.estimators.single_turnarounds import dither_shape, fresnel, parabolas
from bench.systems.lock_in.estimators.turnarounds import Jumps, Turnarounds, turnarounds
from sim_instruments.worlds.lock_in.core import BEAT, RingLaser

METHODS: dict[str, Callable[[Turnarounds], Jumps]] = {
    "P3": lambda turns: parabolas(turns, 3),
    "P4": parabolas,
    "J4": dither_shape,
    "J16": lambda turns: dither_shape(turns, 16),
    "S16": fresnel,
    "G": lambda turns: global_constants(turns).jumps,
}
DEFAULT = "G"
START_s = 3e-9  # of the stretch on the tagger's clock, so that a pick-off edge does not fall on a tick


@dataclass(frozen=True)
class Chain:
    """What a record of one laser gives: edges, turnarounds, phase at the pick-off's edges."""

    path_m: float
    edges: EdgeLevels
    pickoff: NDArray[np.int64]
    rising: NDArray[np.bool_]
    turns: Turnarounds
    psi_rad: NDArray[np.float64]

    def walk(self, jumps: Jumps | None = None) -> RandomWalk:
        """Angle random walk, compensated or not."""
        found = cycle_increments(self.psi_rad, self.rising, self.turns, jumps)
        return random_walk(found.increment_rad, found.interval_s, self.path_m)

    def ratios(self, *names: str) -> dict[str, float]:
        """Random walk with each method over the one without."""
        raw = self.walk().n_deg_rth
        return {name: self.walk(self.jumps(name)).n_deg_rth / raw for name in names or METHODS}

    def jumps(self, name: str) -> Jumps:
        """What a method says of the turnarounds."""
        return self.constants.jumps if name == DEFAULT else METHODS[name](self.turns)

    @cached_property
    def constants(self) -> GlobalConstants:
        """Of the default method."""
        return global_constants(self.turns)


def chain(
    path_m: float,
    clock_Hz: float,
    beat: tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]],
    pickoff: tuple[NDArray[np.float64], NDArray[np.bool_]],
) -> Chain:
    """From times (s) and levels of the beat's edges and of the pick-off's."""
    tick, zero = (np.floor((times + START_s) * clock_Hz).astype(np.int64) for times in (beat[0], pickoff[0]))
    edges = edge_levels(tick, beat[1], beat[2])
    turns = turnarounds(edges, zero, pickoff[1], clock_Hz)
    return Chain(path_m, edges, zero, pickoff[1], turns, net_angle(edges, zero))


def simulated(laser: RingLaser, seconds: float, seed: int, *clocks_Hz: float) -> list[Chain]:
    """The bench's simulated laser, seen by taggers of several clocks."""
    found = simulated_edges(laser, seconds, np.random.default_rng(seed))
    beat, rises = found.channel == BEAT, found.level.astype(bool)
    of_beat = found.t_s[beat], rises[beat], found.cosine[beat].astype(bool)
    return [chain(laser.path_m, clock, of_beat, (found.t_s[~beat], rises[~beat])) for clock in clocks_Hz]
