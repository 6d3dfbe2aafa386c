"""Tables of a north finder: result, convention, methods, calibration, tilt, harmonics of the waveform."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy import special

from bench.analysis import Table, number, with_uncertainty
from bench.maths.verdict import coverage_factor
from bench.systems.north.accuracy import COVERAGE, Accuracy, QUARTER_TURN_deg, bench_s, measured_s
from bench.systems.north.estimators.likelihood import SQUARE_PENALTY, LikelihoodNorth
from bench.systems.north.estimators.phasors import INDEX_TO_NORTH
from bench.systems.north.sets import SEARCH, SENSES, TEST
from bench.systems.north.solution import LITERAL, METHODS, Solution
from bench.systems.north.solve import HARMONICS

FALSE_CLAIM = 0.01  # of tables of noise alone, in which a harmonic is claimed
_NAMES = {
    "half_turn": "result half a turn off",
    "flipped_17": "terms of (17) on another branch",
    "flipped_18": "terms of (18) on another branch",
    "amplitude_19": "(19) is 0/0 or more than 10 % off",
    "amplitude_20": "(20) is 0/0 or more than 10 % off",
    "u2_zero": "U2 = 0 in (21)",
}


def result_table(solution: Solution, method: str, limit_deg: float) -> Table:
    """Return what is read first: azimuth of every heading by the method that is judged."""
    rows: list[list[Any]] = []
    several = solution.kinds != [""]
    for mean in solution.means(method):
        factor = coverage_factor(mean.dof)
        azimuth = with_uncertainty(mean.azimuth_deg % 360.0, factor * mean.std_deg)
        error = with_uncertainty(mean.error_deg, factor * mean.error_std_deg) if mean.item == TEST else "–"
        stated = number((solution.site.azimuth_deg + mean.head_deg) % 360.0, 3) if mean.item == TEST else "not known"
        kind = [mean.parameters or "–"] if several else []
        rows.append([mean.item, mean.place or "–", *kind, number(mean.head_deg), stated, azimuth, error, mean.n])
    tested = any(mean.item == TEST for mean in solution.means(method))
    caption = (
        f"Heading of the sensing axis at encoder zero, clockwise from north, by {method}; intervals of 95 %: noise, "
        f"calibration, tilt and stated azimuth. {f'Limit of the error: {limit_deg:g} deg.' if tested else ''}"
    )
    kinds = ["parameters"] if several else []
    headers = ["what", "place", *kinds, "head, deg", "stated, deg", "azimuth, deg", "error, deg", "repeats"]
    found_north = any(mean.item == SEARCH for mean in solution.means(method))
    title = "North" if found_north else "North at known azimuths"
    return Table(title, caption.strip(), headers, rows, lead=True)


def convention_table(solution: Solution) -> Table:
    """Return how a phase at the index becomes a heading."""
    rows: list[list[Any]] = [
        ["heading", "of the sensing axis at encoder zero, clockwise from north, deg"],
        ["table angle", "counter-clockwise from above, deg; the axis points to heading - angle"],
        ["phi", "phase of the earth signal at index A, taken as a sine"],
    ]
    senses = {north_set.sense for north_set in solution.sets if math.isfinite(north_set.rate_deg_s)}
    rows += [[f"table {SENSES[sense]}", INDEX_TO_NORTH[sense]] for sense in sorted(senses, reverse=True)]
    rows.append(["tilt", "what the level says of the rotation axis, times tan(latitude), is added to the heading"])
    caption = "The phase itself is no heading, and its sign depends on the sense of rotation."
    title = "From index to north: convention index_to_north"
    return Table(title, caption, ["quantity", "meaning"], rows, prose=True, lead=True)  # fmt: skip


def method_table(accuracy: list[Accuracy], solution: Solution, limit_deg: float) -> Table:
    """Return every method at the known azimuths."""
    bound_deg = solution.bound_deg[np.isfinite(solution.bound_deg)]
    bound = f"{np.sqrt(np.mean(bound_deg**2)):.3f} deg" if bound_deg.size else "not known without raw samples"
    rows = [
        [errors.method, errors.used, number(errors.rms_deg, 3), number(errors.mean_deg, 3),
         number(errors.scatter_deg, 3), number(errors.ratio, 2), errors.gross, _seconds(errors.time_s)]
        for errors in accuracy
    ]  # fmt: skip
    caption = (
        f"Errors of single sets at the known azimuths, folded into one turn. Scatter is about the mean error, which "
        f"comes from the calibration; where a method mistakes half a turn, both "
        f"are taken without regard to it. Bound by {measured_s(solution):.1f} s of samples: {bound}; with "
        f"a square reference {SQUARE_PENALTY:.3f} times as much. Time: measuring time until {COVERAGE:g} standard "
        f"uncertainties are within {limit_deg:g} deg; one set takes {bench_s(solution):.0f} s of the bench."
    )
    headers = ["method", "sets", "RMS, deg", "mean, deg", "scatter, deg", "scatter / bound",
               "more than 90 deg off", "time, s"]  # fmt: skip
    return Table("Methods", caption, headers, rows, lead=True)


def _seconds(time_s: float) -> str:
    return "never" if math.isinf(time_s) else number(time_s, 1)


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
    caption = "Errors of the means of all repeats, deg, folded into one turn."
    headers = ["head, deg", *(["parameters"] if several else []), "stated, deg", *METHODS]
    return [Table("Errors by method", caption, headers, rows)] if rows else []


def parameter_table(solution: Solution) -> list[Table]:
    """Return every method with constant and with varying parameters side by side; nothing where the sets name none."""
    if solution.kinds == [""]:
        return []
    rows = []
    for method in METHODS:
        error_deg, cells = solution.error_deg(method), []
        for kind in solution.kinds:
            seen = np.isfinite(error_deg) & solution.with_parameters(kind)
            rms_deg = float(np.sqrt(np.mean(error_deg[seen] ** 2))) if seen.any() else math.nan
            off = int(np.sum(np.abs(error_deg[seen]) > QUARTER_TURN_deg))
            cells += [int(seen.sum()), number(rms_deg, 3), off]
        rows.append([method, *cells])
    caption = (
        "Errors of single sets at the known azimuths, folded into one turn. TIP: time-invariant parameters, TVP: "
        "amplitude and swing of the table vary in time (paper figure 6)."
    )
    headers = [f"{kind}: {what}" for kind in solution.kinds for what in ("sets", "RMS, deg", "more than 90 deg off")]
    return [Table("Constant and varying parameters", caption, ["method", *headers], rows, lead=True)]


def failure_table(solution: Solution) -> Table:
    """Return what goes wrong in the paper's formulas as they are printed."""
    seen = np.isfinite(solution.u1_V).all(axis=1) & np.isfinite(solution.u2_V).all(axis=1)
    count = int(seen.sum())
    rows = [
        [_NAMES.get(name, name.replace("_", " ")), int(np.sum(flags[seen] > 0)), count]
        for name, flags in solution.failures.items()
    ]
    caption = (
        f"Equations (15) to (21) as printed ({LITERAL}): an arctangent of a ratio knows half a turn only, its terms "
        "change branch one by one, and the amplitudes are 0/0 where the phase is a multiple of 90 deg."
    )
    headers = ["what fails", "sets", "of"]
    return Table("Failures of the literal formulas", caption, headers, rows)


def calibration_table(solution: Solution) -> list[Table]:
    """Placement, gain and offset of both lock-ins."""
    rows: list[list[Any]] = []
    for sense, index in solution.calibrations.items():
        std = np.sqrt(np.diag(index.covariance))
        factor = coverage_factor(index.dof)
        for letter, gain, gain_std, at_deg, deg_std, offset in (
            ("B, lock-in 1", index.f1, std[0], index.f2_deg, std[1], sense * index.f3),  # oriented: its sign turned
            ("A, lock-in 2", index.f4, std[2], index.f5_deg, std[3], index.f6),
        ):
            placement = with_uncertainty(sense * float(at_deg), factor * float(deg_std))
            row = [SENSES[sense], letter, placement, with_uncertainty(float(gain), factor * float(gain_std))]
            rows.append([*row, number(1e3 * float(offset), 3), index.sets])
    if not rows:
        return []
    caption = (
        "At the stated azimuth. The eight samples know the sum of phase and placement only, so placement comes from "
        "here: with it any constant delay between the gyro and the lock-in."
    )
    headers = ["rotation", "index", "placement, deg", "gain, V RMS", "offset, mV", "sets"]
    return [Table("Calibration of the index", caption, headers, rows)]


def tilt_table(solution: Solution) -> list[Table]:
    """Return what the level measured, and what it does to the azimuth; one row per heading."""
    rows: dict[tuple[Any, ...], list[Any]] = {}
    for north_set, tilt_deg in zip(solution.sets, solution.tilt_deg, strict=True):
        if north_set.tilt_mrad is not None:
            x, y = north_set.tilt_mrad
            row = [north_set.item, number(north_set.head_deg), number(x, 3), number(y, 3), number(float(tilt_deg), 4)]
            rows.setdefault(north_set.group, row)
    if not rows:
        return []
    caption = (
        "Tilt of the rotation axis about the sensing axis at encoder zero (x) and about the direction 90 deg clockwise "
        "of it (y). Only the part about north turns the apparent north, by tan(latitude)."
    )
    headers = ["what", "head, deg", "x, mrad", "y, mrad", "correction, deg"]
    return [Table("Tilt", caption, headers, list(rows.values()))]


def harmonic_table(solution: Solution) -> list[Table]:
    """Harmonics of the turn in the raw waveform, and what each would do behind a square reference."""
    raw = [waveform for waveform in solution.raw if waveform is not None]
    if not raw:
        return []
    amplitude_V = float(np.mean([float(waveform.amplitude) for waveform in raw]))
    power_V2 = np.mean([np.abs(waveform.harmonics) ** 2 for waveform in raw], axis=0)
    noise_V2 = float(np.mean([_harmonic_noise_V2(waveform) for waveform in raw]))
    dof = float(np.sum([int(waveform.samples) - 3 - 2 * len(HARMONICS) for waveform in raw]))
    floor = 100.0 * math.sqrt(noise_V2 * _most_by_chance(len(raw), dof)) / amplitude_V
    rows = []
    for order, power in zip(HARMONICS, power_V2.tolist(), strict=True):
        apparent = 100.0 * math.sqrt(power) / amplitude_V
        share = 100.0 * math.sqrt(max(power - noise_V2, 0.0)) / amplitude_V
        square_deg = math.degrees(share / 100.0 / order) if order % 2 else 0.0
        rows.append(
            [order, f"below {floor:.2g}", "–"] if apparent <= floor else [order, f"{share:.3f}", f"{square_deg:.3f}"]
        )
    caption = (
        f"RMS over {len(raw)} waveforms less what noise makes of it; below the limit nothing is claimed: noise alone "
        f"is above it in {100.0 * FALSE_CLAIM:g} % of such tables. A sine as the reference lets none of them in; a "
        "square one, as the paper has it, the odd ones."
    )
    headers = ["harmonic", "part of the amplitude, %", "azimuth error by a square reference, at most, deg"]
    return [Table("Harmonics of the waveform", caption, headers, rows)]


def _harmonic_noise_V2(waveform: LikelihoodNorth) -> float:
    """Return the mean square of a harmonic by noise alone; as much larger as the turns scatter, where it has colour."""
    colour = float(waveform.whiteness) if waveform.widened else 1.0
    return 4.0 * float(waveform.noise_V) ** 2 / int(waveform.samples) * max(1.0, colour)


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
