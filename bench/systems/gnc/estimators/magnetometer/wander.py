"""Uncertainty of a fit whose noise may be the same from reading to reading, over lengths that nobody declared.

To first order each reading pulls the parameters by its residual; the pulls of a block of readings add up. Noise that
is independent from reading to reading makes the blocks' pulls as large as their number of readings says; noise that
wanders makes long blocks pull more. So the blocks are doubled until they pull independently of their neighbours, and
their scatter is the uncertainty, with the few degrees of freedom that they leave. Where white noise explains every
length of block, its narrower and better known uncertainty holds.

Source: Bell and McCaffrey, Survey Methodology 28 (2002) 169 (scatter of blocks corrected for what the fit took of it,
CR2, and its degrees of freedom); Flyvbjerg and Petersen, J. Chem. Phys. 91 (1989) 461 (blocks doubled until their
variance stops rising).

Bad readings, found before any fit: those that no quadric through most of the others explains.

Free quadrics (centre, shape and size open, closed or not) go through a few readings drawn at random; the one with the
smallest median distance of all readings has most likely met none that is bad. Readings that lie further off than any
noise are odd, as long as they are very few: many are no outliers but another surface.

Source: Rousseeuw, J. Am. Stat. Assoc. 79 (1984) 871 (least median of squares by random subsets); Taubin, IEEE Trans.
Pattern Anal. 13 (1991) 1115 (distance of a point from an algebraic surface to first order).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bench.maths.arrays import Flags, Floats
from bench.maths.samples import few, scatter
from bench.maths.tests import chi2_tail, of_many

FEWEST_BLOCKS = 7
_LEVELS = 5  # lengths of block, each twice the one before
_SHORTEST = 8  # readings of a block
_SUSPICION = 0.05  # probability of a scatter in white noise below which the blocks are asked
_ALONE = 1.0  # standard deviations by which neighbours may pull together
_ENDLESS = 3.5  # noise over 1/40, 1/10, 3/8 of 4,000 readings: 0.5, 2.8, 4.8 on average
_LOOSE = 1e-15  # of the largest information: what has less is open, and its uncertainty beyond any limit
_CARRIED = 1e-3  # a block that leaves less than this part of a direction to the others carries it alone
_SUBSETS, _TIMES = 20, 3  # subsets, and readings of each per coefficient
_SEED = 1984  # the same readings give the same answer
_FAR = 10.0  # standard deviations of normal noise
_ROUNDING = 1e-9  # of the size of the cloud


@dataclass(frozen=True)
class _Blocks:
    """Blocks of one length: ``pull`` (g, p) on parameters of unit variance, ``share`` (g, p, p) of the information."""

    pull: Floats
    share: Floats

    def doubled(self) -> _Blocks:
        count, size = len(self.pull) // 2, self.pull.shape[1]
        return _Blocks(
            self.pull.reshape(count, 2, size).sum(axis=1), self.share.reshape(count, 2, size, size).sum(axis=1)
        )

    @cached_property
    def root(self) -> Floats:
        """(g, p, p): makes the pull of a block as large as it is without the fit, for white noise."""
        left, vectors = np.linalg.eigh(np.eye(self.pull.shape[1]) - self.share)
        scaled = vectors / np.sqrt(np.maximum(left, _CARRIED))[:, None, :]
        return np.asarray(scaled @ np.swapaxes(vectors, 1, 2))

    @cached_property
    def covariance(self) -> Floats:
        """(p, p) by the scatter of the blocks."""
        pull = np.einsum("gij,gj->gi", self.root, self.pull)
        return np.asarray(pull.T @ pull)

    def dof(self, contrasts: Floats) -> Floats:
        """Return degrees of freedom of the variance of each contrast, (c,) from (c, p)."""
        found = []
        for contrast in contrasts:
            seen = self.root @ contrast
            weighed = np.einsum("gi,gij->gj", seen, self.share)
            together = np.diag(np.sum(weighed * seen, axis=1)) - weighed @ weighed.T
            found.append(float(np.trace(together)) ** 2 / max(float(np.sum(together**2)), 1e-300))
        return np.array(found)

    @cached_property
    def expected(self) -> float:
        """Sum of squared pulls that white noise of unit variance makes on average."""
        return float(self.pull.shape[1] - np.einsum("gij,gij->", self.share, self.share))

    @property
    def scatter(self) -> float:
        """Sum of squared pulls in what white noise of unit variance makes on average."""
        return float(np.sum(self.pull**2)) / self.expected

    def improbable(self) -> float:
        """Return probability that white noise of unit variance pulls as much or more.

        Source: Satterthwaite's chi-square of the sum over all parameters; union bound over single parameters.
        """
        squares = self.share @ self.share
        total = squares.sum(axis=0)
        cubes = float(np.einsum("gij,gji->", squares, self.share))
        variance = 2.0 * (float(np.trace(total)) - 2.0 * cubes + float(np.sum(total**2)))
        of_all = chi2_tail(self.scatter * 2.0 * self.expected**2 / variance, 2.0 * self.expected**2 / variance)
        dof = self.dof(np.eye(self.pull.shape[1]))
        of_one = of_many(float(chi2_tail(np.diag(self.covariance) * dof, dof).min()), dof.size)
        return of_many(min(of_all, of_one), 2)

    def together(self) -> float:
        """Return by how many standard deviations neighbours pull together."""
        products = np.sum(self.pull[1:] * self.pull[:-1], axis=1)
        products += np.einsum("gij,gij->g", self.share[1:], self.share[:-1]) * self.scatter  # what the fit makes
        size = float(np.linalg.norm(products))
        return float(products.sum()) / size if size > 0.0 else 0.0


@dataclass(frozen=True)
class Wander:
    """How the noise of a fit wanders.

    Attributes:
        blocks: whose scatter gives the uncertainty, 0 for white noise.   factor: standard deviation by them over that
            of white noise, over all parameters.   probability: that white noise scatters as blocks of any length do.
        together: by how many standard deviations neighbours still pull together, added over the two longest blocks.
    """

    blocks: int = 0
    factor: float = 1.0
    probability: float = 1.0
    together: float = 0.0

    @property
    def is_endless(self) -> bool:
        """The noise lasts longer than the longest blocks: their scatter is not what the whole record has."""
        return self.together > _ENDLESS


@dataclass(frozen=True)
class Uncertainty:
    """Of the parameters of a fit.   ``covariance`` (p, p).   ``noise``: standard deviation of a residual.
    ``root`` (p, p): parameters of unit variance to those of the fit.   ``chosen``: blocks, None for white noise.
    """

    covariance: Floats
    noise: float
    wander: Wander
    white_dof: float
    root: Floats
    chosen: _Blocks | None

    def dof(self, slope: Floats) -> Floats:
        """Return degrees of freedom behind functions of the parameters, (f,), by their derivatives (f, p)."""
        if self.chosen is None:
            return np.full(len(slope), self.white_dof)
        return self.chosen.dof(slope @ self.root)


def uncertainty(
    jacobian: Floats, residual: Floats, begins: Sequence[int] = (), declared: float | None = None
) -> Uncertainty:
    """Return what the residuals of a least-squares fit say of its parameters, whatever the length of their noise.

    Args:    jacobian: (n, p).   residual: (n,), in order of time.   begins: first reading of each record.
             declared: standard deviation of white noise, of residuals that hold none.
    Returns: Uncertainty.
    Source:  see the head of this file.
    """
    count, size = jacobian.shape
    noise = float(np.sqrt(residual @ residual / (count - size))) if declared is None else declared
    scale = np.linalg.norm(jacobian, axis=0)
    unit = jacobian / np.where(scale > 0.0, scale, 1.0)
    information, vectors = np.linalg.eigh(unit.T @ unit)
    root = vectors / np.sqrt(np.maximum(information, _LOOSE * information[-1]))
    left, root = unit @ root, root / np.where(scale > 0.0, scale, 1.0)[:, None]
    white = Uncertainty(noise**2 * root @ root.T, noise, Wander(), float(count - size), root, None)
    edges = _edges(count, begins)
    if declared is not None or noise == 0.0 or not edges.size:
        return white
    pull = np.add.reduceat(left * (residual / noise)[:, None], edges)
    share = np.add.reduceat(left[:, :, None] * left[:, None, :], edges)
    lengths = [_Blocks(pull, share)]
    while len(lengths[-1].pull) % 2 == 0 and len(lengths[-1].pull) >= 2 * FEWEST_BLOCKS:
        lengths.append(lengths[-1].doubled())
    probability = min(1.0, len(lengths) * min(blocks.improbable() for blocks in lengths))
    together = [blocks.together() for blocks in lengths]
    both = float(sum(together[-2:]))
    if probability > _SUSPICION:
        return Uncertainty(white.covariance, noise, Wander(0, 1.0, probability, both), count - size, root, None)
    alone = [pulls < _ALONE for pulls in together]
    at = next((at for at in range(len(lengths)) if all(alone[at:])), len(lengths) - 1)
    chosen, growth = lengths[at], 1.0
    if at:  # noise of length L leaves L / 3B of its variance out of blocks of length B, twice that out of B / 2
        growth += max(0.0, 1.0 - lengths[at - 1].scatter / chosen.scatter)
    wander = Wander(len(chosen.pull), float(np.sqrt(growth * chosen.scatter)), probability, both)
    return Uncertainty(growth * noise**2 * root @ chosen.covariance @ root.T, noise, wander, count - size, root, chosen)


def _edges(count: int, begins: Sequence[int]) -> NDArray[np.intp]:
    """Return first reading of each of the shortest blocks; none where the readings are too few.

    Up to a dozen records are divided into blocks each, so that no block goes across; more are taken as one.
    """
    records = [*begins, count] if 0 < len(begins) <= 12 else [0, count]
    pieces = -(-FEWEST_BLOCKS // (len(records) - 1))
    shortest = min(end - begin for begin, end in pairwise(records))
    if shortest < pieces * 2 * _SHORTEST:
        records, pieces, shortest = [0, count], FEWEST_BLOCKS, count
    levels = min(_LEVELS, int(np.log2(max(shortest // (pieces * _SHORTEST), 1))) + 1)
    if levels < 2:
        return np.empty(0, np.intp)
    each = pieces * 2 ** (levels - 1)
    return np.concatenate([
        np.linspace(begin, end, each, endpoint=False).astype(np.intp)
        for begin, end in pairwise(records)
    ])  # fmt: skip


def odd_readings(points: Floats) -> Flags:
    """Return which readings lie off the surface of the others.

    Args:    points: (n, d), d = 2 or 3, any unit.
    Returns: (n,); at most one in a thousand, or one reading. All false where more lie off: then they are not odd.
    Source:  see the head of this file.
    """
    off = off_surface(points)
    return off if few(off.sum(), len(off)) else np.zeros_like(off)


def off_surface(points: Floats) -> Flags:
    """Return which readings lie off the surface of most others, (n,), as ``odd_readings``, however many they are."""
    count = len(points)
    middle = np.median(points, axis=0)
    scale = float(np.median(np.linalg.norm(points - middle, axis=1)))
    unit = (points - middle) / (scale or 1.0)
    columns = monomials(unit)
    drawn = _TIMES * columns.shape[1]
    if scale == 0.0 or count < 2 * drawn:
        return np.zeros(count, np.bool_)
    rng = np.random.default_rng(_SEED)
    subsets = np.stack([rng.choice(count, drawn, replace=False) for _ in range(_SUBSETS)])
    coefficients = np.linalg.svd(columns[subsets], full_matrices=False)[2][:, -1]
    distances = [_distance(unit, columns, each) for each in coefficients]
    best = min(distances, key=lambda each: float(np.median(each)))
    return np.asarray(best > max(_FAR * float(scatter(best)), _ROUNDING))


def change_of_surface(points: Floats) -> int:
    """Return the first reading of another surface: where two quadrics, one after the other, leave least.

    Args:    points: (n, 3), in order of time.   Returns: 0 if two leave more than a quarter of what one leaves.
    """
    unit = (points - points.mean(axis=0)) / points.std()
    columns = monomials(unit)
    sums = np.cumsum(columns[:, :, None] * columns[:, None, :], axis=0)
    fewest = _TIMES * columns.shape[1]
    ends = np.arange(fewest, len(points) - fewest)
    left = [np.linalg.eigvalsh(part)[..., 0] for part in (sums[ends - 1], sums[-1] - sums[ends - 1], sums[-1])]
    both = left[0] + left[1]
    return int(ends[np.argmin(both)]) if ends.size and both.min() < left[2] / 4.0 else 0


def monomials(points: Floats) -> Floats:
    """Return squares and products, components and one, (n, 10) of three axes."""
    rows, columns = np.triu_indices(points.shape[1])
    return np.column_stack((points[:, rows] * points[:, columns], points, np.ones(len(points))))


def _distance(points: Floats, columns: Floats, coefficients: Floats) -> Floats:
    """Return distance of each point from a surface, to first order, (n,)."""
    dimensions = points.shape[1]
    form = np.zeros((dimensions, dimensions))
    form[np.triu_indices(dimensions)] = coefficients[: -dimensions - 1]
    slope = points @ (form + form.T) + coefficients[-dimensions - 1 : -1]
    return np.asarray(np.abs(columns @ coefficients) / np.maximum(np.linalg.norm(slope, axis=1), 1e-12))
