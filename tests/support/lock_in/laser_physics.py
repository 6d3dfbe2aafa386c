"""A dithered ring laser of its own: the crossings themselves, by Fresnel integrals from a table, half cycles at once.

Behind the turnaround at phase psi0 the phase is psi0 - s v^2 + external + X(v) with v = (2 R)^0.5 sin(w t / 2), swing R
and s = 1 at a maximum; lock-in adds X with dX / dv = -g sin(psi0 + beta - s v^2 + X), to the third order of g. It
shares no line with the simulators.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Int64 = NDArray[np.int64]

WAVELENGTH_m = 632.8e-9
KNOTS = 64  # of the external phase in a half cycle
_STEP, _FAR, _FINE = 1e-3, 40.0, 20  # of the table in v; the integrals are taken in twentieths of a step


def _table() -> tuple[Array, Array]:
    """Values (9, n) and slopes by the midpoint rule: C and S, the integrals of cos and sin of v^2, odd in v, the same
    with v^2 and with v^4 in front, and what the second and the third order of g need: A, even, and T, odd.
    """
    step = _STEP / _FINE
    v = (np.arange(round(_FAR / _STEP) * _FINE) + 0.5) * step
    turning = np.exp(1j * v * v)
    z = (np.cumsum(turning) - turning / 2.0) * step
    area = (z.conj() * turning).imag
    third = (np.abs(z) ** 2 / 4.0 - 0.5j * (np.cumsum(area) - area / 2.0) * step) * turning.conj()
    plain = [part for power in (0, 2, 4) for part in (v**power * turning.real, v**power * turning.imag)]
    parts = np.stack((*plain, area, third.real, third.imag))
    steps = parts.reshape(len(parts), -1, _FINE).sum(axis=2) * step
    values = np.concatenate((np.zeros((len(parts), 1)), np.cumsum(steps, axis=1)), axis=1)
    return values, np.diff(values, axis=1)


_VALUES, _SLOPES = _table()


def _found(v: Array, rows: slice) -> list[Array]:
    """Values of the table at v >= 0."""
    at = np.minimum(v / _STEP, _VALUES.shape[1] - 2.0)
    cell = at.astype(np.int64)
    part = at - cell
    return [values[cell] + part * slopes[cell] for values, slopes in zip(_VALUES[rows], _SLOPES[rows], strict=True)]


def integrals(v: Array, swing_rad: Array, order: int = 1) -> tuple[Array, Array]:
    """C(v) and S(v) of ``order`` times the phase, with the first two terms of 1 / swing."""
    root = math.sqrt(order)
    found = _found(np.abs(v) * root, slice(0, 6))
    more = 1.0 / (4.0 * order * swing_rad)
    sign = np.sign(v) / root
    c, s = (found[k] + more * (found[k + 2] + 1.5 * more * found[k + 4]) for k in (0, 1))
    return sign * c, sign * s


def higher(v: Array, swing_rad: Array) -> tuple[Array, Array]:
    """A(v), which grows faster as the dither slows down, and T(v), complex."""
    area, real, imaginary = _found(np.abs(v), slice(6, 9))
    return area - np.log1p(-v * v / (2.0 * swing_rad)) / 4.0, np.sign(v) * (real + 1j * imaginary)


def added(g: Array, phase_rad: Array, sense: Array, terms: tuple[Array, Array, Array]) -> Array:
    """Phase X that lock-in adds, to the third order of g.

    With q = exp(i p) (C - i S) and p = psi0 + beta, at a maximum X = -g Im q + g^2 (Im(q^2) / 4 + A / 2)
    + g^3 Im(exp(i p) T - q^3 / 12), from dX / dv = -g sin(p - v^2 + X) order by order; at a minimum the mirror image.

    Args: phase_rad: p.   terms: C + i S, A and T at the crossings.
    """
    z, area, third = terms
    turned = np.exp(1j * sense * phase_rad)
    q = turned * np.conj(z)
    second = (q * q).imag / 4.0 + area / 2.0
    return np.asarray(sense * g * (g * (second + g * (turned * third - q**3 / 12.0).imag) - q.imag))


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
    clock_share = 1.0  # ticks that there are over those that are stated
    curved = 1.0  # curvature of the dither at a turnaround over that of its sine
    rounds = (math.inf, 8.0, 8.0, 3.0, 3.0)  # largest v that each round moves; the fit looks at crossings to 7
    spoils = False  # the crossings are not where the phase is: a compensator then adds errors of its own
    second_harmonic = 0.0  # of the backscatter, relative

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
    def stated_path_m(self) -> float:
        """What the record says of the path."""
        return self.path_m


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
    end = np.sqrt(swing)
    z, z2 = (np.asarray(c + 1j * d) for c, d in (integrals(end, swing, order) for order in (1, 2)))
    area, third = higher(end, swing)
    g = cycles.kappa / world.omega * np.sqrt(2.0 / swing)
    to = np.diff(cycles.outside_rad[:: KNOTS // 2])
    straight = 1.0 - float(world.bent(np.array([world.half_s / 2.0]))[0])
    turn, start, at = np.empty(swing.size), np.empty(swing.size + 1), start_rad
    columns = (swing, sense, g, cycles.beta_rad, z, z2, area, third, to[::2], to[1::2])
    for j, (r, s, gain, beta, zj, z2j, aj, tj, before, behind) in enumerate(zip(*columns, strict=True)):
        start[j] = psi0 = at
        arrived = 0.0
        for _ in range(4):
            psi0 = at - arrived + s * r * straight + before
            arrived = added(gain, psi0 + beta, s, (-zj, aj, -tj)) - world.second_harmonic * _second(gain, psi0, s, z2j)
        turn[j] = psi0
        left = added(gain, psi0 + beta, s, (zj, aj, tj)) + world.second_harmonic * _second(gain, psi0, s, z2j)
        at = psi0 - s * r * straight + behind + left
    start[-1] = at
    return turn, start


def _second(g: Array, turn_rad: Array, sense: Array, z: Array) -> Array:
    """What a second harmonic as large as the first adds; first order of g. ``z``: C + i S of twice the phase."""
    twice = 2.0 * turn_rad + 0.4
    return g * (sense * np.cos(twice) * z.imag - np.sin(twice) * z.real)


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
    turn, phase = cycles.turn_rad[half], (cycles.turn_rad + cycles.beta_rad)[half]
    middle = np.asarray(cycles.outside_rad[KNOTS // 2 :: KNOTS])[half]
    for last in world.rounds:  # far from the turnaround a small phase hardly moves a crossing
        near = np.abs(v) < last if math.isfinite(last) else slice(None)
        w, r, s = v[near], swing[near], sense[near]
        since = 2.0 / world.omega * np.arcsin(np.clip(w / np.sqrt(2.0 * r), -1.0, 1.0))
        c, d = integrals(w, r)
        more = added(g[near], phase[near], s, (c + 1j * d, *higher(w, r)))
        if world.second_harmonic:
            c, d = integrals(w, r, 2)
            more += world.second_harmonic * _second(g[near], turn[near], s, c + 1j * d)
        more += _outside(world, cycles, half[near], since) - middle[near] + s * r * world.bent(since)
        v[near] = side[near] * np.sqrt(np.maximum(target[near] + s * more, 1e-9))
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
