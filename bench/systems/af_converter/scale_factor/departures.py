"""What the data of a scale-factor campaign say against its model: all visits of all channels as rows of one fit.

Readings are counted currents, and what the halves of records differ by. Free are the coefficients of both counters, an
offset of each polarity of each visit, and, as far as their priors go, errors of the calibrator and its drift. Beside
them stands what no converter can be, and counts that go in steps of several pulses.
Source: docs/method-af-converter.md (model), method-uncertainty.md (doubt, departures).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np

from bench.analysis import (
    Departure,
    Estimate,
    Estimates,
    Evidence,
    Labels,
    Material,
    Residuals,
    Searched,
    Words,
    departures_of,
    operators_of,
    search,
)
from bench.maths.arrays import Flags, Floats, Integers
from bench.maths.tests import of_many
from bench.maths.verdict import coverage_factor
from bench.systems.af_converter.constants import CALIBRATOR, BETWEEN_VISITS_ppm, Campaign, Standards, expired
from bench.systems.af_converter.estimators.readings import (
    QUANTISATION,
    RangeSpecification,
    Readings,
    calibrator_effects,
    count_step,
    halves_A2,
    noise_parts,
    pulse_currents_A,
    relative_errors,
)
from bench.systems.af_converter.estimators.scale_factor import reference_current_A, usable_rows
from bench.systems.af_converter.group_fit import (
    QUANTITIES,
    SCALE_FACTORS,
    Fitted,
    GroupFit,
    UNKNOWN_SLOPE_ppm_degC,
    about,
    plausible,
)
from bench.systems.af_converter.groups import Group, Place, place_name
from bench.systems.af_converter.wording import kind_name, say

PPM, _nA = 1e-6, 1e-9
_OWN = 4.0  # of the limit of residuals, at the temperature farthest from that of reference: it leaves a third
_DEGREE = 2
_TAILS = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2)  # time constants, in lengths of a record
_RANK = 1e-9
SHARE = 0.5  # of the chance of a false doubt: the other half is that of counts and of odd records


def judged(
    fitted: Fitted, entries: Estimates, campaign: Campaign, standards: Standards, material: Material
) -> tuple[list[Evidence], Searched]:
    """Return what every check says of the estimates, those that found nothing included, and the search."""
    rows, departures = residuals_of(fitted, entries, campaign, standards)
    groups = [visit.group for visit in fitted.groups]
    searched = Searched(search(rows, departures, SHARE), words_of(groups))
    heard = [
        *(seen for visit in fitted.groups for seen in plausible(visit.group, visit.fit.dsf_ppm, campaign)),
        *(_whole_counts(visit) for visit in fitted.groups),
        *searched.evidence,
        _odd_alike(fitted, campaign, searched.words),
        *expired(material, CALIBRATOR, fitted.ranges_A, SCALE_FACTORS),
    ]
    return heard, searched


def _whole_counts(visit: GroupFit) -> Evidence:
    """Return whether the counts of a visit are single pulses, or go in steps of several of them.

    A step of g moves each reading by as much of a pulse as chance does by one: standard deviation g / sqrt(12).
    """
    fit, rows = visit.fit, visit.group.closed
    counts, levels_A = np.concatenate([rows.n_count, rows.p_count]), np.unique([0.0, *rows.level_A])
    step, probability = count_step(counts, counts.max() * np.diff(levels_A).min() / levels_A[-1])
    contrast = np.array([1.0, -1.0])
    std_ppm = np.sqrt([*np.diag(fit.covariance_ppm2), contrast @ fit.covariance_ppm2 @ contrast])
    of_one_ppm = fit.parts_ppm[QUANTISATION] * np.sqrt(6.0 / 12.0)
    move = step * float(np.max([*of_one_ppm, np.hypot(*of_one_ppm)] / std_ppm))
    sentence = say("evidence.steps", place=place_name(visit.group.place), step=step, move=move)
    chance = of_many(probability, 2)
    return Evidence("counts_in_steps", sentence, float(step), chance, move, SCALE_FACTORS, about(visit.group))


def _odd_alike(fitted: Fitted, campaign: Campaign, words: Words) -> Evidence:
    """Return whether records that were left out, each as the one odd one of its visit, have a label in common.

    Source: binomial distribution of those at one label, the union bound over the labels.
    """
    from scipy import special

    odd = [_labelled(visit.group, rows, campaign) for visit in fitted.groups for rows in visit.group.odd]
    used = [_labelled(visit.group, visit.group.closed, campaign) for visit in fitted.groups]
    found: list[tuple[float, str, Any, int]] = [(1.0, "level", 0.0, 0)]
    for label in used[0] if odd else ():
        of_odd, of_used = (np.concatenate([labels[label] for labels in rows]) for rows in (odd, used))
        for value in dict.fromkeys(of_odd.tolist()):
            here, others = int(np.sum(of_odd == value)), int(np.sum(of_used == value))
            share = (here + others) / (of_odd.size + of_used.size)
            found.append((float(special.bdtrc(here - 1, of_odd.size, share)), label, value, here))
    chance, label, value, here = min(found)
    sentence = say("evidence.odd_alike", count=here, odd=len(odd), where=words(label, value) if here else "")
    return Evidence("odd_alike", sentence, float(here), of_many(chance, 2 * len(found)), quantities=SCALE_FACTORS)


def _labelled(group: Group, rows: Readings, campaign: Campaign) -> dict[str, Any]:
    """Return the labels of records of a visit, (m,) each."""
    channel, count = campaign.channel(group.channel), rows.level_A.size
    of_visit = {"channel": channel.number, "kind": channel.kind, "temperature": group.temperature_degC}
    whole = {name: np.full(count, value) for name, value in of_visit.items()}
    return {**whole, "polarity": rows.polarity, "level": rows.level_A, "range": rows.range_A}


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
        if label == "after":
            return say("departs.behind_current" if value else "departs.behind_zero")
        shown = {"level": 1e3 * value, "range": 1e3 * value, "place": value + 1}
        return say(f"departs.{label}", value=shown.get(label, value))

    return words


def residuals_of(
    fitted: Fitted, entries: Estimates, campaign: Campaign, standards: Standards
) -> tuple[Residuals, list[Departure]]:
    """Return the rows of a campaign, and what could be true instead."""
    rows = _rows_of(fitted, campaign, standards)
    labels = rows.labels()
    halves = _Halves(rows, labels)
    operator, stated = rows.operators(entries)
    noise = rows.noise_of(operator)
    residuals = rows.residuals(
        operator,
        stated,
        beside=halves.white,
        scatter=np.column_stack(list(rows.scatter())),
        expanded=np.array([_expanded(entry, fitted, one) for entry, one in zip(stated, noise, strict=True)]),
        on_curve=np.array(["_tc" in entry.quantity for entry in stated]),
        rest=halves.rest,
    )
    return residuals, [*departures_of(labels), *halves.tails]


def _expanded(entry: Estimate, fitted: Fitted, noise: float) -> float:
    """Return the expanded uncertainty of an estimate before what its curve leaves over widens it."""
    quantity, _, order = entry.quantity.rpartition("_tc")
    polynomial = fitted.polynomials.get((quantity, entry.conditions.get("channel", 0)))
    if polynomial is None or not polynomial.misfit_dof:
        return float(entry.expanded_uncertainty)
    return float(coverage_factor() * np.sqrt(entry.std_uncertainty**2 - polynomial.misfit[int(order)] ** 2 + noise**2))


class _Halves:
    """What the first halves of records differ by from the second ones, as rows beside the records.

    A change of the current may leave a tail, which halves tell from other currents. ``white`` (q,): the differences
    along all that ``tails`` make of them, in units of their noise; ``rest``: chi-square of what no tail makes, and its
    degrees of freedom.
    """

    def __init__(self, rows: _Rows, labels: Labels) -> None:
        known, white, std_A = rows.halves()
        tails = list(self._tails(rows, labels))
        made = np.column_stack([halves_A[known] / std_A for _, _, halves_A, _ in tails])
        axes, size, _ = np.linalg.svd(made, full_matrices=False)
        axes = axes[:, size > _RANK * size.max(initial=0.0)]
        self.white = axes.T @ white
        self.rest = float(white @ white - self.white @ self.white), white.size - self.white.size
        self.tails = [
            Departure("current", shape, "ppm", whole_A[:, None], about, beside=axes.T @ one)
            for (shape, whole_A, _, about), one in zip(tails, made.T, strict=True)
        ]

    @staticmethod
    def _tails(rows: _Rows, labels: Labels) -> Iterator[tuple[str, Floats, Floats, dict[str, Any]]]:
        """Yield what a tail of 1 ppm adds to records and to differences of their halves, (r,) each.

        It is of the change from the record before, or of switching on where the current goes through zero.
        """
        gate_s, sizes_A = rows.column("gate_s"), {"tail": PPM * rows.change_A, "onset": PPM * rows.reference_A}
        for share in _TAILS:
            early = 2.0 * share * (1.0 - np.exp(-0.5 / share))
            late = early * np.exp(-0.5 / share)
            for name in ("", *labels.kinds):
                kind = labels.kinds.get(name, np.zeros(gate_s.size))
                for value, (shape, size_A) in product(np.unique(kind).tolist(), sizes_A.items()):
                    inside_A = size_A * (kind == value)
                    about = {"seconds": share * float(gate_s.mean())} | ({name: value} if name else {})
                    yield shape, inside_A * (early + late) / 2.0, inside_A * (early - late), about


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

    @cached_property
    def noise_A2(self) -> Floats:
        """Covariance of what is counted, (r, r): that of each visit."""
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

    def free(self) -> list[Floats]:
        """Return what nobody knows, (r,) each."""
        raise NotImplementedError

    def held(self) -> list[Floats]:
        """Return one standard uncertainty of what is known as far as that, (r,) each."""
        raise NotImplementedError

    def noise_of(self, operator: Floats) -> Floats:
        """Return the standard deviation by the noise, (k,), of what gains so much per ampere of each row, (k, r)."""
        return np.asarray(np.sqrt(np.einsum("ki,ij,kj->k", operator, self.noise_A2, operator)))

    def residuals(self, operator: Floats, stated: Sequence[Estimate], **about: Any) -> Residuals:
        """Return the rows for a search, what is held behind the readings; ``about``: as ``Residuals.of``."""
        factor, held = np.linalg.inv(np.linalg.cholesky(self.noise_A2)), self.held()
        return Residuals.of(
            readings=self.counted_A,
            error=self.counted_A - self.reference_A,
            free=np.column_stack([*self.free(), *held]),
            std=np.ones(len(held)),
            whiten=lambda columns: factor @ columns,
            operator=operator,
            stated=stated,
            noise=coverage_factor() * self.noise_of(operator),
            **about,
        )

    def labels(self) -> Labels:
        """Return the labels of the readings."""
        labelled = [
            _labelled(group, rows, self.campaign) for group, rows in zip(self.groups, self.of_visits, strict=True)
        ]
        kinds = {name: np.concatenate([labels[name] for labels in labelled]) for name in labelled[0]}
        kinds["place"] = np.concatenate([np.arange(rows.level_A.size) for rows in self.of_visits])
        kinds["after"] = np.sign(np.abs(self.before_A))
        full_A = np.array([self.campaign.channel(number).full_scale_A for number in self.channel.tolist()])
        warmest_degC = max(float(np.abs(self.rest_degC).max()), 1.0)
        own_ppm = _OWN * max(channel.stability_limit_ppm or np.inf for channel in self.campaign.channels)
        return Labels(
            kinds=kinds,
            hours=self.column("time_s") / 3600.0,
            visit=self.visit,
            scales={
                "temperature": (self.rest_degC / warmest_degC, (3, 4)),
                "level": (np.abs(self.counted_A) * (self.column("level_A") > 0.0) / full_A, (1, 2, 3)),
                "before": (1e3 * self.before_A, (1,)),
            },
            carriers={"gain": ("ppm", PPM * self.current_A), "current": ("nA", np.full(self.visit.size, _nA))},
            scopes=[
                *((), ("kind",), ("channel",), ("polarity",), ("kind", "polarity"), ("channel", "polarity")),
                *(("after",), ("after", "polarity")),
            ],
            corners=[("channel", "temperature")],
            exchanged=("channel", "kind", "polarity", "gain"),
            own={("gain", "temperature"): own_ppm},
        )


def _rows_of(fitted: Fitted, campaign: Campaign, standards: Standards) -> _Rows:
    of_visits = [visit.group.closed.take(usable_rows(visit.group.closed)) for visit in fitted.groups]
    reference_A = np.concatenate([reference_current_A(rows, standards.ranges) for rows in of_visits])
    return _Rows([visit.group for visit in fitted.groups], of_visits, reference_A, campaign, fitted, standards)


@dataclass(frozen=True)
class _Rows(LevelRows):
    """Records against the calibrator."""

    fitted: Fitted
    standards: Standards

    @property
    def current_A(self) -> Floats:
        """Current by the curves of the counters: what changes by a part if a count is off by that part."""
        current_A = self.counted_A
        for (quantity, number), curve in self.fitted.polynomials.items():
            if quantity in QUANTITIES:
                side_A = self.sides_A[QUANTITIES.index(quantity)] * (self.channel == number)
                current_A = current_A + PPM * side_A * np.polynomial.polynomial.polyval(
                    self.rest_degC, curve.coefficients
                )
        return current_A

    @property
    def change_A(self) -> Floats:
        """By what the current changed before each record."""
        return self.reference_A - self.before_A

    def halves(self) -> tuple[Flags, Floats, Floats]:
        """Return which records have halves that are known, (r,), how much more current the first ones have, in units of
        its noise, and that noise, ampere.
        """
        halves_A, std_A = [], []
        for group, rows in zip(self.groups, self.of_visits, strict=True):
            converter = self.campaign.converter(group.channel)
            halves_A.append(converter.k0_C * converter.af_clock_Hz * rows.halves)
            std_A.append(np.sqrt(halves_A2(rows, converter)))
        more_A, noise_A = np.concatenate(halves_A), np.concatenate(std_A)
        known = np.isfinite(more_A)
        return known, more_A[known] / noise_A[known], noise_A[known]

    def free(self) -> list[Floats]:
        """Return what nobody knows: coefficients of the counters, offsets of the polarities of each visit."""
        polarity = self.column("polarity")
        columns = [
            counted_A * (self.channel == number) * (PPM * self.rest_degC**order)
            for number in dict.fromkeys(self.channel.tolist())
            for counted_A in self.sides_A
            for order in range(self._degree(number) + 1)
        ]
        visits = range(len(self.slices))
        return columns + [1.0 * ((self.visit == at) & (polarity == sign)) for at in visits for sign in (1, -1)]

    def _degree(self, number: int) -> int:
        temperatures = {visit.group.temperature_degC for visit in self.fitted.visits(number)}
        return min(_DEGREE, max(len(temperatures) - 1, 0))

    def held(self) -> list[Floats]:
        """Return one standard uncertainty of what is known as far as that: errors and drift of the calibrator, slopes
        of counters at one temperature.
        """
        columns = list(self.of_standard(self.standards.ranges).values())
        if self.standards.drift:
            time_s = self.column("time_s")
            since = (time_s - time_s.mean()) / max(float(np.ptp(time_s)), 1.0)
            columns.append(self.reference_A * self.standards.drift * since)
        for number in dict.fromkeys(self.channel.tolist()):
            if not self._degree(number):
                mine, slope = self.channel == number, PPM * UNKNOWN_SLOPE_ppm_degC
                away_degC = mine * (self.rest_degC - self.rest_degC[mine].mean())
                columns += [slope * away_degC * counted_A for counted_A in self.sides_A]
        return columns

    def scatter(self) -> Iterator[Floats]:
        """Yield what each counter may differ by in each visit."""
        for at in range(len(self.slices)):
            yield from (PPM * BETWEEN_VISITS_ppm * counted_A * (self.visit == at) for counted_A in self.sides_A)

    def operators(self, entries: Estimates) -> tuple[Floats, list[Estimate]]:
        """Return what each estimate gains per ampere that is counted, (k, r), and those that follow from the rows."""
        alone: dict[Place, Floats] = {}
        for visit, part in zip(self.fitted.groups, self.slices, strict=True):
            whole = np.zeros((2, self.visit.size))
            whole[:, part] = -visit.fit.operator_ppm[:, usable_rows(visit.group.closed)]
            alone[visit.group.place] = whole
        of_visit = {
            visit.group.place: alone[visit.group.place] - self._referred(visit, alone) for visit in self.fitted.groups
        }
        known = [entry for entry in entries if entry.expanded_uncertainty]
        return operators_of(known, lambda entry: self._operator(entry, of_visit), self.visit.size)

    def _referred(self, visit: GroupFit, alone: Mapping[Place, Floats]) -> Floats:
        """Return what a row changes in a visit, (2, r), by the slopes that refer its rows to one temperature."""
        number, at_degC = visit.group.channel, visit.fit.unit_temperature_degC
        if not self.fitted.knows_slopes(number):
            return np.zeros_like(alone[visit.group.place])
        slopes = []
        for index, quantity in enumerate(QUANTITIES):
            polynomial = self.fitted.polynomials[quantity, number]
            order = np.arange(1, polynomial.coefficients.size)
            values = np.array([alone[one.group.place][index] for one in self.fitted.visits(number)])
            at = order * (at_degC - polynomial.reference_degC) ** (order - 1)
            slopes.append(at @ polynomial.operator[1:] @ values)
        return np.asarray(visit.fit.unreferred_degC @ np.array(slopes))

    def _operator(self, entry: Estimate, of_visit: Mapping[Place, Floats]) -> Floats | None:
        """Return what an estimate gains per ampere of each row, (r,); None of one that does not follow from rows."""
        name, where = entry.quantity, entry.conditions
        index = next((at for at, quantity in enumerate(QUANTITIES) if name.startswith(quantity)), None)
        number, at_degC = where.get("channel", 0), where.get("temperature_degC", 0.0)
        if name == "dsf_asymmetry":
            return np.asarray(of_visit[number, at_degC, 0][0] - of_visit[number, at_degC, 0][1])
        if index is None or (name != QUANTITIES[index] and name.endswith("_change")):
            return None
        if "_tc" not in name and not name.endswith("_residual"):
            first, again = (of_visit[number, at_degC, repeat][index] for repeat in (0, where.get("repeat", 0)))
            return np.asarray(again - first if name.endswith("_drift") else first)
        polynomial, visits = self.fitted.polynomials[QUANTITIES[index], number], self.fitted.visits(number)
        values = np.array([of_visit[visit.group.place][index] for visit in visits])
        if "_tc" in name:
            return np.asarray(polynomial.operator[int(name[-1])] @ values)
        warmth_degC = np.array([visit.fit.unit_temperature_degC for visit in visits]) - polynomial.reference_degC
        left = values - np.vander(warmth_degC, polynomial.coefficients.size, increasing=True) @ (
            polynomial.operator @ values
        )
        return np.asarray(left[[visit.group.temperature_degC for visit in visits].index(at_degC)])
