"""Tables of a north finder: result, convention, methods, calibration, tilt, harmonics of the waveform."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from bench.analysis.numbers import number, with_uncertainty
from bench.maths.verdict import coverage_factor
from bench.systems.north.accuracy import COVERAGE, Accuracy, bench_s, measured_s
from bench.systems.north.estimates import SENSES
from bench.systems.north.estimators.bound import SQUARE_PENALTY
from bench.systems.north.estimators.phasors import INDEX_TO_NORTH
from bench.systems.north.sets import SEARCH, TEST
from bench.systems.north.solution import LITERAL, METHODS, Solution
from bench.systems.north.solve import HARMONICS

Documents = list[dict[str, Any]]
_NAMES = {
    "half_turn": "result half a turn off",
    "flipped_17": "terms of (17) on another branch",
    "flipped_18": "terms of (18) on another branch",
    "amplitude_19": "(19) is 0/0 or more than 10 % off",
    "amplitude_20": "(20) is 0/0 or more than 10 % off",
    "u2_zero": "U2 = 0 in (21)",
}


def result_table(found: Solution, method: str, limit_deg: float) -> dict[str, Any]:
    """What is read first: azimuth of every heading by the method that is judged."""
    rows: list[list[Any]] = []
    for mean in found.means(method):
        factor = coverage_factor(mean.dof)
        azimuth = with_uncertainty(mean.azimuth_deg % 360.0, factor * mean.std_deg)
        error = with_uncertainty(mean.error_deg, factor * mean.error_std_deg) if mean.item == TEST else "–"
        stated = number((found.site.azimuth_deg + mean.head_deg) % 360.0, 3) if mean.item == TEST else "not known"
        rows.append([mean.item, mean.place or "–", number(mean.head_deg), stated, azimuth, error, mean.n])
    tested = any(mean.item == TEST for mean in found.means(method))
    caption = (
        f"Heading of the sensing axis at encoder zero, clockwise from north, by {method}; intervals of 95 %: noise, "
        f"calibration, tilt and stated azimuth. {f'Limit of the error: {limit_deg:g} deg.' if tested else ''}"
    )
    headers = ["what", "place", "head, deg", "stated, deg", "azimuth, deg", "error, deg", "repeats"]
    found_north = any(mean.item == SEARCH for mean in found.means(method))
    title = "North" if found_north else "North at known azimuths"
    return {"title": title, "caption": caption.strip(), "headers": headers, "rows": rows, "lead": True}


def convention_table(found: Solution) -> dict[str, Any]:
    """How a phase at the index becomes a heading."""
    rows: list[list[Any]] = [
        ["heading", "of the sensing axis at encoder zero, clockwise from north, deg"],
        ["table angle", "counter-clockwise from above, deg; the axis points to heading - angle"],
        ["phi", "phase of the earth signal at index A, taken as a sine"],
    ]
    senses = {one.sense for one in found.sets if math.isfinite(one.rate_deg_s)}
    rows += [[f"table {SENSES[sense]}", INDEX_TO_NORTH[sense]] for sense in sorted(senses, reverse=True)]
    rows.append(["tilt", "what the level says of the rotation axis, times tan(latitude), is added to the heading"])
    caption = "The phase itself is no heading, and its sign depends on the sense of rotation."
    title = "From index to north: convention index_to_north"
    return {"title": title, "caption": caption, "headers": ["quantity", "meaning"], "rows": rows, "prose": True,
            "lead": True}  # fmt: skip


def method_table(accuracy: list[Accuracy], found: Solution, limit_deg: float) -> dict[str, Any]:
    """Every method at the known azimuths."""
    bound_deg = found.bound_deg[np.isfinite(found.bound_deg)]
    bound = f"{np.sqrt(np.mean(bound_deg**2)):.3f} deg" if bound_deg.size else "not known without raw samples"
    rows = [
        [one.method, one.used, number(one.rms_deg, 3), number(one.worst_deg, 3), number(one.mean_deg, 3),
         number(one.scatter_deg, 3), number(one.ratio, 2), one.gross, _seconds(one.time_s)]
        for one in accuracy
    ]  # fmt: skip
    caption = (
        f"Errors of single sets at the known azimuths, folded into one turn. Scatter is about the mean error, which "
        f"comes from the calibration. Bound by {measured_s(found):.1f} s of samples: {bound}; with a square reference "
        f"{SQUARE_PENALTY:.3f} times as much. Time: measuring time until {COVERAGE:g} standard uncertainties are "
        f"within {limit_deg:g} deg; one set takes {bench_s(found):.0f} s of the bench."
    )
    headers = ["method", "sets", "RMS, deg", "worst, deg", "mean, deg", "scatter, deg", "scatter / bound",
               "more than 90 deg off", "time, s"]  # fmt: skip
    return {"title": "Methods", "caption": caption, "headers": headers, "rows": rows, "lead": True}


def _seconds(time_s: float) -> str:
    return "never" if math.isinf(time_s) else number(time_s, 1)


def error_table(found: Solution) -> Documents:
    """Mean error of each known azimuth, by every method side by side."""
    by_method = {
        method: {mean.head_deg: mean for mean in found.means(method) if mean.item == TEST} for method in METHODS
    }
    heads = dict.fromkeys(head for means in by_method.values() for head in means)
    rows = [
        [number(head), number((found.site.azimuth_deg + head) % 360.0, 3)]
        + [number(means[head].error_deg, 3) if head in means else "–" for means in by_method.values()]
        for head in heads
    ]
    caption = "Errors of the means of all repeats, deg, folded into one turn."
    headers = ["head, deg", "stated, deg", *METHODS]
    return [{"title": "Errors by method", "caption": caption, "headers": headers, "rows": rows}] if rows else []


def failure_table(found: Solution) -> dict[str, Any]:
    """What goes wrong in the paper's formulas as they are printed."""
    seen = np.isfinite(found.u1_V).all(axis=1) & np.isfinite(found.u2_V).all(axis=1)
    count = int(seen.sum())
    rows = [
        [_NAMES.get(name, name.replace("_", " ")), int(np.sum(flags[seen] > 0)), count]
        for name, flags in found.failures.items()
    ]
    caption = (
        f"Equations (15) to (21) as printed ({LITERAL}): an arctangent of a ratio knows half a turn only, its terms "
        "change branch one by one, and the amplitudes are 0/0 where the phase is a multiple of 90 deg."
    )
    headers = ["what fails", "sets", "of"]
    return {"title": "Failures of the literal formulas", "caption": caption, "headers": headers, "rows": rows}


def calibration_table(found: Solution) -> Documents:
    """Placement, gain and offset of both lock-ins."""
    rows: list[list[Any]] = []
    for sense, index in found.calibrations.items():
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
    return [{"title": "Calibration of the index", "caption": caption, "headers": headers, "rows": rows}]


def tilt_table(found: Solution) -> Documents:
    """What the level measured, and what it does to the azimuth; one row per heading."""
    rows: dict[tuple[Any, ...], list[Any]] = {}
    for one, tilt_deg in zip(found.sets, found.tilt_deg, strict=True):
        if one.tilt_mrad is not None:
            x, y = one.tilt_mrad
            row = [one.item, number(one.head_deg), number(x, 3), number(y, 3), number(float(tilt_deg), 4)]
            rows.setdefault(one.group, row)
    if not rows:
        return []
    caption = (
        "Tilt of the rotation axis about the sensing axis at encoder zero (x) and about the direction 90 deg clockwise "
        "of it (y). Only the part about north turns the apparent north, by tan(latitude)."
    )
    headers = ["what", "head, deg", "x, mrad", "y, mrad", "correction, deg"]
    return [{"title": "Tilt", "caption": caption, "headers": headers, "rows": list(rows.values())}]


def harmonic_table(found: Solution) -> Documents:
    """Harmonics of the turn in the raw waveform, and what each would do behind a square reference."""
    raw = [one for one in found.raw if one is not None]
    if not raw:
        return []
    amplitude_V = float(np.mean([float(one.amplitude) for one in raw]))
    power_V2 = np.mean([np.abs(one.harmonics) ** 2 for one in raw], axis=0)
    noise_V2 = float(np.mean([4.0 * float(one.noise_V) ** 2 / int(one.samples) for one in raw]))
    floor = 100.0 * math.sqrt(noise_V2 * (1.0 + COVERAGE / math.sqrt(len(raw)))) / amplitude_V
    rows = []
    for order, power in zip(HARMONICS, power_V2.tolist(), strict=True):
        apparent = 100.0 * math.sqrt(power) / amplitude_V
        share = 100.0 * math.sqrt(max(power - noise_V2, 0.0)) / amplitude_V
        square_deg = math.degrees(share / 100.0 / order) if order % 2 else 0.0
        rows.append(
            [order, f"below {floor:.2g}", "–"] if apparent <= floor else [order, f"{share:.3f}", f"{square_deg:.3f}"]
        )
    caption = (
        f"RMS over {len(raw)} waveforms less what noise makes of it; below the limit of 95 % nothing is claimed. A "
        "sine as the reference lets none of them in; a square one, as the paper has it, the odd ones."
    )
    headers = ["harmonic", "part of the amplitude, %", "azimuth error by a square reference, at most, deg"]
    return [{"title": "Harmonics of the waveform", "caption": caption, "headers": headers, "rows": rows}]


def tables(found: Solution, method: str, accuracy: list[Accuracy], limit_deg: float) -> Documents:
    """All, those that are read first in front."""
    return [
        result_table(found, method, limit_deg), convention_table(found), method_table(accuracy, found, limit_deg),
        *error_table(found), failure_table(found), *calibration_table(found),
        *tilt_table(found), *harmonic_table(found),
    ]  # fmt: skip
