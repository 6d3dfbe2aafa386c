"""Crossings of multiples of pi by the phase of a ring laser, between the points of its grid.

Between two points the phase is the cubic through both with both slopes; at 1 us its error is below 5e-6 rad where the
beat is fastest and the time of a crossing is good to some 1e-12 s. Near a turnaround the phase may cross a level and
come back within one step: the turning point itself is looked at too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from bench.model.arrays import Array, Flags, Floats, Integers
from sim_instruments.worlds.lock_in.half_cycles import Drive, Motion, circle

_NEWTON, _BISECTIONS = 4, 54
_PICOSECOND = 1e-12
_EVEN_SLOPES = 0.5  # below this ratio of the slopes of a step the crossing is bracketed


@dataclass(frozen=True)
class Crossings:
    """Crossings in order of time, (m,): half cycle, seconds since its beginning, +1 or -1, floor(psi / pi) behind."""

    half: Integers
    since_s: Floats
    sense: Integers
    count: Integers


class _Cubics(NamedTuple):
    """psi = a + b x + c x2 + d x3 in steps of the grid, x from 0 to 1."""

    a: Floats
    b: Floats
    c: Floats
    d: Floats

    def at(self, x: Floats) -> Floats:
        return self.a + x * (self.b + x * (self.c + x * self.d))

    def slope(self, x: Floats) -> Floats:
        return self.b + x * (2.0 * self.c + x * 3.0 * self.d)

    def bend(self, x: Floats) -> Floats:
        return 2.0 * self.c + 6.0 * x * self.d

    def take(self, which: Flags | Integers) -> _Cubics:
        return _Cubics(*(part[which] for part in self))


def crossings(drive: Drive, motion: Motion, noise_rad: Floats | None) -> Crossings:
    """Return all crossings of multiples of pi.

    Args: noise_rad: of the comparator in each step, (n, steps), in parts of the beat's amplitude, or None: an edge
        comes where psi is that much off its level. A pair of edges about a turnaround that so never reaches its level
        is gone; noise makes no edges of its own, as with a comparator that has hysteresis.
    """
    psi = motion.psi_rad
    level = np.floor(psi * (1.0 / np.pi))
    change = np.diff(level, axis=1)
    flat = np.flatnonzero(change)
    half, step = np.divmod(flat, drive.steps)
    sense = change.ravel()[flat]
    target = np.maximum(level[half, step], level[half, step + 1])
    curve = _cubics(drive, psi, half, step)
    x = _solve(curve, target * np.pi)
    columns: list[Any] = [half, step, x, sense, target]
    if (pairs := _at_turning_points(drive, psi, level)) is not None:
        joined = [np.concatenate(parts) for parts in zip(columns, pairs, strict=True)]
        order = np.lexsort((joined[2], joined[1], joined[0]))
        columns = [part[order] for part in joined]
        curve = _cubics(drive, psi, columns[0], columns[1])
    half, step, x, sense, target = columns
    if noise_rad is not None:
        keep, x = _disturbed(curve, half, x, sense, target, noise_rad[half, step])
        half, step, x, sense, target = (part[keep] for part in (half, step, x, sense, target))
    signs = sense.astype(np.int64)
    count = target.astype(np.int64) - (signs < 0) + 2 * motion.turns[half]
    since_s = np.clip((step + x) * drive.step_s, 0.0, drive.half_s - _PICOSECOND)  # noise leaves it in its half cycle
    return Crossings(np.asarray(half, np.int64), since_s, signs, count)


def _cubics(drive: Drive, psi: Floats, half: Integers, step: Integers) -> _Cubics:
    _, __, cosine = drive.shape()
    h, n = drive.step_s, drive.steps
    amplitude, beta = drive.amplitude_rad_s[half], drive.beta_rad[half]
    walk = drive.walk_rad[half, step] if drive.walk_rad is not None else 0.0
    flat = half * (n + 1) + step
    start, end = psi.ravel()[flat], psi.ravel()[flat + 1]

    def slope(at: Floats, where: Integers) -> Floats:
        back = circle(at + beta)[1]
        if drive.second:
            back += drive.second * circle(2.0 * at + drive.second_phase_rad)[1]
        return np.asarray(h * (amplitude * cosine[where] + drive.rate_rad_s - drive.kappa_rad_s * back) + walk)

    first, last = slope(start, step), slope(end, step + 1)
    rise = end - start
    return _Cubics(start, first, 3.0 * rise - 2.0 * first - last, first + last - 2.0 * rise)


def _solve(curve: _Cubics, target: Floats) -> Floats:
    """Return where each cubic passes its target, once in its step."""
    rise = curve.b + curve.c + curve.d
    x = (target - curve.a) / rise
    for _ in range(_NEWTON):
        x -= (curve.at(x) - target) / curve.slope(x)
    last = curve.slope(np.ones_like(x))
    low, high = np.minimum(np.abs(curve.b), np.abs(last)), np.maximum(np.abs(curve.b), np.abs(last))
    uneven = np.flatnonzero((low < _EVEN_SLOPES * high) | (curve.b * last <= 0.0))
    if len(uneven):
        own = curve.take(uneven)
        x[uneven] = _bisected(own, target[uneven], np.zeros(len(uneven)), np.ones(len(uneven)))
    return np.clip(x, 0.0, 1.0)


def _bisected(curve: _Cubics, target: Floats, low: Floats, high: Floats) -> Floats:
    below = curve.at(low) < target
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        before = (curve.at(middle) < target) == below
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    return np.asarray(0.5 * (low + high))


def _at_turning_points(drive: Drive, psi: Floats, level: Floats) -> list[Array] | None:
    """Return pairs of crossings inside one step: half, step, x, sense and level of each crossing; else None."""
    rises = np.diff(psi, axis=1) > 0.0
    half, before = np.nonzero(rises[:, 1:] != rises[:, :-1])
    half, step = np.repeat(half, 2), np.stack([before, before + 1], axis=1).ravel()  # it turns in one of the two
    curve = _cubics(drive, psi, half, step)
    turning = curve.b * curve.slope(np.ones(len(step))) < 0.0
    half, step, curve = half[turning], step[turning], curve.take(turning)
    x = _bisected(_Cubics(curve.b, 2.0 * curve.c, 3.0 * curve.d, 0.0 * curve.d), np.zeros(len(step)),
                  np.zeros(len(step)), np.ones(len(step)))  # fmt: skip
    reached = np.floor(curve.at(x) / np.pi)
    ends = level[half, step], level[half, step + 1]
    top = reached > np.maximum(*ends)
    hit = top | (reached < np.minimum(*ends))
    if not hit.any():
        return None
    half, step, curve, x, top = half[hit], step[hit], curve.take(hit), x[hit], top[hit]
    target = np.where(top, reached[hit], reached[hit] + 1.0)
    into = _bisected(curve, target * np.pi, np.zeros(len(x)), x)
    back = _bisected(curve, target * np.pi, x, np.ones(len(x)))
    sense = np.where(top, 1.0, -1.0)
    joined = (np.concatenate(pair) for pair in (
        (half, half), (step, step), (into, back), (sense, -sense), (target, target)))  # fmt: skip
    return list(joined)


def _disturbed(
    curve: _Cubics, half: Integers, x: Floats, sense: Floats, target: Floats, noise_rad: Floats
) -> tuple[Flags, Floats]:
    """Return crossings that are left and where they come: on the parabola through the undisturbed crossing."""
    slope, bend = curve.slope(x), curve.bend(x)
    inside = slope * slope + 2.0 * bend * noise_rad
    lost = inside < 0.0
    shift = 2.0 * noise_rad / (slope + sense * np.sqrt(np.maximum(inside, 0.0)))
    pair = np.flatnonzero((target[1:] == target[:-1]) & (sense[1:] != sense[:-1]) & (half[1:] == half[:-1]))
    gone = lost[pair] | lost[pair + 1]
    lost[pair[gone]] = lost[pair[gone] + 1] = True
    return ~lost, x + shift
