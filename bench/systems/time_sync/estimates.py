"""Estimates of a time offset for results.json: by every filter, by the receive stamps, their difference, the image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.analysis import Estimates, estimate
from bench.maths.verdict import coverage_factor
from bench.systems.time_sync.estimators.kalman.innovation import Observability
from bench.systems.time_sync.estimators.kalman.setup import NIS_BLOCKS, STANDARD_GRAVITY_m_s2
from bench.systems.time_sync.filtering import COMPENSATED, GROUPS, METHODS, NONE, Filtered, Offset, ratio_of
from bench.systems.time_sync.image import Image
from bench.systems.time_sync.limits import DIFFERENCE, UNCERTAINTY, Demands
from bench.systems.time_sync.records import Clocks
from bench.systems.time_sync.samples import Prepared

_LEAST_SHIFT_STD_m = 1e-3  # of an image's place, whatever the scatter between targets


@dataclass(frozen=True)
class SyncResult:
    """Everything an analysis of a recording found; ``image`` is None without a radar."""

    manoeuvre: str
    ready: Prepared
    clocks: Clocks
    found: Filtered
    seen: Observability
    image: Image | None
    demands: Demands
    method: str

    @property
    def chosen(self) -> Offset:
        """Offset by the method that is judged."""
        return self.found.offsets[self.method]

    @property
    def interval_limit_s(self) -> float | None:
        """Limit that the interval of the chosen method is held against.

        An interval of what was assumed, where the motion did not show the offset, can miss a limit and cannot keep one:
        None if it is within.
        """
        limit_s = self.demands.uncertainty_s
        missed = coverage_factor() * self.chosen.std_s > limit_s
        return limit_s if self.chosen.seen or missed else None

    @property
    def difference_s(self) -> tuple[float, float] | None:
        """Offset by the filter minus that by the stamps, and its standard uncertainty.

        None without latencies, and where the motion did not show the offset: there is one opinion only.
        """
        if self.clocks.offset_s is None or not self.chosen.seen:
            return None
        return self.chosen.offset_s - self.clocks.offset_s, math.hypot(self.chosen.std_s, self.clocks.difference.std_s)


def sync_estimates(result: SyncResult) -> Estimates:
    """Return all of them; judged are the interval of the chosen method and its agreement with the stamps."""
    estimates: Estimates = []
    for name in METHODS:
        estimates += _offset(result, name)
    estimates += _stamps(result) + _clocks(result.clocks)
    for name in GROUPS:
        estimates += _consistency(result, name)
    return estimates + _biases(result) + _image(result)


def _epoch_s(at_s: float) -> float:
    """Epoch as a condition: the same for every recording of one sequence, or no two calibrations would compare."""
    return round(at_s, 1)


def _offset(result: SyncResult, name: str) -> Estimates:
    offset, ready = result.found.offsets[name], result.ready
    place: dict[str, Any] = {"method": name, "at_s": _epoch_s(result.found.at_s), "observable": offset.seen}
    counted = {"n": result.found.samples, "dropped": ready.lost_egi + ready.unsound_egi + ready.odd_egi}
    interval_s = coverage_factor() * offset.std_s
    judged = result.interval_limit_s if name == result.method else None
    last = result.seen.associated[-1, GROUPS.index(name)]
    about = {"method": name}
    return [
        estimate("time_offset", "s", offset.offset_s, offset.std_s, place, **counted),
        estimate(UNCERTAINTY, "s", interval_s, 0.0, about, limit=judged, **counted),
        estimate("observability", "1", offset.normalised, 0.0, about | {"of": "variance of the offset"}, **counted),
        estimate("observability", "1", float(last), 0.0, about | {"of": "associated eigenvalue"}, **counted),
    ]


def _stamps(result: SyncResult) -> Estimates:
    clocks, n = result.clocks, result.clocks.egi_s.size
    difference, at = clocks.difference, {"at_s": _epoch_s(result.found.at_s)}
    entries = [
        estimate(
            "time_offset_drift", "ppm", 1e6 * difference.drift, 1e6 * difference.drift_std, {"method": "stamps"}, n=n
        )
    ]
    if clocks.offset_s is not None:
        entries.append(estimate("time_offset_from_stamps", "s", clocks.offset_s, difference.std_s, at, n=n))
    if result.difference_s is not None:
        apart_s, std_s = result.difference_s
        about, limit_s = {"method": result.method}, result.demands.difference_s
        entries.append(estimate(DIFFERENCE, "s", apart_s, std_s, about, n=n, limit=limit_s))
    return entries


def _clocks(clocks: Clocks) -> Estimates:
    entries: Estimates = []
    for name, port in (("imu", clocks.imu), ("egi", clocks.egi)):
        about, n = {"link": name}, port.above_s.size
        entries.append(estimate("clock_rate", "ppm", -1e6 * port.rate, 1e6 * port.rate_std, about, n=n))
        entries.append(estimate("receive_jitter", "s", port.jitter_s, port.jitter_std_s, about, n=n))
    return entries


def _consistency(result: SyncResult, name: str) -> Estimates:
    run, group = result.found.run, GROUPS.index(name)
    entries = []
    for block, label in enumerate(NIS_BLOCKS):
        value = ratio_of(run, group, block)
        if math.isfinite(value):
            n = int(run.nis_count[:, group, block].sum())
            entries.append(estimate("nis", "1", value, 0.0, {"method": name, "of": label}, n=n))
    return entries


def _biases(result: SyncResult) -> Estimates:
    """Of the chosen filter at the end, in micro-g and degrees per hour."""
    run, group, std = result.found.run, GROUPS.index(result.method), result.found.bias_std(result.method)
    micro_g, deg_h = 1e6 / STANDARD_GRAVITY_m_s2, math.degrees(3600.0)
    entries: Estimates = []
    for quantity, kind, unit, scale, values, first in (
        ("accel_bias", "accelerometer", "ug", micro_g, run.accel_bias, 0),
        ("gyro_bias", "gyro", "deg/h", deg_h, run.gyro_bias, 3),
    ):
        for axis, letter in enumerate("xyz"):
            value = float(values[-1, group, 0, axis])
            place = {"axis": letter, "kind": kind, "method": result.method}
            both = scale * value, scale * float(std[first + axis])
            entries.append(estimate(quantity, unit, *both, place, n=result.found.samples))
    return entries


def _image(result: SyncResult) -> Estimates:
    image = result.image
    if image is None:
        return []
    shifts_m, n = image.shifts_m, len(image.plain)
    std_m = float(np.std(shifts_m, ddof=1)) / math.sqrt(n) if n > 1 else 0.0
    place: dict[str, Any] = {"of": f"{NONE} against {COMPENSATED}"}
    entries = [estimate("image_shift", "m", float(shifts_m.mean()), max(std_m, _LEAST_SHIFT_STD_m), place, n=n)]
    for name, responses in ((COMPENSATED, image.compensated), (NONE, image.plain)):
        about = {"navigation": name}
        for quantity, unit, values in (
            ("resolution", "m", [response.azimuth.resolution_m for response in responses]),
            ("pslr", "dB", [response.azimuth.pslr_dB for response in responses]),
            ("islr", "dB", [response.azimuth.islr_dB for response in responses]),
            (
                "image_peak",
                "1",
                [response.peak / other.peak for response, other in zip(responses, image.compensated, strict=True)],
            ),
        ):
            spread = float(np.std(values, ddof=1)) / math.sqrt(n) if n > 1 else 0.0
            entries.append(estimate(quantity, unit, float(np.mean(values)), spread, about, n=n))
    return entries
