"""A measuring point of a scale-factor campaign, as far as a stop rule asks: how well its mean current is known.

Random is what differs from one measurement of the same point to the next: the fractions of a pulse at the ends of each
piece, of the counts and of the AF clock, and the white noise of the converter. Source: docs/decisions/0004, 0047.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from bench.analysis import Document, count_problem
from bench.systems.af_converter.constants import read_campaign
from bench.systems.af_converter.estimators.points import random_A

if TYPE_CHECKING:
    from bench.record import RecordRow

UNIT = "A"


def may_end(conditions: Document) -> bool:
    """Return whether the point may end early: a level of a first visit. Zeros and repeats hold up all other points."""
    closed = conditions.get("route", "closed") != "open" and bool(conditions.get("polarity"))
    return closed and level(conditions) > 0.0 and not conditions.get("repeat", 0)


def level(conditions: Document) -> float:
    """Return the magnitude of the calibrator's current, ampere."""
    return abs(float(conditions.get("current_A") or 0.0))


def random(campaign: Document, conditions: Document, seconds: float, cuts: int) -> tuple[float, float]:
    """Return standard uncertainties of the mean current, ampere: by quantisation alone, and with the declared noise.

    Raises: FitError B-FIT-008 for a channel or noise that is not declared.
    """
    converter = read_campaign(campaign).converter(int(conditions.get("channel", 0)))
    return random_A(converter, level(conditions), seconds, cuts)


def mean(row: RecordRow, campaign: Document) -> float:
    """Return the mean current of a record by nominal scale factors, signed, ampere; NaN for one that does not count.

    Source: AF-converter paper equations (1), (2): K0 C with C = r N / t is K0 f_AF0 N / n_AF, the gate cancels.
    """
    if count_problem(row):
        return math.nan
    number = int(row.window.conditions["channel"])
    converter = read_campaign(campaign).converter(number)
    pulses = int(row.sums["npp"][number - 1]) - int(row.sums["ppp"][number - 1])
    return converter.k0_C * converter.af_clock_Hz * pulses / float(row.sums["af_clock"])
