"""Estimates of a north finder before its first hour: its own estimators at the planned headings, with declared noise.

A nominal gyroscope turns steadily on a table whose pulses are where they should be; what its samples and the outputs of
the lock-ins scatter is declared, and stands where an analysis takes what the fit leaves over.

What the data cannot show (assumptions) is whatever turns the signal as another azimuth would. Its sizes are those of
one standard uncertainty of noise where the noise decides, and said as such. Source: FOG paper, equations (1) to (14).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench.analysis import Bound, Document, Material, Planned, Prediction
from bench.model.clock import NS
from bench.model.quantities import Quality
from bench.model.systems import Assumption, assumed
from bench.record import RecordRow
from bench.systems.north.analysis import azimuth_error_limit_deg, north_estimates
from bench.systems.north.estimators.formulas import lock_in_noise
from bench.systems.north.estimators.likelihood import LikelihoodNorth, likelihood_north
from bench.systems.north.estimators.phasors import POSITIONS, oriented, phase_deg
from bench.systems.north.sets import COSINE, MEASURE, SEARCH, SINE, VARYING, NorthSet, north_sets
from bench.systems.north.solution import (
    LEAST_SQUARES,
    LIKELIHOOD,
    METHODS,
    QUADRANT,
    Site,
    Solution,
    expected_accuracies,
)
from bench.systems.north.solve import HARMONICS, site_of, solved
from bench.systems.north.wording import method_name, say

EARTH_DEG_H = 15.041  # rate of the Earth's rotation
_AZIMUTHS = ("azimuth", "azimuth_error", "azimuth_rms_error")


def assumptions(campaign: Mapping[str, Any]) -> list[Assumption]:
    """Return what a campaign takes for granted, by its section "campaign"."""
    site = campaign.get("site") or {}
    latitude_deg = float(site.get("latitude_deg", 0.0))
    mark_deg = float(site.get("azimuth_std_deg", 0.0))
    return [
        assumed(
            say,
            "magnetic_effect",
            (*_AZIMUTHS, "index_placement", "scale"),
            rate=0.01 * _horizontal_deg_h(latitude_deg),
        ),
        *_poses(latitude_deg, mark_deg, float(site.get("tilt_std_deg", 0.0))),
        assumed(say, "zero_of_table", (*_AZIMUTHS, "index_placement")),
        assumed(say, "dividing_head", (*_AZIMUTHS, "index_placement", "scale")),
        assumed(say, "delay_of_lock_ins", _AZIMUTHS),
        assumed(say, "scale_factor", ("scale",), rate=_horizontal_deg_h(latitude_deg)),
    ]


def _horizontal_deg_h(latitude_deg: float) -> float:
    return EARTH_DEG_H * math.cos(math.radians(latitude_deg))


def _poses(latitude_deg: float, mark_deg: float, tilt_deg: float) -> list[Assumption]:
    tangent = abs(math.tan(math.radians(latitude_deg)))
    stated = say("stated.angle", angle=mark_deg) if mark_deg else say("stated.not")
    change_deg = math.degrees(1e-3 * math.radians(1.0)) * (1.0 + tangent**2)
    return [
        assumed(say, "azimuth_of_mark", (*_AZIMUTHS, "index_placement"), stated=stated),
        assumed(
            say,
            "latitude",
            _AZIMUTHS,
            latitude=latitude_deg,
            turn=math.degrees(1e-3 * tangent),
            change=change_deg,
        ),
        assumed(
            say,
            "axis_of_table",
            _AZIMUTHS,
            taken="taken" if tilt_deg else "taken_unstated",
            tilt=tilt_deg,
            turn=math.degrees(1e-4 * tangent),
        ),
    ]


_S_PER_H = 3600.0
_DB_PER_POLE = 6
_CONFIGURE = "configure"
_LOCK_INS = (SINE, COSINE)
_OF_CONSTANT = ("azimuth_rms_error", "time_to_accuracy")  # what an amplitude that varies changes
_NOTHING = {"x_V": 0.0, "x_mrad": 0.0, "y_mrad": 0.0}  # a level axis


@dataclass(frozen=True)
class _Nominal:
    """A gyroscope as declared: amplitude of the earth signal (V), noise of one sample (V), samples per second."""

    amplitude_V: float
    noise_V: float
    rate_Hz: float
    swing_deg: float


def predicted(planned: Planned) -> Prediction:
    """Return estimates with the uncertainties that a campaign will give; the values are those of a nominal gyroscope.

    Raises: FitError B-FOG-001 to -004 as ``analysis.analyse``.
    """
    site, limit_deg = site_of(planned.campaign), azimuth_error_limit_deg(planned.campaign)
    sets = _sets(planned)
    if "fog" not in planned.campaign:
        return Prediction([], [say("predicted.no_noise")])
    nominal = _nominal(planned, site)
    if not all(_configured(planned, role) is not None for role in _LOCK_INS):
        return Prediction([], [say("predicted.no_time_constant")])
    turning = [north_set for north_set in sets if abs(north_set.rate_deg_s) > 0.0]
    if not turning:
        return Prediction([], [say("fault.no_rate")])
    for north_set in sets:
        _fill(north_set, nominal, site)
    noise_V = max(_output_noise_V(planned, nominal, role, turning[0]) for role in _LOCK_INS)
    solution = solved(sets, site, _waveforms(sets, nominal, site), nominal.swing_deg, noise_V)
    expected = expected_accuracies(solution, limit_deg)
    varying = VARYING in solution.kinds
    estimates = [
        entry
        for entry in north_estimates(solution, METHODS[0], expected, limit_deg)
        if not (varying and (entry.quantity in _OF_CONSTANT or entry.conditions.get("source") == "waveform"))
    ]
    left = [method for method in METHODS if method not in {each.method for each in expected}]
    missing = [*solution.missing, *(say("predicted.branch", method=method_name(method)) for method in left)]
    missing += [say("predicted.varying")] if varying else []
    return Prediction(estimates, missing, bounds=_bounds(solution))


def _sets(planned: Planned) -> list[NorthSet]:
    """Return the sets that the plan will take; what their readings will be is not in them yet."""
    rows = [RecordRow(window, {}, window.frames, 0, 0, Quality.GOOD) for window in planned.windows]
    read = [replace(reading, value=_NOTHING) for reading in planned.readings if reading.name == MEASURE]
    return north_sets(Material(rows, planned.campaign, planned.standards, readings=read))


def _nominal(planned: Planned, site: Site) -> _Nominal:
    fog = planned.campaign["fog"]
    rate_Hz = float(planned.campaign["rate_Hz"])
    scale_V = float(fog["output_V_per_deg_h"])
    noise_deg_s = float(fog["angle_walk_deg_rth"]) / _S_PER_H**0.5 * rate_Hz**0.5
    amplitude_V = scale_V * EARTH_DEG_H * math.cos(math.radians(site.latitude_deg))
    return _Nominal(amplitude_V, scale_V * noise_deg_s * _S_PER_H, rate_Hz, float(fog["table_swing_deg"]))


def _configured(planned: Planned, role: str) -> Document | None:
    """Return the settings that a lock-in has last, None if the plan sets none."""
    settings = [each.arguments for each in planned.readings if (each.role, each.name) == (role, _CONFIGURE)]
    return settings[-1] if settings else None


def _output_noise_V(planned: Planned, nominal: _Nominal, role: str, north_set: NorthSet) -> float:
    """Return the standard deviation of one output that the noise of the gyroscope leaves, volt RMS."""
    settings = _configured(planned, role) or {}
    turn_s = 360.0 / abs(north_set.rate_deg_s)
    mean_s = turn_s if settings.get("synchronous") == "on" else 0.0
    poles = int(settings["slope"]) // _DB_PER_POLE
    return lock_in_noise(nominal.noise_V, nominal.rate_Hz, float(settings["time_constant"]), poles, mean_s)


def _heading_deg(north_set: NorthSet, site: Site) -> float:
    """Return the stated azimuth; that of the mark for a place to be found, which any azimuth would do for."""
    return site.azimuth_deg + (0.0 if north_set.item == SEARCH else north_set.head_deg)


def _fill(north_set: NorthSet, nominal: _Nominal, site: Site) -> None:
    """Put in what the lock-ins of a nominal bench read; a position without a reading stays a fault of the set."""
    phi = np.deg2rad(float(phase_deg(_heading_deg(north_set, site), north_set.sense)) + 90.0 * np.arange(POSITIONS))
    rms_V = nominal.amplitude_V / math.sqrt(2.0)
    turned = oriented(rms_V * np.sin(phi), rms_V * np.cos(phi), north_set.sense)
    north_set.u1_V, north_set.u2_V = (
        np.where(np.isfinite(read_V), nominal_V, math.nan)
        for read_V, nominal_V in zip((north_set.u1_V, north_set.u2_V), turned, strict=True)
    )
    if len(north_set.rows) == POSITIONS:
        north_set.raw_faults.clear()


def _waveforms(sets: Sequence[NorthSet], nominal: _Nominal, site: Site) -> list[LikelihoodNorth | None]:
    """Return the fits of the waveforms that sets will have; those of one length and rate share their angles."""
    alike: dict[tuple[float, float], list[int]] = {}
    for k, north_set in enumerate(sets):
        if not north_set.raw_faults:
            alike.setdefault((_seconds(north_set), north_set.rate_deg_s), []).append(k)
    fits: list[LikelihoodNorth | None] = [None] * len(sets)
    for (seconds, rate_deg_s), members in alike.items():
        theta_deg = rate_deg_s * (np.arange(round(seconds * nominal.rate_Hz)) + 0.5) / nominal.rate_Hz
        for k in members:
            u_V = nominal.amplitude_V * np.cos(np.deg2rad(_heading_deg(sets[k], site) - theta_deg))
            fits[k] = likelihood_north(u_V, theta_deg, harmonics=HARMONICS, noise_V=nominal.noise_V)
    return fits


def _seconds(north_set: NorthSet) -> float:
    return sum((row.window.t_end_ns - row.window.t_start_ns) / NS for row in north_set.rows.values())


def _bounds(solution: Solution) -> list[Bound]:
    """Return the Cramer-Rao bound of a set beside the noise of a set by each method that is on no wrong branch."""
    bound_deg = float(np.sqrt(np.nanmean(solution.bound_deg**2)))
    return [
        Bound("azimuth", "deg", {"method": method}, bound_deg, solution.by_method[method].noise_deg / bound_deg)
        for method in (LEAST_SQUARES, LIKELIHOOD, QUADRANT)
        if math.isfinite(bound_deg)
    ]
