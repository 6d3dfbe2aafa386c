"""From sets of eight samples and waveforms to azimuths by every method, with their uncertainty."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bench.analysis import Document, Floats
from bench.maths.arrays import Flags, rms
from bench.maths.tests import chi2_both, f_tail
from bench.model.errors import FitError
from bench.systems.north.estimators.formulas import literal_north, quadrant_north
from bench.systems.north.estimators.likelihood import LikelihoodNorth, likelihood_north
from bench.systems.north.estimators.phasors import (
    DOF,
    IDEAL,
    IndexCalibration,
    alternating,
    calibrate_index,
    eight_sample_north,
    heading_deg,
    oriented,
    phase_deg,
    tilt_correction_deg,
    wrapped_deg,
)
from bench.systems.north.sets import CALIBRATION, SEARCH, NorthSet, far_samples, screen, waveform_of
from bench.systems.north.solution import (
    LEAST_SQUARES,
    LIKELIHOOD,
    LITERAL,
    METHODS,
    QUADRANT,
    Azimuths,
    Site,
    Solution,
)
from bench.systems.north.wording import say

Found = tuple[Floats, Floats, float]  # apparent azimuth (n,), standard uncertainty (n,), degrees of freedom of one
HARMONICS = (2, 3, 4, 5)
_FALSE_ALARM = 0.01  # chance in a campaign that noise is taken for a changing amplitude, colour, or a wrong method
_LEAST = 2  # errors from which a scatter is judged


def solve(sets: Sequence[NorthSet], site: Site) -> Solution:
    """Azimuths of all sets by every method.

    Raises: FitError B-FOG-004 if there is no set that can be used.
    """
    screen(sets)
    of_one = 1.0 - (1.0 - _FALSE_ALARM) ** (1.0 / max(1, len(sets)))  # Sidak: one false alarm would tell of all sets
    return solved(sets, site, [_raw(north_set, of_one) for north_set in sets], _swing_deg(sets))


def solved(
    sets: Sequence[NorthSet], site: Site, raw: Sequence[LikelihoodNorth | None], swing_deg: float,
    noise_V: float | None = None,
) -> Solution:  # fmt: skip
    """Azimuths of sets and of the fits of their waveforms.

    ``noise_V``: declared standard deviation of one output of a lock-in; None for what the samples leave over.

    Raises: FitError B-FOG-004 if there is no set that can be used.
    """
    turned = [oriented(north_set.u1_V, north_set.u2_V, north_set.sense) for north_set in sets]
    u1_V, u2_V = (np.stack([pair[number] for pair in turned]) for number in (0, 1))
    good = np.array([not north_set.faults for north_set in sets])
    u1_V, u2_V = np.where(good[:, None], u1_V, math.nan), np.where(good[:, None], u2_V, math.nan)
    known_deg = np.array(
        [math.nan if north_set.item == SEARCH else site.azimuth_deg + north_set.head_deg for north_set in sets]
    )
    solution = Solution(sets, site, known_deg, np.zeros(len(sets)), good, u1_V, u2_V, raw, swing_deg)
    if not good.any() and not any(solution.raw):
        raise _nothing_usable(sets)
    _tilts(solution)
    _calibrate(solution, noise_V)
    by_samples = _by_eight_samples(solution, noise_V)
    if noise_V is None:
        by_samples = _across(solution, by_samples)
    apparent = by_samples | {LIKELIHOOD: _by_waveform(solution)}
    solution.by_method = {method: _azimuths(solution, method, *apparent[method]) for method in METHODS}
    for method in (QUADRANT, LITERAL, *([LEAST_SQUARES] if solution.unsteady else [])):
        solution.by_method[method] = _widened(solution, method)
    solution.missing = _missing(solution)
    return solution


def site_of(campaign: Document) -> Site:
    """Latitude of the bench, azimuth of the mark and how well both poses are known.

    Raises: FitError B-FOG-003 if the campaign does not state the first two.
    """
    site = campaign.get("site") or {}
    try:
        return Site(
            float(site["latitude_deg"]), float(site["azimuth_deg"]), float(site.get("azimuth_std_deg", 0.0)),
            float(site.get("tilt_std_deg", 0.0)),
        )  # fmt: skip
    except KeyError as error:
        raise FitError(
            "B-FOG-003",
            f"the campaign does not state {error} of the site",
            where="manifest: campaign.site",
            next_step="give latitude, and azimuth of the sensing axis at encoder zero, under 'site' of the sequence",
        ) from error


def _nothing_usable(sets: Sequence[NorthSet]) -> FitError:
    why = "; ".join(dict.fromkeys(fault for north_set in sets for fault in north_set.faults[:1]))
    return FitError(
        "B-FOG-004",
        f"none of the {len(sets)} sets can be used: {why}",
        next_step="correct what the flags say (range, reference, index pulses) and record again",
    )


def _raw(north_set: NorthSet, significance: float) -> LikelihoodNorth | None:
    """Of its waveform; a waveform that does not determine north is a fault of the set, not of the campaign."""
    waveform = waveform_of(north_set)
    if waveform is None:
        return None
    try:
        likelihood = likelihood_north(waveform.u_V, waveform.theta_deg, harmonics=HARMONICS, significance=significance)
        north_set.left_out = far_samples(waveform, likelihood, HARMONICS)
        if north_set.left_out is not None:
            u_V = np.where(north_set.left_out, math.nan, waveform.u_V)
            likelihood = likelihood_north(u_V, waveform.theta_deg, harmonics=HARMONICS, significance=significance)
    except FitError as error:
        north_set.raw_faults.append(say("fault.error", why=error.message, code=error.code))
        return None
    north_set.raw_faults += [say("fault.stopped", index=k) for k in waveform.standing()]
    return None if north_set.raw_faults else likelihood


def _swing_deg(sets: Sequence[NorthSet]) -> float:
    seen = [waveform.swing_deg for north_set in sets if (waveform := waveform_of(north_set)) is not None]
    return rms(seen) if seen else 0.0


def _tilts(solution: Solution) -> None:
    """Tilt is measured about the sensing axis: where its azimuth is not known, the apparent one is near enough."""
    by_samples = eight_sample_north(solution.u1_V, solution.u2_V).phi_deg
    by_encoder, _, _ = _by_waveform(solution)
    for k, north_set in enumerate(solution.sets):
        stated = (solution.known_deg[k], float(by_encoder[k]), float(heading_deg(by_samples[k], north_set.sense)))
        about_deg = next((each for each in stated if math.isfinite(each)), math.nan)
        if north_set.tilt_mrad is not None and math.isfinite(about_deg):
            x_mrad, y_mrad = north_set.tilt_mrad
            solution.tilt_deg[k] = float(tilt_correction_deg(x_mrad, y_mrad, about_deg, solution.site.latitude_deg))


def _calibrate(solution: Solution, noise_V: float | None) -> None:
    """Index placement, gains and offsets of each sense of rotation: a delay of the signal turns its sign with it."""
    calibrations: dict[int, IndexCalibration] = {}
    for sense in (1, -1):
        use = solution.good & solution.of(CALIBRATION) & (solution.sense == sense)
        if not use.any():
            continue
        apparent_deg = solution.known_deg[use] - solution.tilt_deg[use]
        try:
            calibrations[sense] = calibrate_index(
                solution.u1_V[use], solution.u2_V[use], phase_deg(apparent_deg, sense), noise_V
            )
        except FitError as error:
            _refuse_samples(solution, sense, say("fault.calibration", why=error.message, code=error.code))
    solution.calibrations = calibrations


def _refuse_samples(solution: Solution, sense: int, why: str) -> None:
    """No eight samples of this sense of rotation can be used; their waveforms need no calibration."""
    for k in np.flatnonzero(solution.good & (solution.sense == sense)).tolist():
        solution.good[k], solution.u1_V[k], solution.u2_V[k] = False, math.nan, math.nan
        if solution.sets[k].item == CALIBRATION:
            solution.sets[k].faults.append(why)


def _by_waveform(solution: Solution) -> Found:
    """By likelihood; the encoder angle carries the sense of rotation by itself."""
    north_deg = heading_deg(solution.of_waveforms("phi_deg"), 1)
    of_turns = _of_turns([waveform for waveform in solution.raw if waveform is not None])
    if of_turns is None:
        return north_deg, solution.of_waveforms("std_deg"), math.inf
    share, dof = of_turns
    return north_deg, share * solution.of_waveforms("white_std_deg"), dof


def _of_turns(raw: Sequence[LikelihoodNorth]) -> tuple[float, float] | None:
    """Return noise across the signal over that of all samples, and its degrees of freedom for one set.

    What an amplitude that changes leaves in the samples does not turn north, and what sways does so more than it
    leaves: where all turns together do not scatter as white noise would, their scatter is the uncertainty.
    Source: two-sided chi-square test of the variance of the turns; None where they do.
    """
    judged = [waveform for waveform in raw if math.isfinite(waveform.whiteness)]
    if not judged or len(judged) < len(raw):
        return None
    dof = float(sum(waveform.turns - 1 for waveform in judged))
    ratio = sum(waveform.whiteness * (waveform.turns - 1) for waveform in judged) / dof
    if chi2_both(ratio * dof, dof) > _FALSE_ALARM:
        return None
    return math.sqrt(ratio), dof / len(judged)


def _by_eight_samples(solution: Solution, noise_V: float | None) -> dict[str, Found]:
    """By the other methods, and what fails in the literal formulas."""
    n = len(solution.sets)
    at_deg = {method: np.full(n, math.nan) for method in METHODS}
    std_deg = {method: np.full(n, math.nan) for method in METHODS}
    failures: dict[str, Floats] = {}
    for sense in (1, -1):
        use: Flags = solution.sense == sense
        if not use.any():
            continue
        u1_V, u2_V, index = solution.u1_V[use], solution.u2_V[use], solution.calibrations.get(sense, IDEAL)
        literal_deg, failed = literal_north(u1_V, u2_V, index.f5_deg)
        quadrant = quadrant_north(u1_V, u2_V, index.f5_deg, noise_V)
        eight = eight_sample_north(u1_V, u2_V, index, noise_V)
        wider = 1.0 if index is IDEAL or noise_V is not None else _left_by_calibration(solution, use, index.sets)
        for method, phi_deg, north in (
            (LEAST_SQUARES, eight.phi_deg, eight),
            (QUADRANT, quadrant.phi_deg, quadrant),
            (LITERAL, literal_deg, quadrant),
        ):
            with np.errstate(divide="ignore", invalid="ignore"):  # theirs takes misplaced pulses for noise
                share = np.where(north.noise > 0.0, eight.noise / north.noise, 1.0)
            at_deg[method][use], std_deg[method][use] = heading_deg(phi_deg, sense), north.std_deg * share / wider
        for name, flags in failed.items():
            failures.setdefault(name, np.zeros(n))[use] = flags
    solution.failures = failures
    dof = _without_calibration(solution)
    return {method: (at_deg[method], std_deg[method], dof) for method in METHODS}


def _left_by_calibration(solution: Solution, use: Flags, sets: int) -> Floats:
    """Return by how much more than noise each set leaves over: gains and placements of a calibration of so many sets.

    Their differences between the lock-ins take two of the eight samples' four degrees of freedom: they come back as an
    error of their own in every other set, and in those of the calibration they are missing.
    Source: expected residual variance of linear least squares.
    """
    return np.sqrt(1.0 + np.where(solution.of(CALIBRATION)[use], -0.5, 0.5) / sets)


def _without_calibration(solution: Solution) -> float:
    """Return the degrees of freedom of one set without what the error of the calibration, common to all, takes.

    Source: variance of the mean of residual variances that share a part with two degrees of freedom, as
    ``_left_by_calibration`` has it.
    """
    sets = int(np.count_nonzero(solution.good))
    variance = 2.0 / (DOF * sets) if sets else 0.0
    for sense, index in solution.calibrations.items():
        others = int(np.count_nonzero(solution.good & (solution.sense == sense) & ~solution.of(CALIBRATION)))
        variance += (others / sets / (1.0 + 2.0 * index.sets)) ** 2
    return 2.0 / variance / sets if sets else DOF


def _across(solution: Solution, apparent: dict[str, Found]) -> dict[str, Found]:
    """Take the noise of least squares across the signal alone, where the rest says that the amplitude changes.

    Source: F test of the three other degrees of freedom of each set against the one across, over all sets.
    """
    across_deg, rest_deg2 = (np.full(len(solution.sets), math.nan) for _ in range(2))
    fitted = 0
    for sense in (1, -1):
        use: Flags = (solution.sense == sense) & np.isfinite(apparent[LEAST_SQUARES][0])
        if use.any():
            index = solution.calibrations.get(sense, IDEAL)
            parts = alternating(solution.u1_V[use], solution.u2_V[use], index)
            across_deg[use], rank = _without_twice(parts[0], apparent[LEAST_SQUARES][0][use])
            rest_deg2[use], fitted = parts[1], fitted + rank
    sets = int(np.isfinite(across_deg).sum())
    if sets - fitted < _LEAST:
        return apparent
    noise_deg2 = float(np.nansum(across_deg**2)) / (sets - fitted)
    ratio = float(np.nanmean(rest_deg2)) / noise_deg2 if noise_deg2 > 0.0 else 0.0
    solution.unsteady = f_tail(ratio, 3 * sets, sets - fitted) < _FALSE_ALARM
    if not solution.unsteady:
        return apparent
    each_deg = np.where(np.isfinite(across_deg), math.sqrt(noise_deg2), math.nan)
    return apparent | {LEAST_SQUARES: (apparent[LEAST_SQUARES][0], each_deg, 1.0 - fitted / sets)}


def _without_twice(part_deg: Floats, heading_deg: Floats) -> tuple[Floats, int]:
    """Return a part of each set without what goes with twice the heading, and how many parameters that has."""
    twice = 2.0 * np.deg2rad(heading_deg)
    columns = np.column_stack((np.cos(twice), np.sin(twice)))
    values, _, rank, _ = np.linalg.lstsq(columns, part_deg, rcond=1e-6)
    return part_deg - columns @ values, int(rank)


def _azimuths(solution: Solution, method: str, at_deg: Floats, std_deg: Floats, dof: float) -> Azimuths:
    """Noise is pooled over all sets: eight samples of one set have few degrees of freedom."""
    azimuth_deg = wrapped_deg(at_deg + solution.tilt_deg)
    seen = std_deg[np.isfinite(std_deg)]
    noise_deg = rms(seen) if seen.size else math.nan
    dof *= max(1, seen.size)
    common = [
        (index.std_deg(method), index.dof, index.variance_over_noise(method))
        for index in solution.calibrations.values()
        if method != LIKELIHOOD
    ]
    if method == LEAST_SQUARES and solution.unsteady:  # the mean placement is as uncertain as a mean of so many sets
        common = [(noise_deg * math.sqrt(share), dof, share) for _, _, share in common]
    return Azimuths(azimuth_deg, noise_deg, dof, *max(common, default=(0.0, math.inf, 0.0)))


def _widened(solution: Solution, method: str) -> Azimuths:
    """Take the errors at the known azimuths where they say that a method goes wrong by more than noise.

    A branch of the printed formulas is wrong at every repeat of a heading, and gains that were calibrated while the
    amplitude changed turn all repeats alike; what the quadrants make of such an amplitude is new in every set.
    Source: F test of the mean square error against noise and calibration.
    """
    azimuths, error_deg = solution.by_method[method], solution.error_deg(method)
    count = int(np.isfinite(error_deg).sum())
    due_deg2 = azimuths.noise_deg**2 + azimuths.common_deg**2
    if count < _LEAST or not due_deg2 > 0.0:
        return azimuths
    square_deg2 = solution.rms_deg(method) ** 2
    if f_tail(square_deg2 / due_deg2, count, azimuths.dof) > _FALSE_ALARM:
        return azimuths
    if method == QUADRANT:
        noise_deg = math.sqrt(square_deg2 - azimuths.common_deg**2)
        return replace(azimuths, noise_deg=noise_deg, dof=float(count), calibration=0.0)
    common_deg = math.sqrt(square_deg2 - azimuths.noise_deg**2)
    return replace(azimuths, common_deg=common_deg, common_dof=float(count), calibration=0.0)


def _missing(solution: Solution) -> list[str]:
    """One sentence for each set that cannot be used and for each part of the campaign without any."""
    missing = [
        say("missing.set", name=north_set.name, faults=say.listed(north_set.faults))
        for north_set in solution.sets
        if north_set.faults
    ]
    missing += [
        say("missing.waveform", name=north_set.name, faults=say.listed(north_set.raw_faults))
        for north_set in solution.sets
        if north_set.raw_faults
    ]
    counts = Counter(north_set.item for north_set, good in zip(solution.sets, solution.good, strict=True) if good)
    if not counts[CALIBRATION] and solution.good.any():
        missing.append(say("missing.calibration"))
    if not any(np.isfinite(solution.error_deg(method)).any() for method in METHODS):
        missing.append(say("missing.test"))
    return missing
