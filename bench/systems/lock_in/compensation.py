"""One record of a ring laser through every compensator: angles, jumps and what of them the figures show.

A stretch without a gap is analysed by itself; the increments of all of them make one series with a hole between two.
Nothing that is as long as the edges outlives its stretch.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bench.analysis import Floats
from bench.maths.arrays import Flags, Integers
from bench.maths.samples import few
from bench.model.errors import FitError
from bench.systems.lock_in.estimators.global_constants import GlobalConstants, global_constants
from bench.systems.lock_in.estimators.random_walk import (
    cycle_increments,
    net_angle,
    odd_steps,
)
from bench.systems.lock_in.estimators.single_turnarounds import dither_shape, fresnel, parabolas
from bench.systems.lock_in.estimators.turnarounds import Jumps, Turnarounds, edge_levels, turnarounds
from bench.systems.lock_in.records import Events, Stretch
from bench.systems.lock_in.wording import say

Compensator = Callable[[Turnarounds], Jumps]
RAW, GLOBAL = "raw", "global_constants"
SINGLE: Mapping[str, Compensator] = {
    "fresnel": fresnel,
    "dither_shape_16": lambda turns: dither_shape(turns, 16),
    "dither_shape": lambda turns: dither_shape(turns, 4),
    "parabolas": lambda turns: parabolas(turns, 4),
}
COMPENSATORS: tuple[str, ...] = (GLOBAL, *SINGLE)
_FEWEST_PICKOFFS = 3  # a dither period and a half
_SHOWN = 400  # turnarounds of the figures that show single ones


@dataclass(frozen=True)
class Shown:
    """Turnarounds of the first stretch, for the figures.

    ``time_s``, ``phase_rad``: of the crossings round the first of them, (k, 2M).   ``jumps``: by method, (k,).
    ``psi0_rad``: phase at the turnaround, ``left_rad``: jump that the crossings still show behind the global fit, both
    of the whole stretch.
    """

    time_s: Floats
    phase_rad: Floats
    jumps: Mapping[str, Floats]
    psi0_rad: Floats
    left_rad: Floats


@dataclass
class Compensated:
    """Increments and counts of all stretches of a record.

    ``increments``: by method and ``raw``, radians of Sagnac phase per dither period, NaN between stretches. A
    turnaround that a compensator could not estimate stays as it is.
    ``constants``: of the global fit, one per stretch.   ``refused``: method to reason.   ``counts``: why turnarounds
    were not used.   ``swing_rad``: mean peak-to-peak phase of a dither period, from the counted levels.
    ``missing``: edges lost inside stretches.
    ``dither_scatter``: of its amplitude from turnaround to turnaround, relative, from the curvatures.
    ``odd_s``: when the count went odd, from the beginning of its stretch; few are left out (``odd_left_out``).
    """

    interval_s: float
    omega_rad_s: float
    increments: dict[str, Floats]
    shown: Shown
    constants: list[GlobalConstants] = field(default_factory=list)
    refused: dict[str, str] = field(default_factory=dict)
    stretches: int = 1
    turnarounds: int = 0
    used: dict[str, int] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)
    grazing: int = 0
    edges: int = 0
    missing: int = 0
    seconds: float = 0.0
    swing_rad: float = 0.0
    dither_scatter: float | None = None
    odd_s: list[float] = field(default_factory=list)
    odd_left_out: bool = True


@dataclass
class _Part:
    """One stretch behind its edges, which take more room than all that follows, and through every compensator."""

    turns: Turnarounds
    psi_rad: Floats
    pickoff_rising: Flags
    swing_rad: float
    edges: int
    missing: int
    seconds: float
    odd_s: list[float]
    odd_left_out: bool
    jumps: dict[str, Jumps] = field(default_factory=dict)
    constants: list[GlobalConstants] = field(default_factory=list)
    increments: dict[str, Floats] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)


def compensated(stretches: list[Stretch], counts: Events, number: int) -> Compensated:
    """Return every compensator over every stretch of one record; the list is empty afterwards.

    ``counts``: what was lost between the stretches.
    Raises: FitError B-RLG-007 if no stretch has edges of the beat and of the dither pick-off over some dither periods.
    """
    parts: list[_Part] = []
    refused: list[str] = []
    seen = [(stretch.ticks.size, stretch.pickoff_ticks.size) for stretch in stretches]
    while stretches:
        if stretches[0].pickoff_ticks.size < _FEWEST_PICKOFFS:
            stretches.pop(0)
            continue
        try:
            parts.append(_compensate(_counted(stretches.pop(0), counts.clock_Hz)))
        except FitError as error:
            refused.append(f"{error.message} ({error.code})")
    if not parts:
        raise _nothing(seen, counts, number, refused)
    return _joined(parts)


def _counted(stretch: Stretch, clock_Hz: float) -> _Part:
    edges = edge_levels(stretch.ticks, stretch.rising, stretch.cosine)
    turns = turnarounds(edges, stretch.pickoff_ticks, stretch.pickoff_rising, clock_Hz)
    half_cycles = max(1, stretch.pickoff_ticks.size - 1)
    psi_rad = net_angle(edges, stretch.pickoff_ticks)
    odd = odd_steps(psi_rad, stretch.pickoff_rising, turns.regular)
    odd_left_out = left_out(odd, turns.usable.size)
    if odd_left_out:
        psi_rad[odd + 1] = np.nan  # the steps to it and from it are not known
    inside = (edges.tick >= stretch.pickoff_ticks[0]) & (edges.tick <= stretch.pickoff_ticks[-1])
    return _Part(
        turns=turns,
        psi_rad=psi_rad,
        pickoff_rising=stretch.pickoff_rising,
        swing_rad=float(np.pi * np.count_nonzero(inside) / half_cycles),
        edges=int(edges.tick.size),
        missing=edges.repaired + int(edges.breaks.size),
        seconds=float(edges.tick[-1] - edges.tick[0]) / clock_Hz,
        odd_s=((stretch.pickoff_ticks[odd] - edges.tick[0]) / clock_Hz).tolist(),
        odd_left_out=odd_left_out,
    )


def _compensate(part: _Part) -> _Part:
    """Add what every compensator makes of a stretch."""
    turns = part.turns
    try:
        part.constants.append(global_constants(turns))
        part.jumps[GLOBAL] = part.constants[0].jumps
    except FitError as error:
        part.refused[GLOBAL] = say("error", why=error.message, code=error.code)
    for name, compensator in SINGLE.items():
        try:
            part.jumps[name] = compensator(turns)
        except FitError as error:
            part.refused[name] = say("error", why=error.message, code=error.code)
    part.increments[RAW] = cycle_increments(part.psi_rad, part.pickoff_rising, turns)
    for name, jump in part.jumps.items():
        taken_off = replace(jump, dpsi_rad=np.nan_to_num(jump.dpsi_rad))  # nothing where nothing could be estimated
        part.increments[name] = cycle_increments(part.psi_rad, part.pickoff_rising, turns, taken_off)
    return part


def left_out(odd: Integers, of: int) -> bool:
    """Return whether odd half periods are few enough to be left out: one in a thousand, and one at least.

    Two in succession are one: what happens at the pick-off's edge is in the steps to it and from it.
    """
    return few(np.count_nonzero(np.diff(odd, prepend=-2) > 1), of)


def _joined(parts: Sequence[_Part]) -> Compensated:
    joined = Compensated(
        interval_s=float(np.mean([2.0 * np.pi / part.turns.omega_rad_s for part in parts])),
        omega_rad_s=float(np.mean([part.turns.omega_rad_s for part in parts])),
        increments={name: _with_holes(parts, name) for name in (RAW, *COMPENSATORS)},
        swing_rad=float(np.mean([part.swing_rad for part in parts])),
        stretches=len(parts),
        shown=_shown(parts[0]),
        dither_scatter=_scatter(parts),
        odd_left_out=all(part.odd_left_out for part in parts),
    )
    for part in parts:
        joined.turnarounds += int(part.turns.usable.size)
        for name, jumps in part.jumps.items():
            joined.used[name] = joined.used.get(name, 0) + int(np.isfinite(jumps.dpsi_rad).sum())
        joined.constants += part.constants
        joined.refused.update(part.refused)
        joined.counts.update(part.turns.counts)
        joined.grazing += int(part.turns.grazing.sum())
        joined.edges += part.edges
        joined.missing += part.missing
        joined.seconds += part.seconds
        joined.odd_s += part.odd_s
    return joined


def _scatter(parts: Sequence[_Part]) -> float | None:
    """Relative scatter of the dither's amplitude; that of the curvatures of the phase is the same."""
    curvatures = [part.jumps[GLOBAL].curvature_rad_s2 for part in parts if GLOBAL in part.jumps]
    return float(np.nanstd(np.concatenate(curvatures)) / np.nanmean(np.concatenate(curvatures))) if curvatures else None


def _with_holes(parts: Sequence[_Part], name: str) -> Floats:
    """Return increments of all stretches with one NaN between two; of a stretch that a method refused, NaN alone."""
    pieces: list[Floats] = []
    for part in parts:
        pieces += [np.array([np.nan])] if pieces else []
        pieces.append(part.increments.get(name, np.full_like(part.increments[RAW], np.nan)))
    return np.concatenate(pieces)


def _shown(part: _Part) -> Shown:
    reference = part.jumps.get(GLOBAL) or next(iter(part.jumps.values()), None)
    nothing = np.full(part.turns.usable.size, np.nan)
    return Shown(
        time_s=part.turns.time_s[:_SHOWN].copy(),
        phase_rad=part.turns.phase_rad[:_SHOWN].copy(),
        jumps={name: jumps.dpsi_rad[:_SHOWN].copy() for name, jumps in part.jumps.items()},
        psi0_rad=nothing if reference is None else reference.psi0_rad,
        left_rad=part.constants[0].residual_jump_rad if part.constants else nothing,
    )


def _nothing(seen: Sequence[tuple[int, int]], counts: Events, number: int, refused: Sequence[str]) -> FitError:
    edges, pickoffs = sum(beat for beat, _ in seen), sum(pickoff for _, pickoff in seen)
    lost = f"{counts.lost_blocks} blocks lost, {counts.lost_edges} edges dropped"
    why = "".join(f"; {text}" for text in dict.fromkeys(refused))
    return FitError(
        "B-RLG-007",
        f"{edges} edges of the beat and {pickoffs} of the dither pick-off in {len(seen)} unbroken "
        f"stretches ({lost}) determine no random walk{why}",
        where=f"record {number}",
        next_step="see that laser and dither run, that the pick-off is on channel 1, that no comparator is "
        "inverted and that the tagger drops no edge",
    )
