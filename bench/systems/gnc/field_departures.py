"""What the readings of turns and attitudes say against their ellipses and their ellipsoid, all in one search.

A reading is its distance from the surface; those of one part of a record that lie in one direction are a row. A turn
beside attitudes is a section of their ellipsoid, whose field may have another size. The field may wander as much in
each octave of time, by an amount that is not known.
Source: docs/method-uncertainty.md (doubt, departures).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy import linalg

from bench.analysis import Departure, Estimates, Floats, Labels, Residuals, Searched, departures_of, search
from bench.maths.arrays import Integers
from bench.maths.verdict import coverage_factor
from bench.systems.gnc.estimators.magnetometer.quadric import Quadric
from bench.systems.gnc.estimators.magnetometer.wander import uncertainty
from bench.systems.gnc.wording import say

_CELL = 0.35  # of the field: 20 degrees, less than a quarter of the fourth harmonic
_PARTS = 8  # of a record
_WANDER = 10.0  # noises of a reading: a field that wanders by more is none to calibrate in
_SHORTEST = 4  # rows over which the field may wander; what is shorter is noise
_FEWEST = 40  # rows that tell their noise


@dataclass(frozen=True)
class Cloud:
    """Readings that a surface was fitted to.

    ``points`` (n, 3): readings of the fit.   ``record`` (n,), ``time_s`` (n,): where each is from.   ``by_surface``
    (k, p): derivatives of the estimates ``stated`` by the parameters of the surface.
    """

    what: str
    quadric: Quadric
    points: Floats
    record: Integers
    time_s: Floats
    by_surface: Floats
    stated: Estimates

    def cells(self, surface: Quadric) -> Cells:
        """Return rows of the readings about a surface of two dimensions or three."""
        size = len(surface.centre)
        distance, _ = surface.seen(self.points[:, :size])
        begin_s, part = np.empty_like(self.time_s), np.empty_like(self.time_s)
        for number in np.unique(self.record):
            inside = self.record == number
            since_s = self.time_s[inside] - self.time_s[inside].min()
            each_s = max(float(since_s.max()), 1e-9) * (1.0 + 1e-9) / _PARTS
            part[inside] = since_s // each_s
            begin_s[inside] = self.time_s[inside].min() + part[inside] * each_s
        kinds = np.column_stack([self.record, part, np.round(self._direction / _CELL)])
        cell, count = np.unique(kinds, axis=0, return_inverse=True, return_counts=True)[1:]
        columns = np.column_stack([
            self.time_s, self.record, begin_s, distance, surface.corrected(self.points[:, :size])
        ])  # fmt: skip
        order = np.argsort(cell.ravel(), kind="stable")
        means = np.add.reduceat(columns[order], np.cumsum(count) - count) / count[:, None]
        means, count = means[at := np.lexsort((means[:, 0], means[:, 1]))], count[at]
        unit = means[:, 4:] / np.linalg.norm(means[:, 4:], axis=1)[:, None]
        record, begins_s, off = means[:, 1:4].T
        return Cells(self, count, record, begins_s, off, unit, surface)

    @property
    def _direction(self) -> Floats:
        """Unit vectors by the cloud's own surface, (n, d): the same cells about any surface."""
        return self.quadric.corrected(self.points[:, : len(self.quadric.centre)])

    def wander(self) -> tuple[float, float]:
        """Return how much more than white noise the readings scatter by blocks, and its degrees of freedom.

        A surface that is no quadric is taken out before: it would look like noise that lasts.
        """
        direction = np.hstack([self._direction, np.zeros((len(self.points), 1))])[:, :3]
        columns = np.column_stack([self.quadric.jacobian, *(wave for _, wave in _harmonics(direction))])
        left = self.quadric.distance - columns @ np.linalg.lstsq(columns, self.quadric.distance)[0]
        found = uncertainty(columns, left, np.flatnonzero(np.diff(self.record, prepend=-1)).tolist())
        if found.chosen is None:
            return 1.0, math.inf
        of_all = float(found.dof(np.eye(columns.shape[1])).sum())
        return found.wander.factor, of_all / 2.0  # what blocks pull at is not all independent

    def operator(self, cells: Cells) -> Floats:
        """Return what each estimate gains per unit of distance of its cells, (k, m)."""
        jacobian = self.quadric.jacobian
        pull = np.linalg.solve(jacobian.T @ jacobian, (cells.count[:, None] * cells.jacobian).T)
        return np.asarray(-self.by_surface @ pull)


@dataclass(frozen=True)
class Cells:
    """Means (m,) of ``count`` readings each: record, begin of its part in s, distance from ``surface`` (positive
    outside); ``direction`` (m, d): where on it, unit vectors as it corrects them.
    """

    cloud: Cloud
    count: Integers
    record: Floats
    begin_s: Floats
    distance: Floats
    direction: Floats
    surface: Quadric

    @cached_property
    def jacobian(self) -> Floats:
        """Derivatives of the distance by the parameters of the surface, (m, p): of its point in that direction."""
        return self.surface.seen(self.surface.centre + self._from_centre)[1]

    @property
    def _from_centre(self) -> Floats:
        return np.asarray(np.linalg.solve(self.surface.shape, self.direction.T).T)

    @property
    def geometry(self) -> Floats:
        """Distance per size of the field, direction (3) and outward normal (3), (m, 7)."""
        normal, nothing = -self.jacobian[:, : self.direction.shape[1]], np.zeros((len(self.count), 3))
        arm = np.einsum("nd,nd->n", normal, self._from_centre)
        return np.column_stack([arm, np.hstack([self.direction, nothing])[:, :3], np.hstack([normal, nothing])[:, :3]])


def searches_of(turns: Sequence[Cloud], sphere: Cloud | None, unit: tuple[float, str]) -> list[Searched]:
    """Return the search of all readings against ellipses and ellipsoid; ``unit``: factor and name as shown."""
    own = [cloud.cells(cloud.quadric) for cloud in [*turns, *([] if sphere is None else [sphere])]]
    seen = own if sphere is None else [*(turn.cells(sphere.quadric) for turn in turns), own[-1]]
    distance = np.concatenate([cells.distance for cells in seen])
    count = np.concatenate([cells.count for cells in seen])
    (noise, dof), wander = _noise(seen), 1.0
    for wanders, few in (cells.cloud.wander() for cells in own):
        wander, dof = max(wander, wanders), min(dof, few)
    noise *= wander
    if len(distance) < _FEWEST or noise == 0.0:
        return []
    if sphere is None:
        design = linalg.block_diag(*(cells.jacobian for cells in own))
    else:
        sizes = linalg.block_diag(*(cells.geometry[:, :1] for cells in seen[:-1]), np.empty((len(own[-1].count), 0)))
        design = np.column_stack([np.concatenate([cells.jacobian for cells in seen]), sizes])
    weight, behind = np.sqrt(count)[:, None] / noise, sum(len(cells.count) for cells in own)
    of_own = linalg.block_diag(*(cells.cloud.operator(cells) for cells in own))
    stated = [entry for cells in own for entry in cells.cloud.stated]
    own_count = np.concatenate([cells.count for cells in own])
    rows = Residuals(
        readings=np.concatenate([distance, np.zeros(behind)]),
        white=weight[:, 0] * distance,
        design=weight * design,
        scatter=weight * _WANDER * noise * _octaves(len(distance)),
        whiten=lambda columns: weight * columns[: len(distance)],
        operator=np.hstack([np.zeros((len(stated), len(distance))), of_own]),
        expanded=np.array([entry.expanded_uncertainty for entry in stated], float),
        noise=coverage_factor() * noise * np.sqrt(of_own**2 @ (1.0 / own_count)),
        noise_dof=dof,
        stated=stated,
    )
    searched = search(rows, _departures([*seen, *own], unit))
    of_noise = float(np.max(rows.noise / rows.expanded))
    findings = []
    for one in searched.findings:
        least = max(float(one.moves.max()), math.sqrt(one.gain) * of_noise / coverage_factor())
        findings.append(replace(one, moves=np.full_like(one.moves, least)) if _is_bend(one.departure) else one)
    return [Searched(replace(searched, findings=findings), _words([*turns, sphere]))]


def _is_bend(one: Departure) -> bool:
    """Whether the surface has another shape: what makes that may make another ellipsoid, too, of at least that size."""
    return one.shape == "harmonic" or "along" in one.of


def _noise(seen: Sequence[Cells]) -> tuple[float, float]:
    """Return the noise of one reading by each row and its two neighbours in time, and its degrees of freedom."""
    scores = [np.empty(0)]
    for cells in seen:
        record, distance, variance = cells.record, cells.distance, 1.0 / cells.count
        bend = distance[1:-1] - (distance[:-2] + distance[2:]) / 2.0
        of_bend = variance[1:-1] + (variance[:-2] + variance[2:]) / 4.0
        scores.append((bend**2 / of_bend)[record[:-2] == record[2:]])
    score = np.concatenate(scores)
    return (float(np.sqrt(score.mean())), score.size / 2.0) if score.size else (0.0, 0.0)


def _octaves(count: int) -> Floats:
    """Return a column for each stretch of rows, (count, s), of lengths that double."""
    number = np.arange(count)
    lengths = [_SHORTEST << power for power in range(count.bit_length()) if _SHORTEST << power < count]
    return np.column_stack([1.0 * (number[:, None] // each == np.arange(-(-count // each))) for each in lengths])


def _departures(cells: Sequence[Cells], unit: tuple[float, str]) -> list[Departure]:
    """Return what could be true instead: what labels make, and surfaces of third and fourth order."""
    geometry = np.concatenate([each.geometry for each in cells])
    arm, direction = geometry[:, 0], geometry[:, 1:4]
    along = dict(zip("xyz", direction.T, strict=True))
    main = np.argmax(np.abs(direction), axis=1)
    side = [f"{'+' if one[axis] > 0.0 else '-'}{'xyz'[axis]}" for one, axis in zip(direction, main, strict=True)]
    zeros = {f"zero {axis}": (unit[1], normal / unit[0]) for axis, normal in zip("xyz", geometry[:, 4:].T, strict=True)}
    labels = Labels(
        kinds={
            "pose": np.concatenate([[each.cloud.what] * len(each.count) for each in cells]),
            "axis": np.array(side),
        },
        hours=np.concatenate([each.begin_s for each in cells]) / 3600.0,
        visit=np.concatenate([each.record for each in cells]).astype(int),
        carriers={"field": ("%", 0.01 * arm), **{name: one for name, one in zeros.items() if one[1].any()}},
        scales={f"along {axis}": (scale, (2, 3)) for axis, scale in along.items() if scale.any()},
    )
    found = departures_of(labels)
    for order, wave in _harmonics(direction):
        found.append(Departure("", "harmonic", "%", 0.01 * arm[:, None] * wave, {"order": order}))
    return found


def _harmonics(direction: Floats) -> Iterator[tuple[int, Floats]]:
    """Yield third and fourth order of directions, (n, 3), and their columns of which only a phase is unknown."""
    x, y, z = direction.T
    for order in (3, 4):
        for turn in range(order + 1):
            wave = z ** (order - turn) * (x + 1j * y) ** turn
            if wave.any():
                yield order, np.column_stack([wave.real, wave.imag][: 1 + (turn > 0)])


def _words(clouds: Sequence[Cloud | None]) -> Any:
    """Return how a person names the labels of turns and attitudes."""
    poses = {number: cloud.what for cloud in clouds if cloud for number in np.unique(cloud.record).tolist()}
    return lambda label, value: say(
        f"departs.of.{label}" if value is None else f"departs.{label}", value=value, pose=poses.get(value)
    )
