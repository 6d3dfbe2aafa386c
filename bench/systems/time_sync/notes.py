"""Sentences a reader of a time offset must know."""

from __future__ import annotations

import math

from bench.maths.verdict import coverage_factor
from bench.systems.time_sync.estimates import SyncResult
from bench.systems.time_sync.filtering import GROUPS, ratio_of
from bench.systems.time_sync.wording import say

_MOST_RATIO = 1.5


def notes(result: SyncResult) -> list[str]:
    """Return all of them."""
    return [*result.ready.notes, *_against_stamps(result), *_clocks(result), *_filter(result)]


def _against_stamps(result: SyncResult) -> list[str]:
    if result.clocks.offset_s is None:
        return [say("note.no_latencies")]
    if result.difference_s is None:
        return []
    apart_s, std_s = result.difference_s
    if abs(apart_s) <= coverage_factor() * std_s:
        return []
    return [say("note.apart", apart=1e3 * apart_s, due=1e3 * coverage_factor() * std_s)]


def _clocks(result: SyncResult) -> list[str]:
    clocks, notes = result.clocks, []
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
