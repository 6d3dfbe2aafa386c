"""A dithered ring laser of its own: the crossings themselves, by Fresnel integrals from a table, half cycles at once.

Behind the turnaround at phase psi0 the phase is psi0 - s v^2 + external + X(v) with v = (2 R)^0.5 sin(w t / 2), swing R
and s = 1 at a maximum; lock-in adds X = -kappa int sin(psi + beta) dt = -g [sin(psi0 + beta) C(v) - s cos(psi0 + beta)
S(v)], C and S the integrals of cos and sin of v^2. First order in the jump. It shares no line with the simulators.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Int64 = NDArray[np.int64]

WAVELENGTH_m = 632.8e-9
KNOTS = 8  # of the external phase in a half cycle
_STEP, _FAR, _FINE = 1e-3, 40.0, 20  # of the table in v; the integrals are taken in twentieths of a step


def _table() -> tuple[Array, Array]:
    """Values (4, n) and slopes of C, S and the same with v^2 in front, odd in v, by the midpoint rule."""
    v = (np.arange(round(_FAR / _STEP) * _FINE) + 0.5) * _STEP / _FINE
    parts = np.stack((np.cos(v * v), np.sin(v * v), v * v * np.cos(v * v), v * v * np.sin(v * v)))
    steps = parts.reshape(4, -1, _FINE).sum(axis=2) * _STEP / _FINE
    values = np.concatenate((np.zeros((4, 1)), np.cumsum(steps, axis=1)), axis=1)
    return values, np.diff(values, axis=1)


_VALUES, _SLOPES = _table()


def integrals(v: Array, swing_rad: Array, order: int = 1) -> tuple[Array, Array]:
    """C(v) and S(v) of ``order`` times the phase, with the first term of 1 / swing."""
    root = math.sqrt(order)
    at = np.minimum(np.abs(v) * root / _STEP, _VALUES.shape[1] - 2.0)
    cell = at.astype(np.int64)
    part = at - cell
    found = [values[cell] + part * slopes[cell] for values, slopes in zip(_VALUES, _SLOPES, strict=True)]
    more = 1.0 / (4.0 * order * swing_rad)
    sign = np.sign(v) / root
    return sign * (found[0] + more * found[2]), sign * (found[1] + more * found[3])


@dataclass(frozen=True)
class World:
    """A right ring laser; a wrong one overrides what is not so.

    ``path_m`` and clock as stated; 400.13 Hz of dither, 100 deg/s, 5 % of scatter; ``quantum_deg_rth`` at 28 cm.
    """

    size: float = 0.0
    path_m: float = 0.15
    clock_Hz: int = 20_000_000
    seconds: float = 2.0
    lock_in_deg_s: float = 0.05 * (0.28 / 0.15) ** 2
    beta_deg: float = 65.0
    dither_Hz: float = 400.13
    quantum_deg_rth: float = 1.15e-4 * (0.28 / 0.15) ** 2

    @property
    def gain(self) -> float:
        """Rad of phase per rad."""
        return math.pi * self.path_m / (2.0 * WAVELENGTH_m)

    @property
    def omega(self) -> float:
        """Of the dither, rad/s."""
        return 2.0 * math.pi * self.dither_Hz

    @property
    def half_s(self) -> float:
        """Half a period of the dither."""
        return 0.5 / self.dither_Hz

    def scatter(self, rng: np.random.Generator, count: int) -> Array:
        """Relative scatter of the dither's amplitude, (n,)."""
        return 0.05 * rng.standard_normal(count)

    def kappa_share(self, share: Array) -> Array:
        """Lock-in rate over its nominal value; ``share`` of the record that is over."""
        return np.ones_like(share)

    def beta_rad(self, share: Array, sense: Array) -> Array:
        """Backscatter phase at each turnaround."""
        return np.full_like(share, math.radians(self.beta_deg))

    @property
    def second_harmonic(self) -> float:
        """Of the backscatter, relative."""
        return 0.0

    def turned_rad(self, time_s: Array) -> Array:
        """Rotation of the base beside the earth's, rad."""
        return np.zeros_like(time_s)

    def level_off_rad(self, level: Int64) -> Array | float:
        """Phase by which a comparator switches beside its level."""
        return 0.0

    def bent(self, time_s: Array) -> Array:
        """Dither beside its sine, in parts of the swing; ``time_s`` from the turnaround."""
        return np.zeros_like(time_s)

    def jitter_s(self, rng: np.random.Generator, rate_rad_s: Array) -> Array | float:
        """Error of each time stamp."""
        return 0.0

    def told(self, words: list[Array], rng: np.random.Generator) -> list[Array]:
        """Blocks of events as they are sent: (tick in the block, channel, level, cosine), (4, n) each."""
        return words

    @property
    def spoils(self) -> bool:
        """Return whether the crossings are not where the phase is: a compensator then adds errors of its own."""
        return False

    @property
    def rounds(self) -> tuple[float, ...]:
        """Largest v of the crossings that each round of the iteration moves."""
        return math.inf, 3.0, 3.0, 3.0

    @property
    def curved(self) -> float:
        """Curvature of the dither at a turnaround over that of its sine."""
        return 1.0

    @property
    def stated_path_m(self) -> float:
        """What the record says of the path."""
        return self.path_m

    @property
    def clock_share(self) -> float:
        """Ticks that there are over those that are stated."""
        return 1.0


@dataclass(frozen=True)
class Cycles:
    """Half cycles of a world, (n,) each: phase at the pick-off and at the turnaround, swing, sense, constants.

    ``outside_rad``: external phase at the knots, (KNOTS n + 1,).
    """

    start_rad: Array
    turn_rad: Array
    swing_rad: Array
    sense: Array
    kappa: Array
    beta_rad: Array
    outside_rad: Array


def half_cycles(world: World, rng: np.random.Generator, *, quiet: bool = False) -> Cycles:
    """Follow the phase from pick-off to pick-off."""
    count = round(world.seconds / world.half_s)
    share, sense = (np.arange(count) + 0.5) / count, 1.0 - 2.0 * (np.arange(count) % 2)
    swing = world.gain * math.radians(100.0) / world.omega * (1.0 + world.scatter(rng, count))
    kappa = world.gain * math.radians(world.lock_in_deg_s) * world.kappa_share(share)
    knots = np.arange(KNOTS * count + 1) * world.half_s / KNOTS
    earth = math.radians(9.052 / 3600.0)
    outside = world.gain * (earth * knots + world.turned_rad(knots))
    quantum = world.gain * math.radians(world.quantum_deg_rth / 60.0) * math.sqrt(world.half_s / KNOTS)
    noise = quantum * rng.standard_normal(KNOTS * count)
    outside[1:] += 0.0 if quiet else np.cumsum(noise)
    beta = world.beta_rad(share, sense)
    turn, start = _followed(world, Cycles(swing, swing, swing, sense, kappa, beta, outside), rng.uniform(0.0, 100.0))
    return Cycles(start, turn, swing, sense, kappa, beta, outside)


def _followed(world: World, cycles: Cycles, start_rad: float) -> tuple[Array, Array]:
    """Phase at the turnarounds, (n,), and at the pick-offs, (n + 1,): each depends on the one before."""
    swing, sense = cycles.swing_rad, cycles.sense
    ends = [np.stack(integrals(np.sqrt(swing), swing, order)) for order in (1, 2)]
    g = cycles.kappa / world.omega * np.sqrt(2.0 / swing)
    outside, e2 = cycles.outside_rad, world.second_harmonic
    to = np.diff(outside[:: KNOTS // 2])
    straight = 1.0 - float(world.bent(np.array([world.half_s / 2.0]))[0])
    turn, start, at = np.empty(swing.size), np.empty(swing.size + 1), start_rad
    columns = (swing, sense, g, cycles.beta_rad, *ends[0], *ends[1], to[::2], to[1::2])
    for j, (r, s, gain, beta, c, d, c2, d2, before, behind) in enumerate(
        zip(*(np.asarray(one).tolist() for one in columns), strict=True)
    ):
        start[j] = psi0 = at
        half = 0.0
        for _ in range(4):
            psi0 = at + half + s * r * straight + before
            half = -gain * (math.sin(psi0 + beta) * c - s * math.cos(psi0 + beta) * d)
            half -= gain * e2 * (math.sin(2.0 * psi0 + 0.4) * c2 - s * math.cos(2.0 * psi0 + 0.4) * d2) if e2 else 0.0
        turn[j] = psi0
        at = psi0 - s * r * straight + behind + half
    start[-1] = at
    return turn, start


@dataclass(frozen=True)
class Crossings:
    """Edges of the beat in order of time: ``time_s``, ``level`` n of n pi, ``upward``, ``rate_rad_s``; (m,) each."""

    time_s: Array
    level: Int64
    upward: NDArray[np.bool_]
    rate_rad_s: Array


def crossings(world: World, cycles: Cycles) -> Crossings:
    """Where the phase passes its levels, from the turnaround to both sides."""
    half, side, level = _levels(cycles)
    swing, sense = cycles.swing_rad[half], cycles.sense[half]
    target = sense * (cycles.turn_rad[half] - np.pi * level - world.level_off_rad(level))
    v = side * np.sqrt(np.maximum(target, 1e-9))
    g = (cycles.kappa / world.omega * np.sqrt(2.0 / cycles.swing_rad))[half]
    phase = (cycles.turn_rad + cycles.beta_rad)[half]
    sine, cosine = g * np.sin(phase), g * np.cos(phase) * sense
    twice = 2.0 * cycles.turn_rad[half] + 0.4
    middle = np.asarray(cycles.outside_rad[KNOTS // 2 :: KNOTS])[half]
    for last in world.rounds:  # far from the turnaround a small phase hardly moves a crossing
        near = np.abs(v) < last if math.isfinite(last) else slice(None)
        w, r, s = v[near], swing[near], sense[near]
        since = 2.0 / world.omega * np.arcsin(np.clip(w / np.sqrt(2.0 * r), -1.0, 1.0))
        c, d = integrals(w, r)
        added = cosine[near] * d - sine[near] * c
        if world.second_harmonic:
            c, d = integrals(w, r, 2)
            e2 = world.second_harmonic * g[near]
            added += e2 * (s * np.cos(twice[near]) * d - np.sin(twice[near]) * c)
        added += _outside(world, cycles, half[near], since) - middle[near] + s * r * world.bent(since)
        v[near] = side[near] * np.sqrt(np.maximum(target[near] + s * added, 1e-9))
    since = 2.0 / world.omega * np.arcsin(np.clip(v / np.sqrt(2.0 * swing), -1.0, 1.0))
    rate = swing * world.omega * np.sin(world.omega * np.abs(since))
    return Crossings((half + 0.5) * world.half_s + since, level, (sense * side) < 0, rate)


def _outside(world: World, cycles: Cycles, half: Int64, since_s: Array) -> Array:
    at = np.clip((half + 0.5 + since_s / world.half_s) * KNOTS, 0.0, cycles.outside_rad.size - 1.001)
    cell = at.astype(np.int64)
    return cycles.outside_rad[cell] + (at - cell) * np.diff(cycles.outside_rad)[cell]


def _levels(cycles: Cycles) -> tuple[Int64, Array, Int64]:
    """Half cycle, side (-1 before the turnaround) and level of each crossing, in order of time."""
    up = cycles.sense > 0
    low, high = np.floor(cycles.start_rad / np.pi).astype(np.int64), np.floor(cycles.turn_rad / np.pi).astype(np.int64)
    first = np.where(up, low[:-1] + 1, low[:-1])
    inner = np.where(up, high, high + 1)
    final = np.where(up, low[1:] + 1, low[1:])
    counts = np.column_stack((np.abs(inner - first) + 1, np.abs(final - inner) + 1)).ravel()
    part = np.repeat(np.arange(counts.size), counts)
    within = np.arange(part.size) - np.repeat(np.cumsum(counts) - counts, counts)
    half, behind = part // 2, part % 2 == 1
    toward = np.where(up, 1, -1)[half]
    level = np.where(behind, inner[half] - toward * within, first[half] + toward * within)
    return half, np.where(behind, 1.0, -1.0), level


def blocks(
    world: World, found: Crossings, halves: int, rng: np.random.Generator, clock_Hz: int, *, quiet: bool = False
) -> list[Array]:
    """Events of each 10 ms: (tick in the block, channel, level, cosine), (4, n); the pick-off is 60 ns late."""
    time_s = found.time_s + world.jitter_s(rng, found.rate_rad_s)
    late = 60e-9 + (0.0 if quiet else 15e-9 * rng.standard_normal(halves + 1))
    zero_s = world.half_s * np.arange(halves + 1) + late
    even = found.level % 2 == 0
    kept = np.argsort(time_s, kind="stable")
    at = np.searchsorted(time_s[kept], zero_s)
    tick = np.insert(time_s[kept], at, zero_s)
    tick = np.floor(np.maximum(tick, 0.0) * (clock_Hz * world.clock_share)).astype(np.int64)
    columns = [
        np.insert(np.zeros(even.size, np.int64), at, 1),
        np.insert((found.upward == even)[kept].astype(np.int64), at, 1 - np.arange(halves + 1) % 2),
        np.insert(even[kept].astype(np.int64), at, 0),
    ]
    long = clock_Hz // 100
    cuts = np.searchsorted(tick, np.arange(1, int(tick[-1]) // long + 1) * long)
    events = np.stack((tick % long, *columns))
    return world.told(np.split(events, cuts, axis=1), rng)
