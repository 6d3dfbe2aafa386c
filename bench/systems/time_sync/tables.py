"""Tables of a time offset: result, filters, clocks of both ports, consistency, biases, image, what was received."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from bench.analysis import Table, decimals_for, number, significant, with_uncertainty
from bench.maths.verdict import coverage_factor
from bench.systems.time_sync.estimates import SyncResult
from bench.systems.time_sync.estimators.kalman.setup import LOOSE, NIS_BLOCKS, TIGHT, STANDARD_GRAVITY_m_s2
from bench.systems.time_sync.filtering import COMPENSATED, GROUPS, METHODS, NONE, ratio_of
from bench.systems.time_sync.image import Image
from bench.systems.time_sync.wording import filter_name, headers_of, manoeuvre_name, say

_MS = 1e3


def tables(result: SyncResult) -> list[Table]:
    """Return all, the result in front."""
    first = [_result(result), _filters(result), _clocks(result), _consistency(result), _biases(result)]
    return [*first, *([_image(result.image, result)] if result.image else []), _received(result)]


def _result(result: SyncResult) -> Table:
    """Return what is read first."""
    factor = coverage_factor()
    rows: list[list[Any]] = []
    for name in METHODS:
        offset = result.found.offsets[name]
        told = with_uncertainty(_MS * offset.offset_s, _MS * factor * offset.std_s) if offset.seen else say("unseen")
        rows.append([say("result.filter", name=filter_name(name)), told, _role(result, name)])
    clocks = result.clocks
    if clocks.offset_s is None:
        rows.append([say("result.stamps"), say("result.no_latencies"), "–"])
    else:
        stamps = with_uncertainty(_MS * clocks.offset_s, factor * _MS * clocks.difference.std_s)
        rows.append([say("result.stamps_and_latencies"), stamps, say("role.independent")])
    if result.difference_s is not None:
        apart_s, std_s = result.difference_s
        apart = with_uncertainty(_MS * apart_s, factor * _MS * std_s)
        rows.append([say("result.filter_minus_stamps"), apart, say("role.judged")])
    limits = {"interval": _MS * result.demands.uncertainty_s, "difference": _MS * result.demands.difference_s}
    caption = say("result.caption" if result.chosen.seen else "result.caption_unseen", **limits)
    return Table(say("result.title"), caption, headers_of("result", "by", "offset", "role"), rows, lead=True)


def _role(result: SyncResult, name: str) -> str:
    """Return what the offset by a filter is for; one that the motion did not show is no value that could be judged."""
    if name != result.method:
        return "–"
    if result.chosen.seen:
        return say("role.judged")
    return say("role.not_judged" if result.interval_limit_s is None else "role.interval")


def _filters(result: SyncResult) -> Table:
    rows: list[list[Any]] = []
    for name in METHODS:
        offset, group = result.found.offsets[name], GROUPS.index(name)
        rows.append([
            filter_name(name), _part(offset.filter_std_s), _part(offset.error_std_s), number(offset.inflation, 2),
            _part(offset.prior_std_s), _part(offset.drift_std_s), _part(offset.std_s), significant(offset.normalised),
            significant(float(result.seen.associated[-1, group])), say("yes" if offset.seen else "no"),
        ])  # fmt: skip
    headers = headers_of(
        "filters", "filter", "believed", "stated", "nis", "beforehand", "drift", "all", "variance", "eigenvalue",
        "observable",
    )  # fmt: skip
    caption = say("filters.caption", loose=_noise(LOOSE), tight=_noise(TIGHT))
    return Table(say("filters.title"), caption, headers, rows)


def _part(std_s: float) -> str:
    """Return a part of an uncertainty in milliseconds, one digit more than of a result, so that sums can be checked."""
    return number(_MS * std_s, decimals_for(_MS * std_s) + 1)


def _noise(sigma: tuple[float, float, float]) -> str:
    return f"{sigma[0]:g} m, {sigma[1]:g} m/s, {sigma[2]:g} deg"


def _clocks(result: SyncResult) -> Table:
    clocks, factor = result.clocks, coverage_factor()
    rows: list[list[Any]] = [
        [
            name, port.above_s.size, with_uncertainty(-1e6 * port.rate, factor * 1e6 * port.rate_std),
            number(_MS * port.jitter_s, 3), number(1e6 * port.tag_noise_s, 1), number(_MS * port.grid_s, 3),
        ]
        for name, port in ((say("imu"), clocks.imu), ("EGI", clocks.egi))
    ]  # fmt: skip
    drift = with_uncertainty(1e6 * clocks.difference.drift, factor * 1e6 * clocks.difference.drift_std)
    rows.append([say("clocks.egi_against_imu"), "–", drift, "–", "–", "–"])
    stated = say("clocks.no_latencies")
    if clocks.latency is not None:
        latency = clocks.latency
        stated = say("clocks.latencies", egi=_MS * latency.egi_s, imu=_MS * latency.imu_s, std=_MS * latency.std_s)
    caption = say("clocks.caption", stated=stated, longer=_MS * clocks.line_s)
    headers = headers_of("clocks", "clock", "frames", "rate", "jitter", "noise", "step")
    return Table(say("clocks.title"), caption, headers, rows)


def _consistency(result: SyncResult) -> Table:
    run, rows = result.found.run, []
    for group, name in enumerate(GROUPS):
        ratios = [ratio_of(run, group, block) for block in range(len(NIS_BLOCKS))]
        rows.append([filter_name(name), *(significant(ratio) if math.isfinite(ratio) else "–" for ratio in ratios)])
    headers = headers_of("consistency", "filter", *NIS_BLOCKS)
    return Table(say("consistency.title"), say("consistency.caption"), headers, rows)


def _biases(result: SyncResult) -> Table:
    run, group, factor = result.found.run, GROUPS.index(result.method), coverage_factor()
    std, rows = result.found.bias_std(result.method), list[list[Any]]()
    for axis, letter in enumerate("xyz"):
        accel = 1e6 / STANDARD_GRAVITY_m_s2 * np.array([run.accel_bias[-1, group, 0, axis], std[axis]])
        gyro = math.degrees(3600.0) * np.array([run.gyro_bias[-1, group, 0, axis], std[3 + axis]])
        rows.append([letter, *(with_uncertainty(float(bias[0]), factor * float(bias[1])) for bias in (accel, gyro))])
    caption = say("biases.caption", name=filter_name(result.method))
    return Table(say("biases.title"), caption, headers_of("biases", "axis", "accelerometer", "gyro"), rows)


def _image(image: Image, result: SyncResult) -> Table:
    rows: list[list[Any]] = []
    for target, (compensated, plain) in enumerate(zip(image.compensated, image.plain, strict=True), 1):
        for name, response, shift in (
            (filter_name(COMPENSATED), compensated, "–"),
            (filter_name(NONE), plain, number(float(image.shifts_m[target - 1]), 3)),
        ):  # fmt: skip
            rows.append([
                target, name, shift, number(response.azimuth_resolution_m, 4), number(response.pslr_dB, 2),
                number(response.islr_dB, 2), number(response.peak / compensated.peak, 3),
            ])  # fmt: skip
    left_s = result.found.offsets[COMPENSATED].offset_s - result.found.shift_s  # the rest is out of the tags of both
    due_m = -image.speed_m_s * left_s
    caption = say("image.caption", pulses=image.pulses, due=due_m, speed=image.speed_m_s, left=_MS * left_s)
    headers = headers_of("image", "target", "navigation", "shift", "resolution", "pslr", "islr", "peak")
    return Table(say("image.title"), caption, headers, rows)


def _received(result: SyncResult) -> Table:
    ready = result.ready
    rows: list[list[Any]] = [
        [say("received.span"), number(ready.span_s, 3)],
        [say("received.samples"), int(ready.imu.t_s.size)],
        [say("received.filled"), ready.filled],
        [say("received.solutions"), result.found.samples],
        [say("received.lost"), ready.lost_egi],
        [say("received.unsound"), ready.unsound_egi],
        [say("received.odd_solutions"), ready.odd_egi],
        [say("received.odd_samples"), ready.odd_imu],
    ]
    caption = say("received.caption", name=manoeuvre_name(result.manoeuvre))
    return Table(say("received.title"), caption, headers_of("received", "what", "number"), rows)
