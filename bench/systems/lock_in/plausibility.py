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
        sentence = (
            f"The count of {laser.name} is odd at {odd} half periods of the dither, as where edges are lost without a "
            "trace. Check comparators and tagger and take the record again."
        )
        yield _certain("count_odd", sentence, float(odd), laser, WALKS)
    if repeated > max(1.0, _MOST_REPEATED * blocks):
        sentence = (
            f"{repeated} of {blocks} blocks of {laser.name} repeat an earlier one edge by edge. Check the tagger and "
            "its link and take the record again."
        )
        yield _certain("repeated_blocks", sentence, float(repeated), laser)


def _dither(laser: LaserResult) -> Iterator[Evidence]:
    sensed, counted, scatter = laser.record.dither_deg_s, laser.counted_dither_deg_s, laser.found.dither_scatter
    if sensed is not None and abs(counted / sensed - 1.0) > _SENSOR_OFF:
        sentence = (
            f"The levels counted of {laser.name} make {counted:.2f} deg/s of dither, its sensor says {sensed:.2f}: "
            "path length, clock or sensor is not what was stated, and all angles go with the first two. See all three."
        )
        yield _certain("dither_disagrees", sentence, counted / sensed - 1.0, laser)
    if scatter is not None and scatter < _LEAST_SCATTER:
        sentence = (
            f"The dither's amplitude of {laser.name} scatters by {100 * scatter:.2f} %. Below {100 * _LEAST_SCATTER:g} "
            "% the errors of turnarounds follow one another (dynamic lock-in): they are no random walk, equation (6) "
            "does not hold, and part of the input rate may be lost. Put more noise on the dither."
        )
        yield _certain("dither_too_regular", sentence, scatter, laser, (*WALKS, *CONSTANTS))


def _stamps(laser: LaserResult) -> Iterator[Evidence]:
    step = laser.events.step_ticks
    turned = laser.found.swing_rad * laser.found.omega_rad_s / 2.0 * step / laser.clock_Hz
    if turned > _MOST_STEP_rad:
        sentence = (
            f"The time stamps of {laser.name} are multiples of {step} ticks, in which the phase turns by {turned:.2g} "
            "rad: too coarse for any of these fits. Check the tagger."
        )
        yield _certain("coarse_time_stamps", sentence, turned, laser)


def _lock_in(laser: LaserResult) -> Iterator[Evidence]:
    squares = [2.0 * float(np.nanmean(np.square(fit.jumps.dpsi_rad))) for fit in laser.found.constants]
    largest = math.sqrt(max(squares, default=0.0))
    if largest > _MOST_JUMP_rad:
        sentence = (
            f"The lock-in of {laser.name} makes jumps of {largest:.2g} rad; its equations hold to {_MOST_JUMP_rad:g} "
            "rad. Check path length, dither and comparators."
        )
        place = laser.record.place(laser.clock_Hz)
        yield Evidence("implausible_lock_in", sentence, largest, 0.0, math.inf, CONSTANTS, place, refuses=True)
