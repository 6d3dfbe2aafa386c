"""Points that are measured in several records: how well their mean is known, and the records as one reading.

Source: docs/decisions/0004 (quantisation, white noise), 0047 (stop rules).
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence

import numpy as np
from numpy.typing import NDArray

from bench.maths.arrays import Flags
from bench.model.stopping import FIRST
from bench.systems.af_converter.estimators.readings import Converter, Readings


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
