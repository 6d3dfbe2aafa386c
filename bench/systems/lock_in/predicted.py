"""Predicts what records of a ring laser will know of its lock-in and its random walk, by the declared laser and dither.

The Allan deviation of a walk and a quantisation of the expected sizes goes through the fit of a record. Before
compensation the walk is that of lock-in and of quantum noise, behind the global fit that of quantum noise alone, which
holds for the lock-in of equation (10). Behind the other compensators it is what their fits leave at the turnarounds
that the laser makes; this depends on the phase, as does what the global fit knows of lock-in rate and phase. Noise of
the comparators is declared nowhere, and in none of these.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace

import numpy as np

from bench.analysis import Document, Material, Planned, Prediction
from bench.model.clock import NS
from bench.model.errors import FitError
from bench.model.quantities import Quality
from bench.record import RecordRow
from bench.systems.lock_in.compensation import GLOBAL, RAW, SINGLE, Compensated, Shown
from bench.systems.lock_in.estimators.global_constants import NominalLaser, expected_constants, expected_output
from bench.systems.lock_in.estimators.random_walk import (
    expected_quantisation_deg,
    expected_random_walk,
    expected_walk,
    gyro_gain,
    walk_of_phase_deg_rth,
)
from bench.systems.lock_in.records import CLOCK, Events, LaserRecord, laser_records, not_recorded
from bench.systems.lock_in.result import (
    LaserResult,
    exponent_estimates,
    first_order_off,
    record_estimates,
    requirement_of,
)
from bench.systems.lock_in.wording import say


def predicted(planned: Planned) -> Prediction:
    """Return estimates of the declared laser with the uncertainties that the planned records will give.

    Raises:  FitError B-RLG-001 and -006 as ``laser_records``, B-RLG-004 and -005 as ``requirement_of``, B-RLG-010
             without a declared laser.
    """
    requirement, declared = requirement_of(planned.campaign), planned.campaign.get("declared_laser")
    if declared is None:
        raise FitError(
            "B-RLG-010",
            "laser and dither are not declared, so nothing can be predicted",
            where="sequence: uut",
            next_step="declare 'laser' in the section 'uut' (docs/method-ring-laser.md)",
        )
    rows = [RecordRow(window, {}, 0, 0, 0, Quality.GOOD) for window in planned.windows]
    records = laser_records(Material(rows, planned.campaign, planned.standards))
    missing, results = not_recorded(records), []
    for record in records:
        try:
            results.append(_result(record, declared))
        except FitError as error:
            missing.append(say("missing.record", number=record.number, why=error.message, code=error.code))
    estimates = [entry for laser in results for entry in record_estimates(laser, requirement, GLOBAL)]
    if any(not laser.found.constants for laser in results):
        missing += [say("predicted.no_phase"), say("predicted.no_phase_behind")]
    missing.append(say("predicted.comparators"))
    return Prediction([*estimates, *exponent_estimates(results, GLOBAL)], missing)


def _result(record: LaserRecord, declared: Document) -> LaserResult:
    """Return what a record will say. Raises: FitError B-FIT-097 to -099 for a weak dither or a record too short."""
    window, path_m = record.row.window, record.path_length_m
    clock_Hz, dither_deg_s = float(window.conditions[CLOCK]), float(declared["dither_deg_s"])
    shorter, interval_s = (float(declared["path_length_m"]) / path_m) ** 2, 1.0 / float(declared["dither_Hz"])
    periods = int((window.t_end_ns - window.t_start_ns) / NS / interval_s)
    quantum = 60.0 * float(declared["quantum_deg_rt_s"]) * shorter
    lock_in = expected_random_walk(float(declared["lock_in_deg_s"]) * shorter, dither_deg_s, path_m)
    sizes, shared = {RAW: math.hypot(lock_in, quantum), GLOBAL: quantum}, {}
    laser, omega = _nominal(record, declared, clock_Hz), 2.0 * math.pi / interval_s
    outputs = {} if laser is None else {name: expected_output(laser, fit) for name, fit in SINGLE.items()}
    for method, output in outputs.items():
        sizes[method], shared[method] = walk_of_phase_deg_rth(output.walk_rad_rt_s, path_m), output.shared
    q_deg = expected_quantisation_deg(dither_deg_s, 1.0 / clock_Hz, float(declared["pick_off_s"]))
    found = Compensated(
        interval_s=interval_s,
        omega_rad_s=omega,
        increments={},
        shown=Shown(np.empty((0, 0)), np.empty((0, 0)), {}, np.empty(0), np.empty(0)),
        constants=[] if laser is None else [expected_constants(_as_seen(laser), 2 * periods)],
        turnarounds=2 * periods,
        used=dict.fromkeys(sizes, 2 * periods),
        counts=Counter(),
        swing_rad=2.0 * gyro_gain(path_m) * math.radians(dither_deg_s) / omega,
    )
    walks = {method: expected_walk(size, q_deg, periods, interval_s) for method, size in sizes.items()}
    return LaserResult(record, clock_Hz, Events(clock_Hz, (), 0, 0, 0), found, walks, {}, shared=shared)


def _nominal(record: LaserRecord, declared: Document, clock_Hz: float) -> NominalLaser | None:
    """Return the declared laser at the path and the phase of a record; None without a phase."""
    if record.backscatter_deg is None:
        return None
    gain = gyro_gain(record.path_length_m)
    rad = gain * math.radians(1.0) * (float(declared["path_length_m"]) / record.path_length_m) ** 2
    return NominalLaser(
        kappa_rad_s=rad * float(declared["lock_in_deg_s"]),
        beta_rad=math.radians(record.backscatter_deg),
        omega_rad_s=2.0 * math.pi * float(declared["dither_Hz"]),
        rate_rad_s=gain * math.radians(float(declared["dither_deg_s"])),
        walk_rad_rt_s=rad * float(declared["quantum_deg_rt_s"]),
        tick_s=1.0 / clock_Hz,
    )


def _as_seen(laser: NominalLaser) -> NominalLaser:
    """Return the laser that shapes of first order make of one."""
    share, turned_rad = first_order_off(laser.beta_rad, laser.jump_squared)
    return replace(laser, kappa_rad_s=laser.kappa_rad_s * (1.0 + share), beta_rad=laser.beta_rad + turned_rad)
