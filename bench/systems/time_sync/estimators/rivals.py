"""What else could be true of a recording: each rival as columns beside the unknowns of the filter.

Source: generalised least squares; likelihood ratio of nested linear models with known covariance (chi-square) and with
one that is known up to a factor (F), of which the less odd counts; union bound over the times of a step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from bench.maths.arrays import Floats
from bench.maths.tests import chi2_tail, f_tail, of_many
from bench.systems.time_sync.estimators.differences import STATES, Differences

_INDEPENDENT = 1e-3  # of a column that the unknowns of the filter do not take in
_EDGE = 2  # blocks that lie at the least before and behind a step


@dataclass(frozen=True)
class Rival:
    """``offset_s``: correction of the guess by the model with the rival.   ``probability``: of as odd data without it.
    ``size``: of its columns.
    """

    name: str
    offset_s: float
    probability: float
    size: Floats


@dataclass(frozen=True)
class OneMotion:
    """Fit of all differences: ``offset_s`` (correction of the guess), its ``std_s``, residuals and rivals."""

    offset_s: float
    std_s: float
    chi2: float
    dof: int
    rivals: tuple[Rival, ...]

    @property
    def probability(self) -> float:
        """Of residuals at least as large."""
        return chi2_tail(self.chi2, self.dof)


def one_motion(found: Differences, prior_std: Floats, prior: Floats) -> OneMotion:
    """Fit offset and errors of the inertial unit to the differences, and each rival beside them.

    Args:    found: differences.   prior_std: (7,) of biases and offset as stated beforehand, prior: (7,) what they are
             expected to be against the guess.
    Source:  see the head of this file.
    """
    blocks = found.at_s.size
    root = linalg.cholesky(found.covariance, lower=True)

    def white(columns: Floats) -> Floats:
        return np.asarray(linalg.solve_triangular(root, columns.reshape(9 * blocks, -1), lower=True))

    unknowns = np.concatenate((found.states, found.motion[..., None]), axis=2)
    known = np.zeros((7, STATES + 1))
    known[:, STATES - 6 :] = np.diag(1.0 / prior_std)
    design = np.concatenate((white(unknowns), known))
    y = np.concatenate((white(found.y)[:, 0], prior / prior_std))
    scale = np.linalg.norm(design, axis=0)
    Q, R = np.linalg.qr(design / scale)
    residual = y - Q @ (Q.T @ y)
    last = 1.0 / (R[-1, -1] * scale[-1])
    work = _Work(Q, residual, float(residual @ residual), y.size - STATES - 1, last)
    offset_s = float((Q.T @ y)[-1] * last)
    rivals = [
        work.rival(name, np.concatenate((white(columns), np.zeros((7, columns.shape[2])))), offset_s)
        for name, columns in found.others.items()
    ]
    rivals += [_stepped(found, work, white, offset_s)]
    return OneMotion(offset_s, abs(float(last)), work.chi2, work.dof, tuple(rivals))


def _stepped(found: Differences, work: _Work, white: object, offset_s: float) -> Rival:
    """Return the most likely step of the offset between two blocks."""
    steps = []
    for edge in range(_EDGE, found.at_s.size - _EDGE + 1):
        later = found.motion * (np.arange(found.at_s.size) >= edge)[:, None]
        column = np.concatenate((white(later), np.zeros((7, 1))))  # type: ignore[operator]
        steps.append(work.rival("offset_steps", column, offset_s))
    best = min(steps, key=lambda step: step.probability)
    return Rival(best.name, best.offset_s, of_many(best.probability, len(steps)), best.size)


@dataclass(frozen=True)
class _Work:
    """Whitened fit: orthogonal columns, residuals, their square and degrees of freedom, scale of the offset."""

    Q: Floats
    residual: Floats
    chi2: float
    dof: int
    last: float

    def rival(self, name: str, columns: Floats, offset_s: float) -> Rival:
        """Fit columns beside the unknowns."""
        length = np.linalg.norm(columns, axis=0)
        columns = columns / np.where(length > 0.0, length, 1.0)
        taken = self.Q.T @ columns
        U, S, Vt = np.linalg.svd(columns - self.Q @ taken, full_matrices=False)
        seen = S > _INDEPENDENT
        if not seen.any():
            return Rival(name, offset_s, 1.0, np.zeros(length.size))
        along = U[:, seen].T @ self.residual
        size = Vt[seen].T @ (along / S[seen])
        gained, count = float(along @ along), int(seen.sum())
        left = (self.chi2 - gained) / (self.dof - count)
        by_size = chi2_tail(gained, count)
        by_ratio = f_tail(gained / count / left, count, self.dof - count)
        moved_s = float((taken @ size)[-1] * self.last)
        return Rival(name, offset_s - moved_s, max(by_size, by_ratio), size / np.where(length > 0.0, length, 1.0))
