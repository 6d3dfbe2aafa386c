"""Estimates of a campaign by the DMM method before its first hour: planned levels and readings, declared noise.

The readings are those of a meter without noise: what counts of it is its register and a digit of its display.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from bench.analysis import Document, Material, Planned, Prediction, Reading
from bench.model.clock import NS
from bench.systems.af_converter.constants import METER, read_campaign, read_ranges
from bench.systems.af_converter.dmm_method.analysis import determine
from bench.systems.af_converter.dmm_method.estimates import CHECK, CONFIGURE, MEASURE, ZERO
from bench.systems.af_converter.estimators.dmm_method import METHODS
from bench.systems.af_converter.nominal import stimulated_row


def predicted(planned: Planned) -> Prediction:
    """Return estimates with the uncertainties that a campaign will give; the values are those of a nominal unit.

    The scatter of the readings is not known before; a digit of the display stands for it.

    Raises:  FitError as ``analysis.analyse``, where no group at all is determined.
    """
    constants = read_campaign(planned.campaign)
    rows = [stimulated_row(window, constants) for window in planned.windows]
    ranges_A = sorted(read_ranges(planned.standards, METER))
    known = determine(
        Material(rows, planned.campaign, planned.standards, readings=list(_readings(planned, ranges_A))), METHODS[0]
    )
    return Prediction(known.estimates, known.missing)


def _readings(planned: Planned, ranges_A: Sequence[float]) -> Iterator[Reading]:
    """Yield the readings of the meter with the values of a nominal bench: the range it takes, the planned current.

    The range is the smallest of the register that holds the current without its over-range.
    """
    windows = sorted(planned.windows, key=lambda window: window.t_start_ns)
    for reading in planned.readings:
        if reading.role != METER:
            continue
        t_ns = round(reading.t_s * NS)
        at = replace(reading, t_s=1e-9 * t_ns)  # to the digit as the log of the meter has the ends of windows
        if reading.name == CONFIGURE:
            asked_A = float(reading.arguments["range"])
            yield replace(at, value=next((full for full in ranges_A if asked_A <= full), asked_A))
        elif reading.name == MEASURE:
            following = next((window.conditions for window in windows if window.t_start_ns >= t_ns), {})
            yield replace(at, value=_current_A(reading.conditions, following))


def _current_A(own: Document, following: Document) -> float:
    """Return what flows while the meter reads, by its own conditions and those of the next record."""
    if {ZERO, CHECK} & own.keys():
        return float(own.get(CHECK) or 0.0)
    return abs(float(following.get("current_A") or 0.0))
