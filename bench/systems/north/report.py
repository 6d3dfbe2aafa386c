"""Sentences a reader of the azimuths of a north finder must know, and its tables.

Tables: result, convention, methods, calibration, tilt, harmonics of the waveform.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy import special

from bench.analysis import Table, number, with_uncertainty, worded_table
from bench.maths.arrays import rms
from bench.maths.verdict import coverage_factor
from bench.systems.north.estimators.likelihood import SQUARE_PENALTY, LikelihoodNorth
from bench.systems.north.estimators.phasors import INDEX_TO_NORTH
from bench.systems.north.sets import SEARCH, TEST
from bench.systems.north.solution import (
    COVERAGE,
    LEAST_SQUARES,
    LIKELIHOOD,
    LITERAL,
    METHODS,
    QUADRANT,
    Accuracy,
    QUARTER_TURN_deg,
    Solution,
    bench_s,
    measured_s,
)
from bench.systems.north.solve import HARMONICS
from bench.systems.north.wording import item_name, method_name, place_name, say, sense_name

FALSE_CLAIM = 0.01  # of tables of noise alone, in which a harmonic is claimed
_MOST_NOISE_deg = 10.0  # of one set: beyond, a direction is no longer normal (half a percent of the interval)
_MOST_REPEATS = 4  # a calibration of fewer sets than that limits what repeats can do


def result_table(solution: Solution, method: str, limit_deg: float) -> Table:
    """Return what is read first: azimuth of every heading by the method that is judged."""
    rows: list[list[Any]] = []
    several = solution.kinds != [""]
    for mean in solution.means(method):
        factor = coverage_factor(mean.dof)
        azimuth = with_uncertainty(mean.azimuth_deg % 360.0, factor * mean.std_deg)
        error = with_uncertainty(mean.error_deg, factor * mean.error_std_deg) if mean.item == TEST else "–"
        stated = (
            number((solution.site.azimuth_deg + mean.head_deg) % 360.0, 3)
            if mean.item == TEST
            else say("result.not_known")
        )
        kind = [mean.parameters or "–"] if several else []
        rows.append(
            [item_name(mean.item), place_name(mean.place), *kind, number(mean.head_deg), stated, azimuth, error, mean.n]
        )
    tested = any(mean.item == TEST for mean in solution.means(method))
    caption = (
        say("result.caption_limit", method=method_name(method), limit=limit_deg)
        if tested
        else say("result.caption", method=method_name(method))
    )
    kinds = ["parameters"] if several else []
    headers = say.heads("", "what", "place", *kinds, "head", "stated", "azimuth", "error", "repeats")
    found_north = any(mean.item == SEARCH for mean in solution.means(method))
    title = say("result.title") if found_north else say("result.title_known")
    return Table(title, caption, headers, rows, lead=True)


def convention_table(solution: Solution) -> Table:
    """Return how a phase at the index becomes a heading."""
    rows: list[list[Any]] = [
        [say(f"convention.{name}"), say(f"convention.{name}_means")] for name in ("heading", "angle", "phi")
    ]
    senses = {north_set.sense for north_set in solution.sets if math.isfinite(north_set.rate_deg_s)}
    rows += [
        [say("convention.sense", sense=sense_name(sense)), INDEX_TO_NORTH[sense]]
        for sense in sorted(senses, reverse=True)
    ]
    rows.append([say("convention.tilt"), say("convention.tilt_means")])
    return worded_table(say, "convention", ["quantity", "meaning"], rows, prose=True, lead=True)


def method_table(accuracy: list[Accuracy], solution: Solution, limit_deg: float) -> Table:
    """Return every method at the known azimuths."""
    bound_deg = solution.bound_deg[np.isfinite(solution.bound_deg)]
    bound = say("methods.no_bound")
    if bound_deg.size:
        bound = say("methods.bound", bound=rms(bound_deg))
    rows = [
        [method_name(errors.method), errors.used, number(errors.rms_deg, 3), number(errors.mean_deg, 3),
         number(errors.scatter_deg, 3), number(errors.ratio, 2), errors.gross, _seconds(errors.time_s)]
        for errors in accuracy
    ]  # fmt: skip
    heads = ["method", "sets", "rms", "mean", "scatter", "scatter_over_bound", "gross", "time"]
    return worded_table(
        say, "methods", heads, rows, lead=True, measured=measured_s(solution), bound=bound, penalty=SQUARE_PENALTY,
        coverage=COVERAGE, limit=limit_deg, bench=bench_s(solution),
    )  # fmt: skip


def _seconds(time_s: float) -> str:
    return say("methods.never") if math.isinf(time_s) else number(time_s, 1)


def error_table(solution: Solution) -> list[Table]:
    """Return mean error of each known azimuth, by every method side by side."""
    by_method = {
        method: {(mean.head_deg, mean.parameters): mean for mean in solution.means(method) if mean.item == TEST}
        for method in METHODS
    }
    places = dict.fromkeys(place for means in by_method.values() for place in means)
    several = solution.kinds != [""]
    rows = [
        [number(place[0]), *([place[1]] if several else []), number((solution.site.azimuth_deg + place[0]) % 360.0, 3)]
        + [number(means[place].error_deg, 3) if place in means else "–" for means in by_method.values()]
        for place in places
    ]
    heads = ["head", *(["parameters"] if several else []), "stated"]
    return [worded_table(say, "errors", heads, rows, [*map(method_name, METHODS)])] if rows else []


def parameter_table(solution: Solution) -> list[Table]:
    """Return every method with constant and with varying parameters side by side; nothing where the sets name none."""
    if solution.kinds == [""]:
        return []
    rows = []
    for method in METHODS:
        error_deg, cells = solution.error_deg(method), []
        for kind in solution.kinds:
            seen = np.isfinite(error_deg) & solution.with_parameters(kind)
            rms_deg = rms(error_deg[seen]) if seen.any() else math.nan
            off = int(np.sum(np.abs(error_deg[seen]) > QUARTER_TURN_deg))
            cells += [int(seen.sum()), number(rms_deg, 3), off]
        rows.append([method_name(method), *cells])
    counted = say.heads("", "sets", "rms", "gross")
    headers = [say("head.of_kind", kind=kind, what=what) for kind in solution.kinds for what in counted]
    return [worded_table(say, "parameters", ["method"], rows, headers, lead=True)]


def failure_table(solution: Solution) -> Table:
    """Return what goes wrong in the paper's formulas as they are printed."""
    seen = np.isfinite(solution.u1_V).all(axis=1) & np.isfinite(solution.u2_V).all(axis=1)
    count = int(seen.sum())
    rows = [[say(f"failures.{name}"), int(np.sum(flags[seen] > 0)), count] for name, flags in solution.failures.items()]
    return worded_table(say, "failures", ["fails", "sets", "of"], rows, method=method_name(LITERAL))


def calibration_table(solution: Solution) -> list[Table]:
    """Placement, gain and offset of both lock-ins."""
    rows: list[list[Any]] = []
    for sense, index in solution.calibrations.items():
        std = np.sqrt(np.diag(index.covariance))
        factor = coverage_factor(index.dof)
        for letter, gain, gain_std, at_deg, deg_std, offset in (
            (say("index.b"), index.f1, std[0], index.f2_deg, std[1], sense * index.f3),  # oriented: its sign turned
            (say("index.a"), index.f4, std[2], index.f5_deg, std[3], index.f6),
        ):
            placement = with_uncertainty(sense * float(at_deg), factor * math.hypot(deg_std, solution.placed_deg))
            row = [sense_name(sense), letter, placement, with_uncertainty(float(gain), factor * float(gain_std))]
            rows.append([*row, number(1e3 * float(offset), 3), index.sets])
    if not rows:
        return []
    heads = ["rotation", "index", "placement", "gain", "offset", "sets"]
    return [worded_table(say, "index", heads, rows)]


def tilt_table(solution: Solution) -> list[Table]:
    """Return what the level measured, and what it does to the azimuth; one row per heading."""
    rows: dict[tuple[Any, ...], list[Any]] = {}
    for north_set, tilt_deg in zip(solution.sets, solution.tilt_deg, strict=True):
        if north_set.tilt_mrad is not None:
            x, y = north_set.tilt_mrad
            row = [
                item_name(north_set.item),
                number(north_set.head_deg),
                number(x, 3),
                number(y, 3),
                number(float(tilt_deg), 4),
            ]
            rows.setdefault(north_set.group, row)
    if not rows:
        return []
    heads = ["what", "head", "x_tilt", "y_tilt", "correction"]
    return [worded_table(say, "tilt", heads, list(rows.values()))]


def harmonic_table(solution: Solution) -> list[Table]:
    """Harmonics of the turn in the raw waveform, and what each would do behind a square reference."""
    raw = [waveform for waveform in solution.raw if waveform is not None]
    if not raw:
        return []
    amplitude_V = float(np.mean([waveform.amplitude for waveform in raw]))
    power_V2 = np.mean([np.abs(waveform.harmonics) ** 2 for waveform in raw], axis=0)
    noise_V2 = float(np.mean([_harmonic_noise_V2(waveform) for waveform in raw]))
    dof = float(np.sum([waveform.samples - 3 - 2 * len(HARMONICS) for waveform in raw]))
    floor = 100.0 * math.sqrt(noise_V2 * _most_by_chance(len(raw), dof)) / amplitude_V
    rows = []
    for order, power in zip(HARMONICS, power_V2.tolist(), strict=True):
        apparent = 100.0 * math.sqrt(power) / amplitude_V
        share = 100.0 * math.sqrt(max(power - noise_V2, 0.0)) / amplitude_V
        square_deg = math.degrees(share / 100.0 / order) if order % 2 else 0.0
        shown = (
            [f"{share:.3f}", f"{square_deg:.3f}"] if apparent > floor else [say("harmonics.below", floor=floor), "–"]
        )
        rows.append([order, *shown])
    heads = ["harmonic", "share", "square"]
    return [worded_table(say, "harmonics", heads, rows, count=len(raw), chance=100.0 * FALSE_CLAIM)]


def _harmonic_noise_V2(waveform: LikelihoodNorth) -> float:
    """Return the mean square of a harmonic by noise alone; as much larger as the turns scatter, where it has colour."""
    colour = waveform.whiteness if waveform.widened else 1.0
    return 4.0 * waveform.noise_V**2 / waveform.samples * max(1.0, colour)


def _most_by_chance(waveforms: int, dof: float) -> float:
    """Return power of a harmonic over its noise that one of all is above in ``FALSE_CLAIM`` of tables of noise.

    Source: the mean power of n waveforms over the noise of ``dof`` degrees of freedom has an F distribution with 2 n
    and ``dof``; Sidak's inequality for the orders of one table, which are orthogonal over whole turns.
    """
    each = 1.0 - (1.0 - FALSE_CLAIM) ** (1.0 / len(HARMONICS))
    return float(special.fdtri(2.0 * waveforms, dof, 1.0 - each))


def tables(solution: Solution, method: str, accuracy: list[Accuracy], limit_deg: float) -> list[Table]:
    """All, those that are read first in front."""
    return [
        result_table(solution, method, limit_deg),
        convention_table(solution),
        method_table(accuracy, solution, limit_deg),
        *parameter_table(solution),
        *error_table(solution),
        failure_table(solution),
        *calibration_table(solution),
        *tilt_table(solution),
        *harmonic_table(solution),
    ]


def north_notes(solution: Solution, method: str, accuracy: list[Accuracy]) -> list[str]:
    """Return all of them."""
    bound = "note.bound" if np.isfinite(solution.bound_deg).any() else "note.no_samples"
    notes = [
        say(bound), *_uncertainty(solution, method), *_doubts(solution, method),
        *_formulas(accuracy), *_whiteness(solution), *_left_out(solution),
    ]  # fmt: skip
    return notes + [say("note.missing", what=sentence) for sentence in solution.missing]


def _uncertainty(solution: Solution, method: str) -> list[str]:
    notes = []
    if not any(north_set.tilt_mrad for north_set in solution.sets):
        notes.append(say("note.no_tilt"))
    elif not solution.site.tilt_std_deg:
        notes.append(say("note.level_not_stated"))
    if not solution.site.azimuth_std_deg:
        notes.append(say("note.azimuth_not_stated"))
    notes += [
        say("note.no_calibration", sense=sense_name(sense))
        for sense in sorted({north_set.sense for north_set in solution.sets})
        if solution.calibrations and sense not in solution.calibrations
    ]
    share_deg = solution.by_method[method].common_deg
    if share_deg > solution.by_method[method].noise_deg / math.sqrt(_MOST_REPEATS):
        notes.append(say("note.calibration_share", share=share_deg))
    return notes


def _doubts(solution: Solution, method: str) -> list[str]:
    """Return what no uncertainty can know: a weak signal, sets without a level, two rates."""
    notes = [say("note.unsteady", method=method_name(LEAST_SQUARES))] if solution.unsteady else []
    one_deg = math.hypot(solution.by_method[method].noise_deg, solution.by_method[method].common_deg)
    if one_deg > _MOST_NOISE_deg:
        notes.append(say("note.weak_signal", noise=one_deg))
    if 0 < (count := sum(north_set.tilt_mrad is None for north_set in solution.sets)) < len(solution.sets):
        notes.append(say("note.no_level", count=count, of=len(solution.sets)))
    rates = {round(abs(north_set.rate_deg_s), 1) for north_set in solution.sets if math.isfinite(north_set.rate_deg_s)}
    if len(rates) > 1 and solution.calibrations:
        notes.append(say("note.two_rates", rates=", ".join(f"{rate:g}" for rate in sorted(rates))))
    return notes


def _formulas(accuracy: list[Accuracy]) -> list[str]:
    return [
        say("note.gross", method=method_name(errors.method), gross=errors.gross, used=errors.used)
        for errors in accuracy
        if errors.method in (LITERAL, QUADRANT) and errors.gross
    ]


def _whiteness(solution: Solution) -> list[str]:
    by_waveform = solution.by_method[LIKELIHOOD]
    if math.isfinite(by_waveform.dof):
        ratio = by_waveform.noise_deg / float(np.sqrt(np.nanmean(solution.bound_deg**2)))
        return [say("note.turns_not_white", ratio=ratio, method=method_name(LIKELIHOOD))]
    widened = sum(waveform.widened for waveform in solution.raw if waveform is not None)
    if not widened:
        return []
    return [say("note.not_white", count=widened, of=len(solution.sets), method=method_name(LIKELIHOOD))]


def _left_out(solution: Solution) -> list[str]:
    return [
        say("note.left_out", name=north_set.name, count=int(north_set.left_out.sum()), of=north_set.left_out.size)
        for north_set in solution.sets
        if north_set.left_out is not None
    ]
