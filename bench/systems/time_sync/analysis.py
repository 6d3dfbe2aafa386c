"""Time offset between an EGI and the inertial unit at a radar antenna, from a recording of both through a manoeuvre.

Method and requirements: docs/method-time-sync.md. The truth of a simulation enters nowhere.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from bench.analysis import (
    Analysis,
    Estimates,
    Figure,
    Floats,
    Material,
    Series,
    Table,
    band,
    decimals_for,
    no_result,
    number,
    series,
    significant,
    stated_value,
    unseen_tables,
    worded_figure,
    worded_table,
)
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError
from bench.systems.time_sync.departures import chi2_of, implausible, rows_of, searched_rows
from bench.systems.time_sync.estimates import SyncResult, sync_estimates
from bench.systems.time_sync.estimators.kalman.innovation import NIS_DOF, observability
from bench.systems.time_sync.estimators.kalman.setup import LOOSE, NIS_BLOCKS, TIGHT
from bench.systems.time_sync.estimators.sar.image import levels_dB
from bench.systems.time_sync.filtering import (
    COMPENSATED,
    GROUPS,
    METHODS,
    NONE,
    Filtered,
    filtered,
    ratio_of,
    trajectory_figures,
)
from bench.systems.time_sync.image import Image, drawn, first_pulse_s, image_of
from bench.systems.time_sync.limits import DIFFERENCE, demands_of, densities_of, latency_of, spread_of
from bench.systems.time_sync.records import Recording, clocks_of, recording
from bench.systems.time_sync.samples import prepared
from bench.systems.time_sync.wording import filter_name, manoeuvre_name, say

_MS = 1e3
_MOST_POINTS = 1200
_LEAST = 1e-9
_MOST_RATIO = 1.5


def tables(result: SyncResult, entries: Estimates) -> list[Table]:
    """Return all, the result in front; what is an estimate is printed as ``entries`` have it."""
    values = _result(result, entries), _filters(result), _clocks(result, entries)
    first = [*values, _consistency(result), _biases(result, entries)]
    return [*first, *([_image(result.image, result)] if result.image else []), _received(result)]


def _stated(entries: Estimates, quantity: str, scale: float = 1.0, **where: Any) -> str:
    """Return what the first estimate of a quantity states, times ``scale``."""
    return next(
        stated_value(entry, scale)
        for entry in entries
        if entry.quantity == quantity and where.items() <= entry.conditions.items()
    )


def _result(result: SyncResult, entries: Estimates) -> Table:
    """Return what is read first."""
    rows: list[list[Any]] = []
    for name in METHODS:
        seen = result.found.offsets[name].seen
        told = _stated(entries, "time_offset", _MS, method=name) if seen else say("unseen")
        rows.append([say("result.filter", name=filter_name(name)), told, _role(result, name)])
    if result.clocks.offset_s is None:
        rows.append([say("result.stamps"), say("result.no_latencies"), "–"])
    else:
        stamps = _stated(entries, "time_offset_from_stamps", _MS)
        rows.append([say("result.stamps_and_latencies"), stamps, say("role.independent")])
    if result.difference_s is not None:
        rows.append([say("result.filter_minus_stamps"), _stated(entries, DIFFERENCE, _MS), say("role.judged")])
    limits = {"interval": _MS * result.demands.uncertainty_s, "difference": _MS * result.demands.difference_s}
    caption = say("result.caption" if result.chosen.seen else "result.caption_unseen", **limits)
    return Table(say("result.title"), caption, say.heads("result", "by", "offset", "role"), rows, lead=True)


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
    heads = [
        "filter", "believed", "stated", "nis", "beforehand", "drift", "all", "variance", "eigenvalue",
        "observable",
    ]  # fmt: skip
    return worded_table(say, "filters", heads, rows, loose=_noise(LOOSE), tight=_noise(TIGHT))


def _part(std_s: float) -> str:
    """Return a part of an uncertainty in milliseconds, one digit more than of a result, so that sums can be checked."""
    return number(_MS * std_s, decimals_for(_MS * std_s) + 1)


def _noise(sigma: tuple[float, float, float]) -> str:
    return f"{sigma[0]:g} m, {sigma[1]:g} m/s, {sigma[2]:g} deg"


def _clocks(result: SyncResult, entries: Estimates) -> Table:
    clocks = result.clocks
    rows: list[list[Any]] = [
        [
            name, port.above_s.size, _stated(entries, "clock_rate", link=link),
            number(_MS * port.jitter_s, 3), number(1e6 * port.tag_noise_s, 1), number(_MS * port.grid_s, 3),
        ]
        for name, link, port in ((say("imu"), "imu", clocks.imu), ("EGI", "egi", clocks.egi))
    ]  # fmt: skip
    rows.append([say("clocks.egi_against_imu"), "–", _stated(entries, "time_offset_drift"), "–", "–", "–"])
    stated = say("clocks.no_latencies")
    if clocks.latency is not None:
        latency = clocks.latency
        stated = say("clocks.latencies", egi=_MS * latency.egi_s, imu=_MS * latency.imu_s, std=_MS * latency.std_s)
    heads = ["clock", "frames", "rate", "jitter", "noise", "step"]
    return worded_table(say, "clocks", heads, rows, stated=stated, longer=_MS * clocks.line_s)


def _consistency(result: SyncResult) -> Table:
    run, rows = result.found.run, []
    for group, name in enumerate(GROUPS):
        ratios = [ratio_of(run, group, block) for block in range(len(NIS_BLOCKS))]
        rows.append([filter_name(name), *(significant(ratio) if math.isfinite(ratio) else "–" for ratio in ratios)])
    return worded_table(say, "consistency", ["filter", *NIS_BLOCKS], rows)


def _biases(result: SyncResult, entries: Estimates) -> Table:
    kinds = ("accel_bias", "gyro_bias")
    rows = [[axis, *(_stated(entries, quantity, axis=axis) for quantity in kinds)] for axis in "xyz"]
    heads = ["axis", "accelerometer", "gyro"]
    return worded_table(say, "biases", heads, rows, name=filter_name(result.method))


def _image(image: Image, result: SyncResult) -> Table:
    rows: list[list[Any]] = []
    for target, (compensated, plain) in enumerate(zip(image.compensated, image.plain, strict=True), 1):
        for name, response, shift in (
            (filter_name(COMPENSATED), compensated, "–"),
            (filter_name(NONE), plain, number(float(image.shifts_m[target - 1]), 3)),
        ):  # fmt: skip
            rows.append([
                target, name, shift, number(response.azimuth.resolution_m, 4), number(response.azimuth.pslr_dB, 2),
                number(response.azimuth.islr_dB, 2), number(response.peak / compensated.peak, 3),
            ])  # fmt: skip
    left_s = result.found.offsets[COMPENSATED].offset_s - result.found.shift_s  # the rest is out of the tags of both
    due_m = -image.speed_m_s * left_s
    heads = ["target", "navigation", "shift", "resolution", "pslr", "islr", "peak"]
    return worded_table(
        say, "image", heads, rows, pulses=image.pulses, due=due_m, speed=image.speed_m_s, left=_MS * left_s
    )


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
    return worded_table(say, "received", ["what", "number"], rows, name=manoeuvre_name(result.manoeuvre))


def figures(result: SyncResult) -> list[Figure]:
    """Return all that the recording allows."""
    drawn = [*_offsets(result), *_seen(result), *_innovations(result), *_stamps(result)]
    return drawn + ([*_chips(result.image), *_responses(result.image)] if result.image else [])


def _offsets(result: SyncResult) -> list[Figure]:
    drawn = []
    for name in METHODS:
        offset_s, std_s = result.found.history_s(name)
        t_s, offset_ms, reach_ms = _thin(result.found.run.t_s, 1e3 * offset_s, 1e3 * coverage_factor() * std_s)
        parts = [
            series(say("offset.series"), t_s, offset_ms, "line"),
            band(say("offset.band"), t_s, offset_ms - reach_ms, offset_ms + reach_ms),
        ]
        if result.clocks.offset_s is not None:
            stamps_ms = 1e3 * result.clocks.offset_s
            ends_s = [float(t_s[0]), float(t_s[-1])]
            parts.append(series(say("result.stamps"), ends_s, [stamps_ms, stamps_ms], "line"))
        title = say("offset.title", name=filter_name(name))
        labels = say("offset.caption"), say("time"), say("result.head.offset")
        drawn.append(Figure(title, *labels, parts, group=say("offset.group")))
    return drawn


def _seen(result: SyncResult) -> list[Figure]:
    parts: list[Series] = []
    for name in METHODS:
        group = GROUPS.index(name)
        t_s, variance, value = _thin(
            result.found.run.t_s, result.seen.offset_variance[:, group], result.seen.associated[:, group]
        )
        short = say(f"seen.{name}")
        parts.append(series(say("seen.variance", name=short), t_s, np.maximum(variance, _LEAST), "line"))
        parts.append(series(say("seen.eigenvalue", name=short), t_s, np.maximum(value, _LEAST), "line"))
    return [worded_figure(say, "seen", ("time", "seen.y"), parts, logarithmic="y")]


def _innovations(result: SyncResult) -> list[Figure]:
    run, parts = result.found.run, []
    for group, name in enumerate(GROUPS):
        ratio = run.nis[:, group, 0] / NIS_DOF[0]
        use = np.isfinite(ratio) & (ratio > 0.0)
        if use.any():
            t_s, value = _thin(run.t_s[use], ratio[use])
            parts.append(series(filter_name(name), t_s, value, "points"))
    axes = "time", "innovations.y"
    return [worded_figure(say, "innovations", axes, parts, logarithmic="y")] if parts else []


def _stamps(result: SyncResult) -> list[Figure]:
    clocks, drawn = result.clocks, []
    for unit, at_s, port in ((say("imu"), clocks.imu_s, clocks.imu), ("EGI", clocks.egi_s, clocks.egi)):
        every = max(1, at_s.size // _MOST_POINTS)
        x, y = at_s[::every], 1e3 * port.above_s[::every]
        axes, parts = ("stamps.x", "stamps.y"), [series(say("clocks.head.frames"), x, y, "points")]
        drawn.append(worded_figure(say, "stamps", axes, parts, group=say("result.stamps"), unit=unit))
    return drawn


def _chips(image: Image) -> list[Figure]:
    """Return both images about the place of the strongest target, as it was found with the compensated solution."""
    figures = []
    for name, chip in zip((COMPENSATED, NONE), image.chips, strict=True):
        parts = [drawn(chip, np.abs(chip.value).max())]
        labels = say(f"chip.{name}"), say("chip.caption"), say("cut.azimuth.x"), say("cut.range.x")
        figures.append(Figure(*labels, parts, group=say("path.image")))
    return figures


def _responses(image: Image) -> list[Figure]:
    """Cuts through the strongest target, each about its own peak; the shift stands in the label of the second."""
    drawn = []
    compensated, plain = image.compensated[0], image.plain[0]
    for name, cut in compensated.cuts.items():
        top = float(np.max(np.abs(cut.value)))
        parts = [
            series(filter_name(navigation), one.offset_m + (one.shift_m - cut.shift_m),
                   levels_dB(one.value, top), "line")
            for navigation, one in ((COMPENSATED, cut), (NONE, plain.cuts[name]))
        ]  # fmt: skip
        labels = say(f"cut.{name}"), say("cut.caption"), say(f"cut.{name}.x"), say("cut.y")
        drawn.append(Figure(*labels, parts, group=say("cut.group")))
    return drawn


def _thin(t_s: Floats, *values: Floats) -> tuple[Floats, ...]:
    every = max(1, t_s.size // _MOST_POINTS)
    return tuple(column[::every] for column in (t_s, *values))


def notes(result: SyncResult) -> list[str]:
    """Return all of them."""
    return [*result.ready.notes, *_of_clocks(result), *_filter(result)]


def _of_clocks(result: SyncResult) -> list[str]:
    clocks = result.clocks
    notes = [] if clocks.offset_s is not None else [say("note.no_latencies")]
    if clocks.coarse_s:
        notes.append(say("note.coarse", apart=clocks.coarse_s))
    if clocks.imu.grid_s > 0.0:
        notes.append(say("note.grid", step=1e3 * clocks.imu.grid_s))
    if result.chosen.drift_std_s > 0.5 * result.chosen.error_std_s:
        notes.append(say("note.drift"))
    return notes


def _filter(result: SyncResult) -> list[str]:
    notes = []
    ratio = ratio_of(result.found.run, GROUPS.index(result.method))
    if math.isfinite(ratio) and ratio > _MOST_RATIO:
        notes.append(say("note.innovations", times=math.sqrt(ratio)))
    return notes


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Return offset by all filters and by the receive stamps; ``method`` says which filter is judged.

    Raises: FitError B-SYNC-001 to -009 and -011; a radar without an image is missing.
    """
    return analysis_of("time_sync", recording(material), material, method)


def analysis_of(campaign: str, taken: Recording, material: Material, method: str) -> Analysis:
    """Return everything that both units sent shows, by all filters; ``method`` says which one is judged.

    Raises: FitError B-SYNC-003 to -009 and -011; a radar without an image is missing.
    """
    demands, latency = demands_of(material.campaign), latency_of(material.campaign)
    densities = densities_of(material.campaign)
    ready = prepared(taken)
    clocks = clocks_of(taken, ready.middle_s, latency, material.line_s)
    spread = spread_of(material.campaign, ready.egi.position_std_m)
    filtering = filtered(ready, clocks, densities, spread, first_pulse_s(taken.radar))
    image, missing = _formed(taken, filtering)
    seen = observability(filtering.run.covariance, filtering.run.first_covariance)
    result = SyncResult(taken.manoeuvre, ready, clocks, filtering, seen, image, demands, method)
    rows, entries = rows_of(result, densities, spread, taken), sync_estimates(result)
    residuals = rows.residuals(entries)
    searched, (chi2, dof) = searched_rows(rows, residuals), chi2_of(residuals)
    return Analysis(
        campaign,
        method,
        material.campaign["uut"],
        entries,
        evidence=[*implausible(result), *searched.evidence],
        groups=[{"reduced_chi2": chi2 / dof, "dof": dof}],
        notes=[*no_result(missing), *notes(result)],
        missing=missing,
        figures=[*trajectory_figures(ready.egi, taken.radar), *figures(result)],
        tables=[*tables(result, entries), *unseen_tables([searched])],
    )


def _formed(taken: Recording, filtering: Filtered) -> tuple[Image | None, list[str]]:
    if taken.radar is None:
        return None, []
    try:
        return image_of(taken.radar, filtering), []
    except FitError as error:
        return None, [say("missing.image", why=error.message, code=error.code)]
