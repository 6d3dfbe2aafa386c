"""Tables of a ring laser: random walk before and after, alignment time, constants, and what the records held."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bench.analysis import Table, with_uncertainty
from bench.systems.lock_in.compensation import COMPENSATORS, RAW
from bench.systems.lock_in.estimates import ARCSEC, NATO_MIL_DEG, Requirement, alignment_s
from bench.systems.lock_in.estimators.bias import bias_alignment_error_deg
from bench.systems.lock_in.result import LaserResult, Measured, squared, walk_dof, walk_std_deg_rth
from bench.systems.lock_in.wording import label, say


def tables(results: Sequence[LaserResult], requirement: Requirement, method: str) -> list[Table]:
    """Return all tables, those that are read first in front."""
    return [
        _comparison(results, method),
        _alignment(results, requirement, method),
        _constants(results),
        _walks(results),
        _material(results),
    ]


def _table(
    results: Sequence[LaserResult], headers: Sequence[str], rows: Sequence[Sequence[Sequence[Any]]], **words: Any
) -> Table:
    """Return a table with the columns that say which record a row is of; ``rows``: those of each record."""
    settings = [laser.record.phase_setting_deg for laser in results]
    several = any(setting is not None for setting in settings)
    whole = []
    for laser, phase, lines in zip(results, settings, rows, strict=True):
        place = [f"{100 * laser.record.path_length_m:g}", f"{laser.clock_Hz / 1e6:g}"]
        place += [] if not several else ["–" if phase is None else f"{phase:g}"]
        whole += [[*place, *line] for line in lines]
    places = _heads("path", "clock", *(["phase_set"] if several else []))
    return Table(headers=[*places, *headers], rows=whole, **words)


def _heads(*names: str) -> list[str]:
    return [say(f"head.{name}") for name in names]


def _comparison(results: Sequence[LaserResult], method: str) -> Table:
    rows = []
    for laser in results:
        phase = laser.backscatter_deg
        seen = "–" if phase is None else f"{phase.value:.1f}"
        rows.append([[seen, *(_ratio(laser, name) for name in COMPENSATORS)]])
    headers = [*_heads("found"), *map(label, COMPENSATORS)]
    title, caption = say("comparison.title"), say("comparison.caption", method=label(method))
    return _table(results, headers, rows, title=title, caption=caption, lead=True)


def _ratio(laser: LaserResult, method: str) -> str:
    ratio = laser.ratio(method)
    shown = _bounded(ratio)
    return say("cell.worse", ratio=shown) if ratio is not None and laser.is_worse(method) else shown


def _text(measured: Measured | None, factor: float = 1.0) -> str:
    if measured is None:
        return say("cell.no_result")
    return with_uncertainty(factor * measured.value, factor * measured.expanded)


def _bounded(measured: Measured | None, factor: float = 1.0) -> str:
    """As ``_text``; of a value that cannot be told from 0, what it does not exceed."""
    if measured is None or measured.value > measured.expanded:
        return _text(measured, factor)
    return _below(factor * (measured.value + measured.expanded))


def _below(limit: float) -> str:
    return f"< {float(f'{limit:.2g}'):g}"


def _alignment(results: Sequence[LaserResult], requirement: Requirement, method: str) -> Table:
    rows = []
    for laser in results:
        raw, after, ratio = laser.walks.get(RAW), laser.walks.get(method), laser.ratio(method)
        times = [None if walk is None else alignment_s(walk, requirement) for walk in (raw, after)]
        factor = None if ratio is None else squared(ratio)
        rows.append([[*(_bounded(value) for value in (*times, factor)), _by_bias(laser, method, requirement)]])
    mil = requirement.error_deg / NATO_MIL_DEG
    caption = say(
        "alignment.caption", error=requirement.error_deg, mil=mil, latitude=requirement.latitude_deg,
        method=label(method),
    )  # fmt: skip
    headers = _heads("before", "after", "factor", "by_bias")
    return _table(results, headers, rows, title=say("alignment.title"), caption=caption, lead=True)


def _by_bias(laser: LaserResult, method: str, requirement: Requirement) -> str:
    """Return the alignment error by the bias instability of an output, NATO mil, or its upper limit."""
    bias = laser.biases.get(method)
    if bias is None:
        return say("cell.no_result")
    of_one = bias_alignment_error_deg(1.0, requirement.latitude_deg) / NATO_MIL_DEG
    if not bias.shown:
        return _below(of_one * bias.upper_deg_h)
    return _text(Measured(bias.value_deg_h, bias.std_deg_h), of_one)


def _constants(results: Sequence[LaserResult]) -> Table:
    rows = []
    for laser in results:
        share, sensed = laser.systematic_share, laser.record.dither_deg_s
        cells = [_text(laser.lock_in_deg_s, 1e3), _text(laser.backscatter_deg)]
        cells += ["–" if sensed is None else f"{sensed:.2f}", f"{laser.counted_dither_deg_s:.2f}"]
        rows.append([[*cells, "–" if share is None else f"{100 * share:.1f}"]])
    headers = _heads("lock_in_rate", "backscatter", "dither_sensed", "dither_counted", "left")
    return _table(results, headers, rows, title=say("constants.title"), caption=say("constants.caption"))


def _walks(results: Sequence[LaserResult]) -> Table:
    rows = [[_walk_row(laser, method) for method in (RAW, *COMPENSATORS) if method in laser.walks] for laser in results]
    headers = _heads("output", "random_walk", "quantisation", "theory", "chi2")
    return _table(results, headers, rows, title=say("walks.title"), caption=say("walks.caption"))


def _walk_row(laser: LaserResult, method: str) -> list[str]:
    walk = laser.walks[method]
    cells = [_bounded(Measured(walk.n_deg_rth, walk_std_deg_rth(walk), walk_dof(walk)), 1e3)]
    cells.append(_text(Measured(walk.q_deg, walk.q_std_deg), 1e3 * ARCSEC) if walk.q_deg > 0.0 else "–")
    expected = laser.expected_deg_rth if method == RAW else None
    theory = "" if expected is None else f"{1e3 * expected:#.3g}"
    return [label(method), *cells, theory, f"{walk.chi2:.1f} / {walk.dof}"]


def _material(results: Sequence[LaserResult]) -> Table:
    rows = []
    for laser in results:
        sums, events = laser.found, laser.events
        unused = (say(f"unused.{name}", count=count) for name, count in sorted(sums.counts.items()) if count)
        why = say.listed(unused, "list.comma")
        cells = [f"{sums.seconds:.2f}", sums.edges, sums.turnarounds, sums.grazing, why or "0"]
        lost = [sums.stretches, events.lost_blocks, events.lost_edges, sums.breaks + sums.repaired]
        rows.append([[*cells, *lost]])
    headers = _heads("time", "edges", "turnarounds", "grazing", "not_used", "stretches", "blocks_lost", "dropped",
                     "missing_inside")  # fmt: skip
    return _table(results, headers, rows, title=say("material.title"), caption=say("material.caption"))
