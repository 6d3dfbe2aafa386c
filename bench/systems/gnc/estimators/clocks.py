"""A unit's own clock against the bench clock, over a session.

An integral of rate is taken with the unit's time stamps, and a turn by the bench's: a crystal that is 20 ppm fast makes
every scale factor 20 ppm too large. A frame is received behind its sample, never before it, so a line below all delays
that rests on two of them has the slope of the two clocks; at either end it may be off by the time between samples.

Source: Moon, Skelly, Towsley, Estimation and Removal of Clock Skew from Network Delay Measurements, INFOCOM 1999 (line
below the delays); rectangular bounds, JCGM 100:2008 section 4.3.7.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from bench.maths.arrays import Floats, Integers
from bench.maths.stamps import lower_hull, unwrapped_ticks_s

UNKNOWN_STD = 5e-5 / math.sqrt(3.0)  # a common crystal is within 50 ppm
_WRAP_S = (1 << 32) * 1e-6
_SAME_s, _SAME = 2.5, 1e-3  # chunks may come a second late; clocks differ by less than that
_APART = 1e-3  # of the slope: beyond it the stamps are not of one clock


@dataclass(frozen=True)
class UnitClock:
    """``error``: relative, positive = the unit's clock is fast.   ``std``: its standard uncertainty.
    An error that is known no better than crystals in general is taken as zero.
    """

    error: float = 0.0
    std: float = UNKNOWN_STD


def unit_clock(records: Sequence[tuple[Integers, Floats]], interval_s: float) -> UnitClock:
    """Ratio of both clocks from the longest stretch of records in which the unit was not restarted.

    Args:    records: (time stamps in us, 32 bits, and receive times of the bench in s) of each, in order.
             interval_s: between samples.
    Returns: UnitClock; the bench clock is taken as right.
    Raises:  nothing.
    Source:  see the head of this file.
    """
    clocks = [_slope([(unit_s, received_s) for _, unit_s, received_s in stretch], interval_s)
             for stretch in _stretches(records)]  # fmt: skip
    known = [clock for clock in clocks if clock.std < UNKNOWN_STD and abs(clock.error) < _APART]
    return min(known, key=lambda clock: clock.std, default=UnitClock())


def power_ons(records: Sequence[tuple[Integers, Floats]]) -> list[list[int]]:
    """Places of the records between two restarts of the unit's clock, that is, of one power-on each.

    Args:    records: as ``unit_clock``.
    Returns: places from 0, in their order.
    Raises:  nothing.
    Source:  stamps count from the power-on.
    """
    return [[place for place, _, _ in stretch] for stretch in _stretches(records)]


def _stretches(records: Sequence[tuple[Integers, Floats]]) -> list[list[tuple[int, Floats, Floats]]]:
    """Place, stamps and receive times of records whose stamps follow on one another."""
    stretches: list[list[tuple[int, Floats, Floats]]] = []
    for place, (tick_us, received_s) in enumerate(records):
        unit_s = unwrapped_ticks_s(tick_us) + float(tick_us[0]) * 1e-6
        if stretches:
            last_unit_s, last_s = float(stretches[-1][-1][1][-1]), float(stretches[-1][-1][2][-1])
            between_s = float(received_s[0]) - last_s
            turns = round((last_unit_s + between_s - float(unit_s[0])) / _WRAP_S)
            unit_s = unit_s + turns * _WRAP_S
            if abs(float(unit_s[0]) - last_unit_s - between_s) < _SAME_s + _SAME * between_s:
                stretches[-1].append((place, unit_s, received_s))
                continue
        stretches.append([(place, unit_s, received_s)])
    return stretches


def _slope(stretch: Sequence[tuple[Floats, Floats]], interval_s: float) -> UnitClock:
    at_s, delay_s = _least_delays(stretch)
    if at_s[-1] <= at_s[0]:
        return UnitClock()
    edges = [np.array(edge) for edge in pairwise(lower_hull(at_s, delay_s, 200))]
    base_s, edge = max(((float(np.ptp(at_s[edge])), edge) for edge in edges), key=lambda each: each[0])
    slope = float(delay_s[edge[1]] - delay_s[edge[0]]) / base_s
    above = delay_s - slope * at_s
    least_s = max(interval_s, float(np.median(above) - above.min()))
    return UnitClock(error=-slope, std=least_s / base_s / math.sqrt(6.0))


def _least_delays(stretch: Sequence[tuple[Floats, Floats]]) -> tuple[Floats, Floats]:
    """Of each chunk that was received, its last sample: (k,) unit's time and delay, from the first one on."""
    unit_s, received_s = (np.concatenate(column) for column in zip(*stretch, strict=True))
    last = np.concatenate([np.diff(received_s) > 0.0, [True]])
    at_s = unit_s[last]
    return at_s - at_s[0], received_s[last] - at_s
