"""Tables of a ring laser: random walk before and after, alignment time, constants, and what the records held."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bench.analysis import Table, with_uncertainty
from bench.maths.verdict import coverage_factor
from bench.systems.lock_in.compensation import COMPENSATORS, RAW
from bench.systems.lock_in.estimates import ARCSEC, NATO_MIL_DEG, Requirement, alignment_s
from bench.systems.lock_in.estimators.bias import bias_alignment_error_deg
from bench.systems.lock_in.result import LaserResult, Measured, squared, walk_std_deg_rth

LABELS = {
    "global_constants": "global constants",
    "fresnel": "Fresnel, 16 a side",
    "dither_shape_16": "dither shape, 16 a side",
    "dither_shape": "dither shape, 4 a side",
    "parabolas": "parabolas, 4 a side",
    RAW: "uncompensated",
}


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
    places = ["path, cm", "clock, MHz", *(["phase set, deg"] if several else [])]
    return Table(headers=[*places, *headers], rows=whole, **words)


def _comparison(results: Sequence[LaserResult], method: str) -> Table:
    rows = []
    for laser in results:
        phase = laser.backscatter_deg
        seen = "–" if phase is None else f"{phase.value:.1f}"
        rows.append([[seen, *(_ratio(laser, name) for name in COMPENSATORS)]])
    caption = (
        "Ratio and expanded uncertainty, or what it does not exceed where it cannot be told from 0; below 1 the "
        "compensator helps, WORSE marks where it adds random walk beyond its uncertainty. The verdict is on: "
        f"{LABELS[method]}."
    )
    headers = ["backscatter phase found, deg", *(LABELS[name] for name in COMPENSATORS)]
    title = "Random walk after compensation over that before"
    return _table(results, headers, rows, title=title, caption=caption, lead=True)


def _ratio(laser: LaserResult, method: str) -> str:
    ratio = laser.ratio(method)
    if ratio is None:
        return "no result"
    return _bounded(ratio) + (" WORSE" if laser.is_worse(method) else "")


def _text(measured: Measured | None, factor: float = 1.0) -> str:
    if measured is None:
        return "no result"
    return with_uncertainty(factor * measured.value, factor * coverage_factor() * measured.std)


def _bounded(measured: Measured | None, factor: float = 1.0) -> str:
    """As ``_text``; of a value that cannot be told from 0, what it does not exceed."""
    if measured is None or measured.value > coverage_factor() * measured.std:
        return _text(measured, factor)
    return _below(factor * (measured.value + coverage_factor() * measured.std))


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
    caption = (
        f"Until the random walk alone lets the azimuth be known to {requirement.error_deg:.5g} deg ({mil:.3g} NATO "
        f"mil, one standard deviation) at latitude {requirement.latitude_deg:g} deg, equation (2); after: "
        f"{LABELS[method]}. Error by bias: equation (1), with the bias instability of the output after, or what that "
        "does not exceed (95 %); it stays however long one aligns. Averaging times end at a 20th of the record: what "
        "wanders more slowly, or changes from one switch-on to the next, no record shows."
    )
    headers = ["before, s", "after, s", "after over before", "error by bias, mil"]
    return _table(results, headers, rows, title="Alignment time", caption=caption, lead=True)


def _by_bias(laser: LaserResult, method: str, requirement: Requirement) -> str:
    """Return the alignment error by the bias instability of an output, NATO mil, or its upper limit."""
    bias = laser.biases.get(method)
    if bias is None:
        return "no result"
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
    caption = (
        "By the global fit. Left: what the crossings still show behind it as a function of the phase, per RMS jump; a "
        "few per cent and more say that one lock-in of constant size and phase is not all there is. Dither: mean "
        "amplitude by the sensor of the unit, and from the levels counted in a half cycle."
    )
    headers = [
        "lock-in rate, mdeg/s",
        "backscatter phase, deg",
        "dither sensed, deg/s",
        "dither counted, deg/s",
        "left, %",
    ]
    return _table(results, headers, rows, title="Constants of the lock-in", caption=caption)


def _walks(results: Sequence[LaserResult]) -> Table:
    rows = [[_walk_row(laser, method) for method in (RAW, *COMPENSATORS) if method in laser.walks] for laser in results]
    caption = (
        "Fitted together to the overlapping Allan deviation of the latched counts. Theory: the recovered lock-in rate "
        "over the root of gain and counted dither rate, equation (6). Where chi-squared says that the two terms do not "
        "describe the deviation, the interval of the random walk is as much wider. A dash: random walk hides the "
        "quantisation."
    )
    headers = ["output", "random walk, 1e-3 deg/h^0.5", "quantisation, 1e-3 arcsec", "theory, 1e-3 deg/h^0.5",
               "chi-squared / degrees of freedom"]  # fmt: skip
    return _table(results, headers, rows, title="Random walk and quantisation", caption=caption)


def _walk_row(laser: LaserResult, method: str) -> list[str]:
    walk = laser.walks[method]
    cells = [_bounded(Measured(walk.n_deg_rth, walk_std_deg_rth(walk)), 1e3)]
    cells.append(_text(Measured(walk.q_deg, walk.q_std_deg), 1e3 * ARCSEC) if walk.q_deg > 0.0 else "–")
    expected = laser.expected_deg_rth if method == RAW else None
    theory = "" if expected is None else f"{1e3 * expected:.3g}"
    return [LABELS[method], *cells, theory, f"{walk.chi2:.4g} / {walk.dof}"]


def _material(results: Sequence[LaserResult]) -> Table:
    rows = []
    for laser in results:
        sums, events = laser.found, laser.events
        why = ", ".join(f"{name.replace('_', ' ')} {count}" for name, count in sorted(sums.counts.items()) if count)
        cells = [f"{sums.seconds:.2f}", sums.edges, sums.turnarounds, sums.grazing, why or "–"]
        lost = [sums.stretches, events.lost_blocks, events.lost_edges, sums.breaks + sums.repaired]
        rows.append([[*cells, *lost]])
    caption = (
        "A lost block or a dropped edge ends a stretch: nothing is bridged. Grazing: the phase turned within 0.01 rad "
        "of a level, so the crossings next to the turnaround were left out. A turnaround that is not used stays "
        "uncompensated. Blocks lost within the record; what is lost between records, while the tagger is set and "
        "started again, is among the lost frames of the session only."
    )
    headers = ["time, s", "edges", "turnarounds", "grazing", "turnarounds not used", "stretches", "blocks lost within",
               "edges dropped", "edges missing inside"]  # fmt: skip
    return _table(results, headers, rows, title="What the records hold", caption=caption)
