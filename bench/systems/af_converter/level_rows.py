"""Closed records of all visits as the rows of one search: labels, noise, and what is known of a standard.

Whichever standard is used, records differ by channel, level, polarity, range, temperature and time, and whatever is
wrong with what is counted or with a current into the input is a departure.
Source: docs/decisions/0052-departures.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from bench.analysis import Labels, Words
from bench.maths.arrays import Floats, Integers
from bench.systems.af_converter.constants import Campaign
from bench.systems.af_converter.estimators.readings import (
    RangeSpecification,
    Readings,
    calibrator_effects,
    noise_parts,
    pulse_currents_A,
    relative_errors,
)
from bench.systems.af_converter.groups import Group, place_name
from bench.systems.af_converter.wording import kind_name, say

PPM, nA = 1e-6, 1e-9
_OWN = 4.0  # of the limit of residuals, at the temperature farthest from that of reference: it leaves a third


def words_of(groups: Sequence[Group]) -> Words:
    """Return how a person names the labels of a campaign."""
    names = [place_name(group.place) for group in groups]

    def words(label: str, value: Any) -> str:
        if value is None:
            return say(f"departs.of.{label}")
        if label == "visit":
            return names[int(value)]
        if label == "kind":
            return say("departs.kind", kind=kind_name(value))
        if label == "polarity":
            return say("departs.positive" if value > 0 else "departs.negative")
        shown = {"level": 1e3 * value, "range": 1e3 * value, "place": value + 1}
        return say(f"departs.{label}", value=shown.get(label, value))

    return words


@dataclass(frozen=True)
class LevelRows:
    """The usable closed records of all visits, (r,), one visit behind the other.

    ``of_visits``: the rows of each visit, on the ranges of the standard.   ``reference_A``: signed current that the
    standard is believed to deliver.
    """

    groups: Sequence[Group]
    of_visits: Sequence[Readings]
    reference_A: Floats
    campaign: Campaign

    @cached_property
    def slices(self) -> list[slice]:
        """Where the rows of each visit stand."""
        stop = np.cumsum([rows.level_A.size for rows in self.of_visits]).tolist()
        return [slice(end - rows.level_A.size, end) for rows, end in zip(self.of_visits, stop, strict=True)]

    @cached_property
    def visit(self) -> Integers:
        """Number of the visit of each row."""
        return np.repeat(np.arange(len(self.slices)), [rows.level_A.size for rows in self.of_visits])

    @cached_property
    def channel(self) -> Integers:
        """Channel of each row."""
        return np.array([group.channel for group in self.groups])[self.visit]

    @cached_property
    def sides_A(self) -> tuple[Floats, Floats]:
        """Current that each counter counts, the second one negative."""
        pairs = [
            pulse_currents_A(rows, self.campaign.converter(group.channel))
            for group, rows in zip(self.groups, self.of_visits, strict=True)
        ]
        n_A, p_A = (np.concatenate(side) for side in zip(*pairs, strict=True))
        return n_A, -p_A

    @property
    def counted_A(self) -> Floats:
        """Current that is counted, signed."""
        return self.sides_A[0] + self.sides_A[1]

    @property
    def current_A(self) -> Floats:
        """Current that changes by a part if a count is off by that part."""
        return self.counted_A

    def column(self, name: str) -> Floats:
        """Return a column of the rows."""
        return np.concatenate([getattr(rows, name) for rows in self.of_visits])

    @property
    def rest_degC(self) -> Floats:
        """Temperature of the unit above that of reference."""
        return self.column("unit_temperature_degC") - self.campaign.reference_temperature_degC

    @cached_property
    def before_A(self) -> Floats:
        """Current of the record before, 0 where a visit begins."""
        return np.concatenate([np.append(0.0, self.reference_A[part][:-1]) for part in self.slices])

    def noise_A2(self) -> Floats:
        """Return the covariance of what is counted, (r, r): that of each visit."""
        covariance = np.zeros((self.visit.size,) * 2)
        for group, rows, part in zip(self.groups, self.of_visits, self.slices, strict=True):
            parts = noise_parts(rows, self.campaign.converter(group.channel))
            covariance[part, part] = np.sum(list(parts.values()), axis=0)
        return covariance

    def of_standard(self, register: Mapping[float, RangeSpecification]) -> dict[str, Floats]:
        """Return one standard uncertainty of each error of the standard, (r,) by label."""
        columns: dict[str, Floats] = {}
        for rows, part in zip(self.of_visits, self.slices, strict=True):
            effects = calibrator_effects(rows, register)
            for label, effect in zip(effects.labels, effects.matrix.T, strict=True):
                columns.setdefault(label, np.zeros(self.visit.size))[part] = effect
        relative = relative_errors(self.column("range_A"), register)
        return columns | {label: self.reference_A * part for label, part in relative.items()}

    def whitened(
        self, noise_A2: Floats, free: Sequence[Floats], held: Sequence[Floats], more: int = 0
    ) -> tuple[Callable[[Floats], Floats], Floats, Floats]:
        """Return what whitens columns of readings, residuals and design of the rows.

        What is ``held`` has a row of its own behind the readings; ``more`` rows stand behind these.
        """
        factor = np.linalg.inv(np.linalg.cholesky(noise_A2))

        def whiten(columns: Floats) -> Floats:
            return np.vstack([factor @ columns, np.zeros((len(held) + more, columns.shape[1]))])

        design = whiten(np.column_stack([*free, *held]))
        design[len(factor) : len(factor) + len(held), len(free) :] = np.eye(len(held))
        return whiten, whiten((self.counted_A - self.reference_A)[:, None])[:, 0], design

    def labels(self) -> Labels:
        """Return the labels of the readings."""
        of_channel = {channel.number: channel for channel in self.campaign.channels}
        channels = [of_channel[number] for number in self.channel.tolist()]
        warmest_degC = max(float(np.abs(self.rest_degC).max()), 1.0)
        level_A = self.column("level_A")
        own_ppm = _OWN * max(channel.stability_limit_ppm or np.inf for channel in self.campaign.channels)
        return Labels(
            kinds={
                "channel": self.channel,
                "kind": np.array([channel.kind for channel in channels]),
                "polarity": self.column("polarity"),
                "level": level_A,
                "range": self.column("range_A"),
                "place": np.concatenate([np.arange(rows.level_A.size) for rows in self.of_visits]),
                "temperature": np.array([group.temperature_degC for group in self.groups])[self.visit],
            },
            hours=self.column("time_s") / 3600.0,
            visit=self.visit,
            scales={
                "temperature": (self.rest_degC / warmest_degC, (3, 4)),
                "level": (level_A / np.array([channel.full_scale_A for channel in channels]), (1, 2, 3)),
                "before": (1e3 * self.before_A, (1,)),
            },
            carriers={"gain": ("ppm", PPM * self.current_A), "current": ("nA", np.full(self.visit.size, nA))},
            scopes=[(), ("kind",), ("channel",), ("polarity",), ("kind", "polarity"), ("channel", "polarity")],
            corners=[("channel", "temperature")],
            exchanged=("channel", "kind", "polarity", "gain"),
            own={("gain", f"temperature ^{power}"): own_ppm for power in (3, 4)},
        )
