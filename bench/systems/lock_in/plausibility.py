"""What cannot be in a record of a ring laser: counts, time stamps, dither and lock-in beyond what one can have.

These need no statistics; what chance can do is in ``evidence``.
Source: docs/decisions/0025-doubt.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from bench.analysis import Evidence
from bench.systems.lock_in.result import LaserResult
from bench.systems.lock_in.wording import say

CONSTANTS = ("lock_in_rate", "backscatter_phase")
RATIOS = ("random_walk_ratio", "alignment_time_ratio")
BIASES = ("bias_instability", "bias_alignment_error")
WALKS = ("angle_random_walk", "quantisation_noise", "alignment_time", "path_length_exponent", *BIASES, *RATIOS)
_SENSOR_OFF = 0.05  # of the dither amplitude, five times what its sensor is good to
_LEAST_SCATTER = 0.02  # of the dither's amplitude; with less the jumps are no random walk (docs/ring-laser.md)
_MOST_JUMP_rad = 0.5  # the fit is of first order in it
_MOST_STEP_rad = 0.2  # of the phase in one step of the time stamps, where the rate is largest
_MOST_REPEATED = 0.01  # of the blocks


def implausible(laser: LaserResult) -> Iterator[Evidence]:
    """Yield what cannot be, of one record."""
    yield from _counts(laser)
    yield from _dither(laser)
    yield from _stamps(laser)
    yield from _lock_in(laser)


def _certain(code: str, sentence: str, figure: float, laser: LaserResult, quantities: Sequence[str] = ()) -> Evidence:
    return Evidence(code, sentence, figure, 0.0, math.inf, quantities, laser.record.place(laser.clock_Hz))


def _counts(laser: LaserResult) -> Iterator[Evidence]:
    odd, repeated, blocks = len(laser.found.odd_s), laser.events.repeated, laser.record.blocks
    if not laser.found.odd_left_out:
        sentence = say("evidence.count_odd", name=laser.name, count=odd)
        yield _certain("count_odd", sentence, float(odd), laser, WALKS)
    if repeated > max(1.0, _MOST_REPEATED * blocks):
        sentence = say("evidence.repeated_blocks", repeated=repeated, blocks=blocks, name=laser.name)
        yield _certain("repeated_blocks", sentence, float(repeated), laser)


def _dither(laser: LaserResult) -> Iterator[Evidence]:
    sensed, counted, scatter = laser.record.dither_deg_s, laser.counted_dither_deg_s, laser.found.dither_scatter
    if sensed is not None and abs(counted / sensed - 1.0) > _SENSOR_OFF:
        sentence = say("evidence.dither_disagrees", name=laser.name, counted=counted, sensed=sensed)
        yield _certain("dither_disagrees", sentence, counted / sensed - 1.0, laser)
    if scatter is not None and scatter < _LEAST_SCATTER:
        percent = {"scatter": 100 * scatter, "least": 100 * _LEAST_SCATTER}
        sentence = say("evidence.dither_too_regular", name=laser.name, **percent)
        yield _certain("dither_too_regular", sentence, scatter, laser, (*WALKS, *CONSTANTS))


def _stamps(laser: LaserResult) -> Iterator[Evidence]:
    step = laser.events.step_ticks
    turned = laser.found.swing_rad * laser.found.omega_rad_s / 2.0 * step / laser.clock_Hz
    if turned > _MOST_STEP_rad:
        sentence = say("evidence.coarse_time_stamps", name=laser.name, step=step, turned=turned)
        yield _certain("coarse_time_stamps", sentence, turned, laser)


def _lock_in(laser: LaserResult) -> Iterator[Evidence]:
    squares = [2.0 * float(np.nanmean(np.square(fit.jumps.dpsi_rad))) for fit in laser.found.constants]
    largest = math.sqrt(max(squares, default=0.0))
    if largest > _MOST_JUMP_rad:
        sentence = say("evidence.implausible_lock_in", name=laser.name, largest=largest, most=_MOST_JUMP_rad)
        place = laser.record.place(laser.clock_Hz)
        yield Evidence("implausible_lock_in", sentence, largest, 0.0, math.inf, CONSTANTS, place, refuses=True)
