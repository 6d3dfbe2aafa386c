"""What else could have made a series of readings: a step in time, a second thermal lag, a finer curve.

Each rival is a short fixed list of further columns beside the fitted model, lag and half-width free to follow in their
first order. Where the noise was fitted to the same readings it is fitted again for every rival: it would otherwise
have taken the misfit for noise already.
Source: docs/decisions/0025-doubt.md; Seber and Lee, Linear Regression Analysis (2003), section 4.3 (F test of further
columns); Bonferroni's inequality over the list of a rival.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bench.maths.arrays import Floats
from bench.maths.tests import chi2_tail, f_tail, of_many
from bench.systems.af_converter.estimators.hysteresis.search import Place, Problem, derivatives

Whiten = Callable[[Floats], Floats]
STEP, SECOND_LAG, FINER = "a step", "a second thermal lag", "a finer dependence on temperature"
_CODES = {
    STEP: "rival_step",
    SECOND_LAG: "rival_second_thermal_lag",
    FINER: "rival_finer_temperature",
}
_STEPS = 1000  # places of a step, at most
_EDGE = 0.02  # of the readings, at either end
_LAGS = 8
_HIGHER = (4, 5, 6)
_RANK = 1e-9
_TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True)
class Rival:
    """``candidates``: further columns (m, q), one set for each of ``places`` (time in h, lag in min; 0 for none)."""

    name: str
    candidates: Sequence[Floats]
    places: Sequence[float]


@dataclass(frozen=True)
class Base:
    """The fitted model in first order: ``columns`` (m, p) called ``names``, ``residual`` (m,) of the readings.

    ``values`` (p,): the parameters that leave this residual.
    """

    names: tuple[str, ...]
    columns: Floats
    residual: Floats
    values: Floats

    def value(self, name: str) -> float:
        """Return the parameter called ``name``."""
        return float(self.values[self.names.index(name)])


@dataclass(frozen=True)
class Noise:
    """One covariance that the noise may have; ``log_volume``: half the logarithm of its determinant.

    ``known``: its size is declared, and chi-square is one.
    """

    whiten: Whiten
    log_volume: float = 0.0
    known: bool = True


@dataclass(frozen=True)
class Outcome:
    """How well the best candidate of a rival does: ``gain`` in twice the log-likelihood, ``probability`` of it by
    chance over the whole list, and by how much each parameter of the base would differ (``shift``).
    """

    name: str
    place: float
    gain: float
    probability: float
    shift: Mapping[str, float]


def code_of(name: str) -> str:
    """Return the stable code of a rival. Args: name: of the rival. Source: definition."""
    return _CODES[name]


def base_of(problem: Problem, lag_s: float, half_width_degC: float, names: Sequence[str]) -> Base:
    """Return the joint fit in first order about a lag and a half-width.

    Args:    names: what the two nonlinear parameters are called.
    Source:  Golub and Pereyra (1973): linear parameters solved, lag and half-width by their slopes.
    """
    columns = problem.model.columns(lag_s, half_width_degC)
    linear = np.asarray(np.linalg.lstsq(problem.whiten(columns), problem.white, rcond=None)[0], dtype=np.float64)
    slopes = derivatives(problem, Place(lag_s, half_width_degC, 0.0), linear)
    values = np.append(linear, [lag_s, half_width_degC])
    residual = problem.readings - columns @ linear
    return Base((*problem.model.names, *names), np.column_stack((columns, slopes)), residual, values)


def beside(base: Base, name: str, column: Floats) -> Base:
    """Return a base with a further column that no rival may win by.

    Args:    column: (m,).
    Source:  definition.
    """
    columns = np.column_stack((base.columns, column))
    return Base((*base.names, name), columns, base.residual, np.append(base.values, 0.0))


def likeliest(base: Base, noises: Sequence[Noise]) -> Noise:
    """Return the covariance under which the base leaves the likeliest residuals.

    Args:    base: the fitted model.   noises: those to choose from.
    Source:  maximum likelihood.
    """
    states = [_State.under(noise, base) for noise in noises]
    return min(states, key=lambda state: state.cost).noise


def steps(middle_s: Floats) -> Rival:
    """Return one step before any reading but the first and last few. Args: middle_s: (m,). Source: see the module."""
    m = middle_s.size
    edge = max(2, round(_EDGE * m))
    at = np.unique(np.linspace(edge, m - edge, min(_STEPS, m)).round().astype(np.int64))
    hours = [float((middle_s[first] - middle_s[0]) / 3600.0) for first in at]
    return Rival(STEP, [(np.arange(m) >= first).astype(np.float64)[:, None] for first in at], hours)


def finer(temperature_degC: Floats, beside: Floats) -> Rival:
    """Return what a cubic and one width leave out: the next orders, and a difference that changes over temperature.

    Args:    temperature_degC: (m,).   beside: (m,), the column of the difference between the branches.
    Source:  Legendre polynomials, orthogonal over the span; see the module.
    """
    low, high = float(temperature_degC.min()), float(temperature_degC.max())
    x = (2.0 * temperature_degC - low - high) / (high - low)
    higher = [np.polynomial.legendre.legval(x, np.eye(order + 1)[order]) for order in _HIGHER]
    return Rival(FINER, [np.column_stack((*higher, beside * x))], [0.0])


def second_lag(problem: Problem, lag_s: float, lags_s: tuple[float, float]) -> Rival:
    """Return a second lag, beside or behind the first.

    Args:    lag_s: of the fit.   lags_s: between which the second one is looked for.
    Source:  two masses in a row answer like (t1 F1 - t2 F2) / (t1 - t2), a sum of two first-order lags.
    """
    model = problem.model
    near = model.unit_degC(lag_s)
    seconds = [
        float(second_s)
        for second_s in np.geomspace(*lags_s, _LAGS)
        if lag_s <= 0 or abs(np.log(second_s / lag_s)) > np.log(1.3)
    ]
    columns = [(model.unit_degC(second_s) - near)[:, None] for second_s in seconds]
    return Rival(SECOND_LAG, columns, [second_s / 60.0 for second_s in seconds])


def compare(base: Base, rivals: Iterable[Rival], noises: Sequence[Noise]) -> list[Outcome]:
    """Fit every rival beside the base, under each covariance that the noise may have.

    Args:    rivals: lists of further columns.   noises: one that is declared, or those to choose from.
    Returns: one Outcome a rival, that of its best candidate.
    Source:  see the module; likelihood ratio, and its F form where the size of the noise is fitted.
    """
    listed = list(rivals)
    states = [_State.under(noise, base) for noise in noises]
    best = min(state.cost for state in states)
    return [_outcome(rival, base, states, best) for rival in listed]


@dataclass(frozen=True)
class _State:
    """The base under one covariance: orthonormal ``basis``, white ``rest`` of the residual and its square."""

    noise: Noise
    basis: Floats
    rest: Floats
    square: float
    dof: int

    @classmethod
    def under(cls, noise: Noise, base: Base) -> _State:
        white = noise.whiten(np.column_stack((base.residual, base.columns)))
        basis = _orthonormal(white[:, 1:])
        rest = white[:, 0] - basis @ (basis.T @ white[:, 0])
        return cls(noise, basis, rest, float(rest @ rest), rest.size - basis.shape[1])

    @property
    def cost(self) -> float:
        """Twice minus the log-likelihood of the base itself."""
        return float(self.costs(np.array(self.square)))

    def costs(self, squares: Floats) -> Floats:
        """Twice minus the log-likelihood, for each square of what is left."""
        if self.noise.known:
            return squares
        return 2.0 * self.noise.log_volume + self.dof * np.log(np.maximum(squares, _TINY))

    def squares(self, stacked: Floats, width: int) -> tuple[Floats, Floats]:
        """Squares of what every candidate leaves, (k,), and how many columns each adds."""
        white = self.noise.whiten(stacked)
        white = white - self.basis @ (self.basis.T @ white)
        if width == 1:
            square = np.einsum("ij,ij->j", white, white)
            new = square > (_RANK * np.linalg.norm(stacked)) ** 2
            gained = (self.rest @ white) ** 2 / np.where(new, square, 1.0)
            return self.square - np.where(new, gained, 0.0), new.astype(np.int64)
        left, added = [], []
        for start in range(0, white.shape[1], width):
            own = _orthonormal(
                white[:, start : start + width], float(np.linalg.norm(stacked[:, start : start + width]))
            )
            left.append(self.square - float(np.sum((own.T @ self.rest) ** 2)))
            added.append(own.shape[1])
        return np.array(left), np.array(added)


def _orthonormal(columns: Floats, scale: float = 0.0) -> Floats:
    """Orthonormal basis of what columns span, those that add nothing left out."""
    length = np.linalg.norm(columns, axis=0)
    left, singular, _ = np.linalg.svd(columns / np.where(length > 0, length, 1.0), full_matrices=False)
    kept = (singular > _RANK * max(float(singular[0]), 1e-300)) & (length.max() > _RANK * scale)
    return left[:, kept]


def _outcome(rival: Rival, base: Base, states: Sequence[_State], best: float) -> Outcome:
    width = rival.candidates[0].shape[1]
    stacked = np.column_stack(list(rival.candidates))
    found: list[tuple[float, int, int, int]] = []  # cost, state, candidate, columns added
    for index, state in enumerate(states):
        left, added = state.squares(stacked, width)
        costs = state.costs(left)
        at = int(np.argmin(costs))
        found.append((float(costs[at]), index, at, int(added[at])))
    cost, index, at, added_columns = min(found)
    state, gain = states[index], max(best - cost, 0.0)
    chance = of_many(_chance(gain, added_columns, state), len(rival.candidates))
    shift = _shift(rival.candidates[at], base, state.noise)
    return Outcome(rival.name, rival.places[at], gain, chance, shift)


def _chance(gain: float, added: int, state: _State) -> float:
    if not added:
        return 1.0
    if state.noise.known:
        return chi2_tail(gain, added)
    rest = state.dof - added
    return f_tail(float(np.expm1(gain / state.dof)) * rest / added, added, rest)


def _shift(candidate: Floats, base: Base, noise: Noise) -> dict[str, float]:
    """By how much each parameter differs with the candidate beside it."""
    design = noise.whiten(np.column_stack((base.columns, candidate)))
    scale = np.linalg.norm(design, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    solved = np.linalg.lstsq(design / scale, noise.whiten(base.residual), rcond=_RANK)[0] / scale
    return dict(zip(base.names, solved[: len(base.names)].tolist(), strict=True))
