"""A measuring point of a scale-factor campaign, as far as a stop rule asks: how well its mean current is known.

Random is what differs from one measurement of the same point to the next: the fractions of a pulse at the ends of each
piece, of the counts and of the AF clock, and the white noise of the converter. Source: docs/decisions/0004, 0047.

Points that are measured in several records: how well their mean is known, and the records as one reading.

Source: docs/decisions/0004 (quantisation, white noise), 0047 (stop rules).
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bench.analysis import Document, count_problem
from bench.maths.arrays import Flags
from bench.model.stopping import FIRST
from bench.systems.af_converter.constants import read_campaign
from bench.systems.af_converter.estimators.readings import Converter, Readings

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


def random_A(converter: Converter, level_A: float, seconds: float, cuts: int) -> tuple[float, float]:
    """Return standard uncertainties of a mean current, ampere: by quantisation alone, and with white noise.

    Args:    level_A: magnitude of the current.   seconds: that is measured in all, positive.
             cuts: pieces it is measured in; each begins and ends anywhere between two pulses.
    Source:  docs/decisions/0004: two uniform residues of one pulse for each piece, of the counts and of the AF clock;
             white / sqrt(2 seconds).
    """
    of_pulse_A = converter.k0_C / seconds
    of_clock_A = level_A / (converter.af_clock_Hz * seconds)
    quantised_A = math.hypot(of_pulse_A, of_clock_A) * math.sqrt(cuts / 6.0)
    return quantised_A, math.hypot(quantised_A, converter.white_A_rtHz / math.sqrt(2.0 * seconds))


def joined(
    rows: Readings, places: Sequence[Hashable], stages: Sequence[int], follows: Sequence[bool]
) -> tuple[Readings, Flags]:
    """Return readings of which each is a whole point, and which rows (m,) are the first of theirs.

    Counts and gates add up; records without a gap between them cut no pulse there. ``scatter`` of a point is the
    variance of its mean from the scatter of its first stage alone: that of one record over the records of that length
    in the whole point. It holds the fractions of a pulse at the ends of each record, so that of a point which is quiet
    beside a pulse is too large, never too small.

    Args:    places: of each row, equal for records of one point, which stand behind each other; None for a row that is
             a point by itself, (m,).   stages: 1 for records of the first stage, (m,).   follows: records that begin
             with the very frame behind the row before, (m,).
    Source:  Stein 1945, see bench.maths.stein.
    """
    begins = np.array([place is None or not at or place != places[at - 1] for at, place in enumerate(places)], bool)
    if begins.all():
        return rows, begins
    cuts = ~(begins | np.asarray(follows, bool))
    first = np.flatnonzero(begins)
    gate_s = np.add.reduceat(rows.gate_s, first)
    columns = {name: getattr(rows, name)[first] for name in rows.__dataclass_fields__}
    for name in ("n_count", "p_count", "af_count"):
        columns[name] = np.add.reduceat(getattr(rows, name), first)
    columns["halves"] = np.where(np.append(begins[1:], True)[first], columns["halves"], np.nan)
    columns["gaps"] = np.add.reduceat(rows.gaps + cuts, first)
    for name in ("time_s", "unit_temperature_degC"):
        columns[name] = np.add.reduceat(getattr(rows, name) * rows.gate_s, first) / gate_s
    columns["temperature_std_degC"] = np.maximum.reduceat(rows.temperature_std_degC, first)
    stop = np.append(first[1:], rows.gate_s.size)
    of_stage = np.asarray(stages) == FIRST
    for at, (begin, end) in enumerate(zip(first, stop, strict=True)):
        chosen = np.flatnonzero(of_stage[begin:end]) + begin
        columns["scatter"][at], columns["scatter_dof"][at] = _scatter(rows, chosen, gate_s[at])
    return Readings(**{**columns, "gate_s": gate_s}), begins


def _scatter(rows: Readings, chosen: NDArray[np.int_], gate_s: float) -> tuple[float, float]:
    """Return the variance of the mean of pulses per pulse of the AF clock over ``gate_s``, and degrees of freedom."""
    if chosen.size < 2:
        return 0.0, 0.0
    per_pulse = (rows.n_count[chosen] - rows.p_count[chosen]) / rows.af_count[chosen]
    return float(np.var(per_pulse, ddof=1) * rows.gate_s[chosen].mean() / gate_s), chosen.size - 1.0
