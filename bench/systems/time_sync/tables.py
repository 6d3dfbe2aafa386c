"""Tables of a time offset: result, filters, clocks of both ports, consistency, biases, image, what was received."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from bench.analysis import Table, number, with_uncertainty
from bench.maths.verdict import coverage_factor
from bench.systems.time_sync.estimates import SyncResult
from bench.systems.time_sync.estimators.kalman.setup import LOOSE, NIS_BLOCKS, TIGHT, STANDARD_GRAVITY_m_s2
from bench.systems.time_sync.filtering import (
    AUGMENTED_LOOSE,
    AUGMENTED_TIGHT,
    COMPENSATED,
    GROUPS,
    METHODS,
    NONE,
    ratio_of,
)
from bench.systems.time_sync.image import Image

LABELS = {AUGMENTED_LOOSE: "augmented, loose", AUGMENTED_TIGHT: "augmented, tight", NONE: "not compensated"}
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
        said = with_uncertainty(_MS * offset.offset_s, _MS * factor * offset.std_s) if offset.seen else "not observable"
        rows.append([f"filter, {LABELS[name]}", said, _role(result, name)])
    clocks = result.clocks
    if clocks.offset_s is None:
        rows.append(["receive stamps", "no latencies stated", "–"])
    else:
        stamps = with_uncertainty(_MS * clocks.offset_s, factor * _MS * clocks.difference.std_s)
        rows.append(["receive stamps and stated latencies", stamps, "independent"])
    if result.difference_s is not None:
        apart_s, std_s = result.difference_s
        rows.append(["filter minus stamps", with_uncertainty(_MS * apart_s, factor * _MS * std_s), "judged"])
    caption = (
        "Clock of the EGI minus clock of the inertial unit in the middle of the recording; positive: the EGI's samples "
        f"are older than their tags say. Intervals of 95 %. Limits: interval {_MS * result.demands.uncertainty_s:g} ms,"
        f" difference {_MS * result.demands.difference_s:g} ms."
    )
    if not result.chosen.seen:
        caption += (
            " Not observable: the motion does not show the offset; its interval is what was assumed beforehand, which "
            "can miss a limit and cannot keep one."
        )
    return Table("Time offset", caption, ["by", "offset, ms", "role"], rows, lead=True)


def _role(result: SyncResult, name: str) -> str:
    """Return what the offset by a filter is for; one that the motion did not show is no value that could be judged."""
    if name != result.method:
        return "–"
    if result.chosen.seen:
        return "judged"
    return "not judged" if result.interval_limit_s is None else "interval alone judged"


def _filters(result: SyncResult) -> Table:
    rows: list[list[Any]] = []
    for name in METHODS:
        offset, group = result.found.offsets[name], GROUPS.index(name)
        rows.append([
            LABELS[name], number(_MS * offset.filter_std_s, 4), number(_MS * offset.error_std_s, 4),
            number(offset.inflation, 2), number(_MS * offset.prior_std_s, 4), number(_MS * offset.drift_std_s, 4),
            number(_MS * offset.std_s, 4), f"{offset.normalised:.2g}",
            f"{float(result.seen.associated[-1, group]):.2g}", "yes" if offset.seen else "no",
        ])  # fmt: skip
    caption = (
        f"Standard uncertainties. Loose: {_noise(LOOSE)} in the measurements, tight: {_noise(TIGHT)}. The filter takes "
        "errors of the EGI for white, which they are not, so what it believes is not the interval: that is made of "
        "what the stated errors of both units leave (widened by NIS where innovations are too large), of what was "
        "assumed beforehand and still counts, and of the drift. Variance: of the offset at the end over that at "
        "first."
    )
    headers = ["filter", "filter believes, ms", "stated errors, ms", "NIS factor", "beforehand, ms", "drift, ms",
               "all, ms", "variance", "eigenvalue", "observable"]  # fmt: skip
    return Table("Uncertainty and observability", caption, headers, rows)


def _noise(sigma: tuple[float, float, float]) -> str:
    return f"{sigma[0]:g} m, {sigma[1]:g} m/s, {sigma[2]:g} deg"


def _clocks(result: SyncResult) -> Table:
    clocks, factor = result.clocks, coverage_factor()
    rows: list[list[Any]] = [
        [
            name, port.above_s.size, with_uncertainty(-1e6 * port.rate, factor * 1e6 * port.rate_std),
            number(_MS * port.jitter_s, 3), number(1e6 * port.tag_noise_s, 1), number(_MS * port.grid_s, 3),
        ]
        for name, port in (("inertial unit", clocks.imu), ("EGI", clocks.egi))
    ]  # fmt: skip
    drift = with_uncertainty(1e6 * clocks.difference.drift, factor * 1e6 * clocks.difference.drift_std)
    rows.append(["EGI against inertial unit", "–", drift, "–", "–", "–"])
    stated = "no latencies are stated"
    if clocks.latency is not None:
        latency = clocks.latency
        stated = (
            f"latencies as stated: EGI {_MS * latency.egi_s:g} ms, inertial unit {_MS * latency.imu_s:g} ms, each with "
            f"a standard uncertainty of {_MS * latency.std_s:g} ms"
        )
    caption = (
        f"Lines of the least delay between time tag and receive stamp; {stated}; frames of the EGI take "
        f"{_MS * clocks.line_s:.3f} ms longer on the line. Jitter: mean delay above the least."
    )
    headers = [
        "clock",
        "frames",
        "rate against the bench, ppm",
        "jitter, ms",
        "noise of tags, us",
        "step of stamps, ms",
    ]
    return Table("Clocks of both ports", caption, headers, rows)


def _consistency(result: SyncResult) -> Table:
    run, rows = result.found.run, []
    for group, name in enumerate(GROUPS):
        ratios = [ratio_of(run, group, block) for block in range(len(NIS_BLOCKS))]
        rows.append([LABELS[name], *(f"{ratio:.2g}" if math.isfinite(ratio) else "–" for ratio in ratios)])
    caption = (
        "Normalised innovations squared over their degrees of freedom: 1 if the noise is as the filter believes, less "
        "if it believes in more noise than there is (which makes it careful), more if in less; then the interval is "
        "widened. Errors of the EGI last for seconds and hardly change from one solution to the next: the loose filter "
        "lies far below 1."
    )
    return Table("Consistency", caption, ["filter", *NIS_BLOCKS], rows)


def _biases(result: SyncResult) -> Table:
    run, group, factor = result.found.run, GROUPS.index(result.method), coverage_factor()
    rows: list[list[Any]] = []
    for axis, letter in enumerate("xyz"):
        accel = (
            1e6 / STANDARD_GRAVITY_m_s2 * np.array([run.accel_bias[-1, group, 0, axis], run.sigma[-1, group, 9 + axis]])
        )
        gyro = math.degrees(3600.0) * np.array([run.gyro_bias[-1, group, 0, axis], run.sigma[-1, group, 12 + axis]])
        rows.append([letter, *(with_uncertainty(float(bias[0]), factor * float(bias[1])) for bias in (accel, gyro))])
    caption = f"Of the inertial unit at the end, by the filter {LABELS[result.method]}; intervals of 95 %."
    headers = ["axis", "accelerometer, µg", "gyro, deg/h"]
    return Table("Biases", caption, headers, rows)


def _image(image: Image, result: SyncResult) -> Table:
    rows: list[list[Any]] = []
    for target, (compensated, plain) in enumerate(zip(image.compensated, image.plain, strict=True), 1):
        for name, response, shift in (
            (LABELS[COMPENSATED], compensated, "–"),
            (LABELS[NONE], plain, number(float(image.shifts_m[target - 1]), 3)),
        ):  # fmt: skip
            rows.append([
                target, name, shift, number(response.azimuth_resolution_m, 4), number(response.pslr_dB, 2),
                number(response.islr_dB, 2), number(response.peak / compensated.peak, 3),
            ])  # fmt: skip
    left_s = result.found.offsets[COMPENSATED].offset_s - result.found.shift_s  # the rest is out of the tags of both
    due_m = -image.speed_m_s * left_s
    caption = (
        f"Point targets found in {image.pulses} pulses, focused with both navigation solutions. Shift: along the track "
        f"against the compensated image, positive ahead; by speed and offset alone it would be {due_m:+.3f} m "
        f"({image.speed_m_s:.1f} m/s, {_MS * left_s:.3f} ms; the drift is taken out of both), velocity errors along "
        "the line of sight add to it. Windows: main lobe to the first zeros of an ideal response, side lobes to 12 "
        "cells."
    )
    headers = ["target", "navigation", "shift, m", "resolution, m", "PSLR, dB", "ISLR, dB", "peak"]
    return Table("Radar image", caption, headers, rows)


def _received(result: SyncResult) -> Table:
    ready = result.ready
    rows: list[list[Any]] = [
        ["analysed, s", number(ready.span_s, 3)],
        ["samples of the inertial unit", int(ready.imu.t_s.size)],
        ["of these lost and filled in", ready.filled],
        ["solutions of the EGI used", result.found.samples],
        ["lost", ready.lost_egi],
        ["not used: aligning, without GPS or not sound", ready.unsound_egi],
        ["left out: single solutions unlike their neighbours", ready.odd_egi],
        ["left out and filled in: single samples of the inertial unit unlike their neighbours", ready.odd_imu],
    ]
    return Table("What was received", f"Manoeuvre: {result.manoeuvre or 'not stated'}.", ["what", "number"], rows)
