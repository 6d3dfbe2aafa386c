"""Sentences a reader of a time offset must know."""

from __future__ import annotations

import math

from bench.maths.verdict import coverage_factor
from bench.systems.time_sync.estimates import SyncResult
from bench.systems.time_sync.filtering import GROUPS, ratio_of

_MOST_RATIO = 1.5


def notes(result: SyncResult) -> list[str]:
    """Return all of them."""
    return [*result.ready.notes, *_against_stamps(result), *_clocks(result), *_filter(result)]


def _against_stamps(result: SyncResult) -> list[str]:
    if result.clocks.offset_s is None:
        return [
            "No latencies are stated (uut: latency): receive stamps tell the drift of both clocks, not their offset."
        ]
    if result.difference_s is None:
        return []
    apart_s, std_s = result.difference_s
    if abs(apart_s) <= coverage_factor() * std_s:
        return []
    return [
        f"Filter and receive stamps are {1e3 * apart_s:+.3f} ms apart, {1e3 * coverage_factor() * std_s:.3f} ms are "
        "due: a latency is not as stated, or the filter is led astray."
    ]


def _clocks(result: SyncResult) -> list[str]:
    clocks, notes = result.clocks, []
    if clocks.coarse_s:
        notes.append(
            f"The clocks began {clocks.coarse_s:.2f} s apart: that was taken out of the tags beforehand, by the "
            "receive stamps, and is part of the offset. What is not compensated has it taken out, too."
        )
    if clocks.imu.grid_s > 0.0:
        notes.append(
            f"The bench reads its ports each {1e3 * clocks.imu.grid_s:g} ms: the place within such a step is told by "
            "the jitter of the frames, taken as exponential."
        )
    if result.chosen.drift_std_s > 0.5 * result.chosen.error_std_s:
        notes.append(
            "Much of the interval is that of the drift between both clocks, which short recordings tell badly: record "
            "longer, or nearer to the manoeuvre."
        )
    return notes


def _filter(result: SyncResult) -> list[str]:
    notes = []
    ratio = ratio_of(result.found.run, GROUPS.index(result.method))
    if math.isfinite(ratio) and ratio > _MOST_RATIO:
        notes.append(
            f"Innovations are {math.sqrt(ratio):.1f} times as large as the filter believes: the interval is widened by "
            "that. Look at the data sheet of the inertial unit (uut: inertial), at vibration and at mounting."
        )
    return notes
