"""What the data of a DMM campaign say against its model: all visits of all channels as rows of one fit.

Readings are counted currents, against those that the meter read. Free are both counters of each channel and
temperature, a current of each visit and the leakage of the switch; errors of the meter are known as far as its
specification. A point that is taken again must show the same unit against the same meter, so its rows are here too.
Source: docs/method-af-converter.md (model), method-uncertainty.md (doubt, departures).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from bench.analysis import (
    Estimate,
    Estimates,
    Searched,
    departures_of,
    operators_of,
    search,
)
from bench.maths.arrays import Flags, Floats
from bench.systems.af_converter.constants import Campaign
from bench.systems.af_converter.dmm_method.estimates import DmmFit
from bench.systems.af_converter.estimators.dmm_method import Meter, by_range, reference_A_of
from bench.systems.af_converter.estimators.readings import GAIN, RangeSpecification
from bench.systems.af_converter.estimators.scale_factor import usable_rows
from bench.systems.af_converter.groups import Group
from bench.systems.af_converter.scale_factor.departures import PPM, LevelRows, words_of

# Standard, of a counter: one repeat does not tell; four times that stays below half the U of asymmetry.
_AGAIN_ppm = 0.5
Visit = tuple[Group, Meter]


def searched_rows(
    fits: Sequence[DmmFit], again: Sequence[Visit], entries: Estimates, campaign: Campaign,
    register: Mapping[float, RangeSpecification],
) -> Searched:  # fmt: skip
    """Return the search of the rows.

    ``again``: points that were taken again, with the readings beside their closed records.
    """
    rows = _rows_of(fits, again, campaign, register)
    residuals = rows.residuals(*rows.operators(entries))
    return Searched(search(residuals, departures_of(rows.labels())), words_of(rows.groups))


def _rows_of(
    fits: Sequence[DmmFit], again: Sequence[Visit], campaign: Campaign, register: Mapping[float, RangeSpecification]
) -> _Rows:
    known = {fitted.group.place[:2] for fitted in fits}
    visits = [(fitted.group, fitted.meter) for fitted in fits]
    visits += [(group, meter) for group, meter in again if group.place[:2] in known]
    of_visits, reference_A, std_A = [], [], []
    for group, meter in visits:
        usable = _usable(group, meter)
        rows, read = group.closed.take(usable), meter.take(usable)
        of_visits.append(replace(rows, range_A=read.range_A))
        reference_A.append(reference_A_of(rows, read, register))
        std_A.append(read.std_A)
    groups = [group for group, _ in visits]
    return _Rows(groups, of_visits, np.concatenate(reference_A), campaign, fits, register, np.concatenate(std_A))


def _usable(group: Group, meter: Meter) -> Flags:
    return usable_rows(group.closed) & np.isfinite(meter.current_A) & np.isfinite(meter.std_A)


@dataclass(frozen=True)
class _Rows(LevelRows):
    """Records against the meter. ``std_A`` (r,): of its readings beside each, by their scatter."""

    fits: Sequence[DmmFit]
    register: Mapping[float, RangeSpecification]
    std_A: Floats

    @cached_property
    def noise_A2(self) -> Floats:
        """Covariance of the readings, (r, r): those of a range have one scatter, as three tell it badly."""
        range_A, variance = self.column("range_A"), self.std_A**2
        of_range = {full_A: variance[range_A == full_A].mean() for full_A in np.unique(range_A).tolist()}
        return super().noise_A2 + np.diag([of_range[full_A] for full_A in range_A.tolist()])

    def free(self) -> list[Floats]:
        """Return what nobody knows: both counters and the leakage of each channel and temperature, the current of each
        visit.
        """
        places = [group.place[:2] for group in self.groups]
        polarity, driven = self.column("polarity"), self.column("level_A") > 0
        columns = [1.0 * (self.visit == at) for at in range(len(places))]
        for place in dict.fromkeys(places):
            here = np.array([place == other for other in places])[self.visit]
            columns += [side_A * here for side_A in self.sides_A]
            if not driven[here].all():  # zeros show the leakage; without them it is taken as negligible
                columns.append(polarity * here)
        return columns

    def held(self) -> list[Floats]:
        """Return one standard uncertainty of each error of the meter, its gains by range, and of what a counter may
        differ by when it is visited again.
        """
        errors, range_A = self.of_standard(self.register), self.column("range_A")
        gain_A = errors.pop(GAIN, np.zeros(self.visit.size))
        columns = [*errors.values(), *by_range(gain_A, range_A).T]
        for at in range(len(self.fits), len(self.groups)):
            columns += [PPM * _AGAIN_ppm * side_A * (self.visit == at) for side_A in self.sides_A]
        return columns

    def operators(self, entries: Estimates) -> tuple[Floats, list[Estimate]]:
        """Return what each estimate gains per ampere that is counted, (k, r), and those that follow from the rows."""
        of_place: dict[tuple[Any, ...], Floats] = {}
        for fitted, part in zip(self.fits, self.slices[: len(self.fits)], strict=True):
            usable = _usable(fitted.group, fitted.meter)
            for quantity, operator in fitted.fit.operators_ppm.items():
                whole = of_place[quantity, *fitted.group.place[:2]] = np.zeros(self.visit.size)
                whole[part] = -operator[usable]

        def operator_of(entry: Estimate) -> Floats | None:
            where = entry.conditions
            return of_place.get((entry.quantity, where.get("channel"), where.get("temperature_degC")))

        return operators_of(entries, operator_of, self.visit.size)
