"""What a calibration will know: its fits of positions and turns of a nominal unit, with the noise that is declared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.analysis import Planned, Prediction
from bench.systems.gnc.calibration.analysis import estimates_of, fit_positions, fit_turns, name_missing
from bench.systems.gnc.calibration.sets import Calibration, sets_of
from bench.systems.gnc.limits import limits_of
from bench.systems.gnc.predicted.declared import noise_of
from bench.systems.gnc.predicted.records import nominal_material
from bench.systems.gnc.rows import SampledRow, clock_of, power_on_of, sampled_rows

ITEMS = ("position", "rotation")


def predicted(planned: Planned) -> Prediction:
    """Return estimates of a nominal unit with the uncertainties that a calibration will give.

    Raises:  FitError as ``analysis.analyse``, that of the fit where nothing is determined.
    """
    rows, missing = sampled_rows(nominal_material(planned, ("gyro", "accel")), ITEMS)
    parts = fitted(rows, planned.campaign)
    return Prediction(estimates_of(parts, limits_of(planned.campaign)), [*missing, *parts.missing])


def fitted(rows: Sequence[SampledRow], campaign: Mapping[str, Any]) -> Calibration:
    """Return the fits of records without noise, with the noise that is declared. Raises: FitError as ``predicted``."""
    parts = Calibration(sets_of(rows), clock_of(rows), power_on_of(rows))
    undeclared: list[str] = []
    name_missing(parts)
    accelerometer = noise_of(campaign, "accelerometer", undeclared)
    if accelerometer is not None:
        fit_positions(parts, campaign, accelerometer)
    gyro = noise_of(campaign, "gyro", undeclared)
    if gyro is not None:
        fit_turns(parts, campaign, gyro)
    parts.missing = [*undeclared, *parts.missing]
    return parts
