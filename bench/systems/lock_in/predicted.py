"""What records of a ring laser will know of its random walk, by the laser and the dither that are declared.

The Allan deviation of a walk and a quantisation of the expected sizes goes through the fit of a record. Before
compensation the walk is that of lock-in and of quantum noise, behind the global fit that of quantum noise alone, which
holds for the lock-in of equation (10). What other compensators leave depends on phase, comparators and clock.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from bench.analysis import Material, Planned, Prediction
from bench.model.clock import NS
from bench.model.errors import FitError
from bench.model.quality import Quality
from bench.record import RecordRow
from bench.systems.lock_in.compensation import GLOBAL, RAW, Compensated, Shown
from bench.systems.lock_in.estimates import exponent_estimates, record_estimates, requirement_of
from bench.systems.lock_in.estimators.random_walk import (
    expected_quantisation_deg,
    expected_random_walk,
    expected_walk,
    gyro_gain,
)
from bench.systems.lock_in.records import CLOCK, Events, LaserRecord, laser_records, not_recorded
from bench.systems.lock_in.result import LaserResult
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
            next_step="declare 'laser' in the section 'uut' (docs/ring-laser.md)",
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
    return Prediction([*estimates, *exponent_estimates(results, GLOBAL)], [*missing, say("predicted.not_of_all")])


def _result(record: LaserRecord, declared: Mapping[str, Any]) -> LaserResult:
    """Return what a record will say of its walks. Raises: FitError B-FIT-099 for a record that is too short."""
    assert record.row is not None
    window, path_m = record.row.window, record.path_length_m
    clock_Hz, dither_deg_s = float(window.conditions[CLOCK]), float(declared["dither_deg_s"])
    shorter, interval_s = (float(declared["path_length_m"]) / path_m) ** 2, 1.0 / float(declared["dither_Hz"])
    periods = int((window.t_end_ns - window.t_start_ns) / NS / interval_s)
    quantum = 60.0 * float(declared["quantum_deg_rt_s"]) * shorter
    lock_in = expected_random_walk(float(declared["lock_in_deg_s"]) * shorter, dither_deg_s, path_m)
    q_deg = expected_quantisation_deg(dither_deg_s, 1.0 / clock_Hz, float(declared["pick_off_s"]))
    walks = {
        RAW: expected_walk(math.hypot(lock_in, quantum), q_deg, periods, interval_s),
        GLOBAL: expected_walk(quantum, q_deg, periods, interval_s),
    }
    omega = 2.0 * math.pi / interval_s
    found = Compensated(
        interval_s=interval_s,
        omega_rad_s=omega,
        increments={},
        shown=Shown(np.empty((0, 0)), np.empty((0, 0)), {}, np.empty(0), np.empty(0)),
        turnarounds=2 * periods,
        used={GLOBAL: 2 * periods},
        counts=Counter(),
        swing_rad=2.0 * gyro_gain(path_m) * math.radians(dither_deg_s) / omega,
    )
    return LaserResult(record, clock_Hz, Events(clock_Hz, (), 0, 0, 0), found, walks, {})
