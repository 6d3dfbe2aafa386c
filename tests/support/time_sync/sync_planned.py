"""Many flights of a planned motion at once, one a lane: an offset of its own each, errors of both units as declared.

The path and the increments are the simulator's; the errors of the EGI wander by a recursion of their own.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sync_flights import LaneEgi

from bench.analysis import Planned
from bench.systems.time_sync.estimators.kalman.filter import run_filter
from bench.systems.time_sync.estimators.kalman.setup import LOOSE, TIGHT, EgiSpread, FilterSetup, ImuSamples
from bench.systems.time_sync.limits import latency_of
from bench.systems.time_sync.records import Recording, Stream, clocks_of
from sim_instruments.worlds.time_sync.flight.imu import imu_runs
from sim_instruments.worlds.time_sync.flight.path import FlightPath

Array = NDArray[np.float64]
STATED = "stated uncertainty of receive_jitter"
GROUPS = {"augmented_loose": 0, "augmented_tight": 1}
OFFSET_STD_s, EGI_s, REACH_s = 0.03, 0.02, 0.2
NEAR_s, COARSE_s, TAG_NOISE_s = 0.05, 0.01, 1e-5
_MICRO_G, _DEG_H = 9.80665e-6, np.radians(1.0) / 3600.0


def wandering_egi(path: FlightPath, end_s: float, spread: EgiSpread, offsets_s: Array, rng: Any) -> LaneEgi:
    """Solutions whose errors wander, for both groups."""
    t_s, runs = np.arange(REACH_s, end_s - REACH_s, EGI_s), offsets_s.size
    sizes = np.array([spread.position_m] * 3 + [spread.velocity_m_s] * 3
                     + [*np.radians([spread.level_deg, spread.level_deg, spread.heading_deg])])  # fmt: skip
    kept = np.exp(-EGI_s / np.array([spread.wander_s] * 6 + [np.inf, np.inf, spread.heading_wander_s]))
    errors = rng.standard_normal((t_s.size, runs, 9))
    for k in range(1, t_s.size):
        errors[k] = kept * errors[k - 1] + np.sqrt(1.0 - kept**2) * errors[k]
    return LaneEgi(path, t_s, errors * sizes, offsets_s, len(GROUPS))


def brought_near(offsets_s: Array) -> Array:
    """Return what a filter has to find: of more than 50 ms whole steps of 10 ms are taken out beforehand (docs)."""
    return np.where(np.abs(offsets_s) > NEAR_s, offsets_s - COARSE_s * np.round(offsets_s / COARSE_s), offsets_s)


def errors_of_flights(planned: Planned, path: FlightPath, end_s: float, runs: int, seed: int) -> dict[Any, Array]:
    """Return estimate minus truth, (R,), in the units of the estimates, by quantity, method and axis."""
    rng = np.random.default_rng(seed)
    egi = planned.campaign["egi"]
    spread = EgiSpread(**egi)
    offsets_s = brought_near(rng.normal(0.0, OFFSET_STD_s, runs))
    unit = imu_runs(path, end_s, runs, seed)
    samples = ImuSamples(unit.t_s, unit.dv, unit.dtheta, np.zeros(unit.t_s.size, bool))
    setup = FilterSetup((True, True), (LOOSE, TIGHT), offset_sigma_s=OFFSET_STD_s, keep_every=50)
    run = run_filter(samples, wandering_egi(path, end_s, spread, offsets_s, rng), setup)
    found: dict[Any, Array] = {
        ("time_offset", method, None): run.offset_s[-1, group] - offsets_s for method, group in GROUPS.items()
    }
    for axis, letter in enumerate("xyz"):
        accel = run.accel_bias[-1, 0, :, axis] - unit.accel_bias[:, axis]
        gyro = run.gyro_bias[-1, 0, :, axis] - unit.gyro_bias[:, axis]
        found["accel_bias", "augmented_loose", letter] = accel / _MICRO_G
        found["gyro_bias", "augmented_loose", letter] = gyro / _DEG_H
    return found


def errors_of_stamps(planned: Planned, span_s: float, runs: int, seed: int) -> dict[Any, Array]:
    """Return estimate minus truth, (R,), of clocks by receive stamps of many pairs of units, by quantity and link.

    Stamps are drawn as the sequence declares them; what the makers state of a latency is off by its uncertainty. Beside
    them what is stated of each jitter.
    """
    stamps, latency = planned.campaign["stamps"], latency_of(planned.campaign)
    assert latency is not None
    rng, found = np.random.default_rng(seed), dict[Any, list[float]]()
    for _ in range(runs):
        rates = dict(zip(("imu", "egi"), stamps["clock"] * rng.uniform(-1.0, 1.0, 2), strict=True))
        offset_s, begin_s = float(rng.uniform(-OFFSET_STD_s, OFFSET_STD_s)), 100.0 + rng.uniform()
        streams = {}
        for link, least_s in (("imu", latency.imu_s), ("egi", latency.egi_s)):
            late_s = least_s + latency.std_s * rng.standard_normal()
            streams[link] = _stream(planned, link, span_s, begin_s + late_s, rates[link], rng)
        tags_s = streams["egi"].tick_s + offset_s
        pair = Recording(streams["imu"], replace(streams["egi"], tick_s=tags_s), None, "", ())
        clocks = clocks_of(pair, 0.5 * span_s, latency, {})
        apart_s = offset_s + 0.5 * span_s * (rates["egi"] - rates["imu"])  # both count from the begin
        errors = {
            ("time_offset_drift", None): 1e6 * (clocks.difference.drift - (rates["egi"] - rates["imu"])),
            ("time_offset_from_stamps", None): (clocks.offset_s or 0.0) - apart_s,
        }
        for link, port in (("imu", clocks.imu), ("egi", clocks.egi)):
            errors["clock_rate", link] = -1e6 * port.rate - 1e6 * rates[link]
            errors["receive_jitter", link] = port.jitter_s - stamps["jitter_s"]
            errors[STATED, link] = port.jitter_std_s
        for own, error in errors.items():
            found.setdefault(own, []).append(error)
    return {own: np.array(values) for own, values in found.items()}


def _stream(planned: Planned, link: str, span_s: float, first_s: float, rate: float, rng: Any) -> Stream:
    """Tags of a clock that is fast by ``rate`` and stamps of its frames, of which the first may come at ``first_s``."""
    stamps, step_s = planned.campaign["stamps"], planned.steps_s[link]
    own_s = np.arange(0.0, span_s, 1.0 / planned.rates_Hz[link])
    arrived_s = first_s + own_s / (1.0 + rate) + rng.exponential(stamps["jitter_s"], own_s.size)
    received_ns = np.rint(1e9 * np.ceil(arrived_s / step_s) * step_s).astype(np.int64)
    tags_s = own_s + TAG_NOISE_s * rng.standard_normal(own_s.size)
    return Stream(tags_s, np.arange(own_s.size), received_ns, {})
