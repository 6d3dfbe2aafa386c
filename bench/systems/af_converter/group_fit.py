"""Fit every group of a scale-factor campaign, refer the rows to one temperature, and fit the coefficients.

Groups that a campaign promises and that have no result are named with the reason.

What no converter channel can be: driven by the wrong polarity or none, on a clock that jumps, off by a tenth.

Each counter must be moved by the stimulus of its own polarity, both clocks of a unit keep their ratio, and a
scale-factor error must be one that a converter can have. Holds for every method that has levels of both polarities.
Source: docs/method-uncertainty.md.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from bench.analysis import Estimate, Evidence, estimate
from bench.maths.arrays import Flags, Floats
from bench.maths.least_squares import solve
from bench.maths.tests import chi2_tail
from bench.model.errors import FitError
from bench.systems.af_converter.constants import CLOCK_STEADY, Campaign, Standards
from bench.systems.af_converter.estimators.readings import (
    Bias,
    Converter,
    Readings,
    clock_ratio,
    open_input_bias,
    pulse_currents_A,
)
from bench.systems.af_converter.estimators.scale_factor import Referral, ScaleFactor, fit_scale_factor
from bench.systems.af_converter.groups import Group, Place, place_name, place_of
from bench.systems.af_converter.wording import say

_CHANCE = 0.05  # of what a polynomial leaves over: less is no noise, and the unit's own


@dataclass(frozen=True)
class TemperaturePolynomial:
    """value(T) = c0 + c1 (T - T_ref) + c2 (T - T_ref)^2, as far as the temperatures determine it.

    ``coefficients`` (d + 1,) in the unit of the values over degC^k; ``covariance`` (d + 1, d + 1) of the noise, or of
    what the polynomial leaves over where that is more, and of what the values share, of which ``effects`` (d + 1, j)
    are one sigma each. ``misfit`` (d + 1,): the first part, standard, with ``misfit_dof`` degrees of freedom; 0: noise.
    ``operator`` (d + 1, k) makes the coefficients of the values; ``residual`` (k,) value minus polynomial.
    Source: AF-converter paper section 3.3 (temperature coefficients); docs/method-af-converter.md.
    """

    reference_degC: float
    coefficients: Floats
    covariance: Floats
    operator: Floats
    effects: Floats
    residual: Floats
    misfit: Floats
    misfit_dof: float

    def slope(self, temperature_degC: float) -> float:
        """d value / dT at a temperature, unit of the values per degC."""
        powers = self.coefficients[1:] * np.arange(1, self.coefficients.size)
        return float(np.polynomial.polynomial.polyval(temperature_degC - self.reference_degC, powers))

    def slope_std(self, temperature_degC: float) -> float:
        """Return standard uncertainty of ``slope``, unit of the values per degC."""
        order = np.arange(1, self.coefficients.size)
        gradient = order * (temperature_degC - self.reference_degC) ** (order - 1)
        return float(np.sqrt(gradient @ self.covariance[1:, 1:] @ gradient))

    def std_uncertainty(self, order: int) -> float:
        """Return standard uncertainty of the coefficient of (T - T_ref)^order."""
        return float(np.sqrt(self.covariance[order, order]))


def fit_temperature(
    temperature_degC: Floats, values: Floats, covariance: Floats, shared: Floats, reference_degC: float
) -> TemperaturePolynomial | None:
    """Fit a polynomial of degree 2, or less if there are fewer than three temperatures.

    What the values share does not enter the weights: it is all but the same at every temperature, and the last digits
    in which it differs would be read as knowledge about it from any curvature that a parabola cannot follow.

    Args:    temperature_degC: measured unit temperatures, (k,).   values: (k,).   covariance: (k, k) of their noise.
             shared: (k, j) one-sigma effects of j independent errors that the values share.   reference_degC: T_ref.
    Returns: TemperaturePolynomial, or None for fewer than two temperatures.
    Raises:  FitError B-FIT-001 if the temperatures are not distinct.
    Source:  AF-converter paper section 3.3; docs/method-af-converter.md.
    """
    degree = min(2, values.size - 1)
    if degree < 1:
        return None
    design = np.vander(temperature_degC - reference_degC, degree + 1, increasing=True)
    names = [f"temperature coefficient {order}" for order in range(degree + 1)]
    fit = solve(design, values, covariance, names)
    effects = fit.operator @ shared
    fits = fit.dof == 0 or chi2_tail(fit.chi2, fit.dof) > _CHANCE
    own = fit.covariance if fits else fit.covariance * (fit.chi2 / fit.dof)
    return TemperaturePolynomial(
        reference_degC=reference_degC,
        coefficients=fit.parameters,
        covariance=own + effects @ effects.T,
        operator=fit.operator,
        effects=effects,
        residual=fit.residual,
        misfit=np.sqrt(np.diag(own)),
        misfit_dof=0.0 if fits else float(fit.dof),
    )


_FOLLOWS = 0.5  # of the level: a counter that moves less does not follow the stimulus
_NEARLY_ALL = 0.9
_PPM = 1e6


if TYPE_CHECKING:
    from bench.record import RecordRow
    from bench.systems.af_converter.estimators.dmm_method import DmmScaleFactor

QUANTITIES = ("dsf_n", "dsf_p")
SCALE_FACTORS = (*QUANTITIES, "dsf_asymmetry")
ODD = "unlike all others of its group"
UNKNOWN_SLOPE_ppm_degC = 100.0  # standard; larger than that of any converter, while nobody knows it
NO_CHANCE = 1e-9  # of a chi-square: something is wrong with the group
LIKELY = 1e-3  # of that of the others, if one row alone is wrong
_OF_ONE_GROUP = ("B-FIT-001", "B-FIT-005", "B-FIT-006", "B-FIT-012", "B-FIT-050")
Refused = list[tuple[Group, FitError]]
Fit = TypeVar("Fit")


@dataclass(frozen=True)
class GroupFit:
    """A group with its fitted scale-factor errors and, where the input was measured open, its bias."""

    group: Group
    fit: ScaleFactor
    bias: Bias | None


@dataclass(frozen=True)
class Fitted:
    """All groups that could be fitted, those that could not, and the polynomials by (quantity, channel)."""

    groups: tuple[GroupFit, ...]
    refused: tuple[tuple[Group, FitError], ...]
    polynomials: Mapping[tuple[str, int], TemperaturePolynomial]

    def slopes_ppm_degC(self, channel: int, temperature_degC: float) -> tuple[float, float]:
        """Return temperature coefficients (N, P) of a channel at a temperature; 0 where they are not known."""
        known = [self.polynomials.get((quantity, channel)) for quantity in QUANTITIES]
        slopes = [polynomial.slope(temperature_degC) if polynomial else 0.0 for polynomial in known]
        return slopes[0], slopes[1]

    def knows_slopes(self, channel: int) -> bool:
        """Return whether the campaign determines the temperature coefficients of a channel."""
        return all((quantity, channel) in self.polynomials for quantity in QUANTITIES)

    def guesses_slopes(self, channel: int) -> bool:
        """Return whether any coefficients may be: there is one temperature. Where visits do not fit, they say that."""
        return not self.knows_slopes(channel) and len(self.visits(channel)) < 2

    def referral(self, channel: int, temperature_degC: float) -> Referral:
        """Return how rows of a channel are referred to a temperature: by its coefficients, or by any that may be."""
        slopes = self.slopes_ppm_degC(channel, temperature_degC)
        return Referral(temperature_degC, slopes, UNKNOWN_SLOPE_ppm_degC if self.guesses_slopes(channel) else 0.0)

    def drift_ppm_s(self, standards: Standards) -> float:
        """Return standard uncertainty of a steady drift of the calibrator, ppm per second; 0 if nobody knows of one."""
        times_s = np.concatenate([visit.group.closed.time_s for visit in self.groups])
        return 1e6 * (standards.drift or 0.0) / max(float(np.ptp(times_s)), 1.0)

    @property
    def ranges_A(self) -> set[float]:
        """Ranges of the calibrator that were used."""
        return {float(range_A) for visit in self.groups for range_A in visit.group.closed.range_A}

    def visits(self, channel: int) -> list[GroupFit]:
        """Return first visits of a channel to its temperatures: what its polynomials are made of."""
        return first_visits(self.groups, channel)


def first_visits(groups: Iterable[GroupFit], channel: int) -> list[GroupFit]:
    """Return groups of a channel without its repeats."""
    return [visit for visit in groups if visit.group.channel == channel and visit.group.repeat == 0]


def fit_groups(groups: Iterable[Group], campaign: Campaign, standards: Standards, method: str) -> Fitted:
    """Fit twice: the first pass gives the temperature coefficients that refer each row to its group's mean temperature.

    Raises: FitError of the first group if no group can be fitted.
    """
    members = list(groups)
    first = _fit_pass(members, campaign, standards, method, None)
    if not first.groups:
        raise first.refused[0][1]
    return _fit_pass(members, campaign, standards, method, first)


def fit_each(groups: Iterable[Group], fit: Callable[[Group], Fit]) -> tuple[list[Fit], Refused]:
    """Fit groups one by one; return their fits, and those that are not determined with what refuses them.

    Raises: FitError of what is wrong with more than one group.
    """
    fits: list[Fit] = []
    refused: Refused = []
    for group in groups:
        try:
            fits.append(fit(group))
        except FitError as error:
            if error.code not in _OF_ONE_GROUP:
                raise
            error.where = place_name(group.place)
            refused.append((group, error))
    return fits, refused


def _fit_pass(
    groups: list[Group], campaign: Campaign, standards: Standards, method: str, earlier: Fitted | None
) -> Fitted:
    fitted, refused = fit_each(groups, lambda group: _fit_one(group, campaign, standards, method, earlier))
    referring = [visit for visit in fitted if _refers(visit, campaign)] if earlier is None else fitted
    return Fitted(tuple(fitted), tuple(refused), _polynomials(referring, campaign))


def _refers(visit: GroupFit, campaign: Campaign) -> bool:
    """Return whether other temperatures may be referred by a group: one that is plausible."""
    worst_ppm = float(np.abs(visit.fit.dsf_ppm).max())
    plausible = worst_ppm <= 1e6 * campaign.channel(visit.group.channel).plausible_error
    return plausible and clock_spread(visit.group, campaign) <= CLOCK_STEADY


def clock_spread(group: Group, campaign: Campaign) -> float:
    """Return the relative range of the clock ratio over the closed rows of a group, beyond that of whole pulses.

    Each end of a stretch cuts a pulse anywhere, so two steady records differ by two pulses at most for each stretch.
    """
    rows = group.closed
    cut = float(np.max(2.0 * (1.0 + rows.gaps) / np.maximum(rows.af_count, 1.0)))
    return max(0.0, float(np.ptp(clock_ratio(rows.af_count, rows.gate_s, campaign.af_clock_Hz))) - cut)


def probability_of(fit: ScaleFactor | DmmScaleFactor) -> float:
    """Return the probability of a chi-square at least as large; 1 where it says nothing."""
    return chi2_tail(fit.chi2, fit.dof) if np.isfinite(fit.chi2) else 1.0


def _fit_one(group: Group, campaign: Campaign, standards: Standards, method: str, earlier: Fitted | None) -> GroupFit:
    converter = campaign.converter(group.channel)
    require_closed(group)
    mean_degC = group.unit_temperature_degC
    referral = earlier.referral(group.channel, mean_degC) if earlier else Referral(mean_degC)
    fit = fit_scale_factor(group.closed, converter, standards.ranges, method, referral)
    wary = referral if earlier else replace(referral, slope_std_ppm_degC=UNKNOWN_SLOPE_ppm_degC)
    # A chi-square up to its mean is always possible.
    possible = not fit.chi2 > fit.dof or probability_of(fit) >= NO_CHANCE
    fits = possible or _fits(group.closed, converter, standards, wary, method, NO_CHANCE)
    odd = None if fits else _odd_row(group.closed, converter, standards, wary, method)
    if odd is not None:
        group = group.without(odd, ODD)
        fit = fit_scale_factor(group.closed, converter, standards.ranges, method, referral)
    bias = None
    if group.opened.gate_s.size:
        bias = open_input_bias(group.opened, converter, (float(fit.dsf_ppm[0]), float(fit.dsf_ppm[1])))
    return GroupFit(group, fit, bias)


def _fits(
    rows: Readings, converter: Converter, standards: Standards, referral: Referral, method: str, least: float
) -> bool:
    """Return whether rows are determined and their chi-square is more probable than ``least``."""
    try:
        return probability_of(fit_scale_factor(rows, converter, standards.ranges, method, referral)) > least
    except FitError:
        return False


def _odd_row(rows: Readings, converter: Converter, standards: Standards, referral: Referral, method: str) -> int | None:
    """Return the one row that is unlike all others: with it the rows cannot fit, without it they do.

    None if there are several such rows, and for the largest level of a polarity: there it may be the converter.
    """
    each = np.arange(rows.level_A.size)
    found = [
        row
        for row in each
        if rows.level_A[row] < rows.level_A[(rows.polarity == rows.polarity[row]) & (each != row)].max(initial=0.0)
        and _fits(rows.take(each != row), converter, standards, referral, method, LIKELY)
    ]
    return int(found[0]) if len(found) == 1 else None


def refit(
    visit: GroupFit, kept: Flags, fitted: Fitted, campaign: Campaign, standards: Standards, method: str
) -> ScaleFactor | None:
    """Return the fit of a group by those of its closed rows alone, None if they do not determine it."""
    referral = fitted.referral(visit.group.channel, visit.fit.unit_temperature_degC)
    converter = campaign.converter(visit.group.channel)
    try:
        return fit_scale_factor(visit.group.closed.take(kept), converter, standards.ranges, method, referral)
    except FitError:
        return None


def conditions_of(group: Group, unit_degC: float, campaign: Campaign) -> dict[str, Any]:
    """Return conditions of an estimate: nominal and measured temperature of a channel."""
    return {
        "channel": group.channel,
        "kind": campaign.channel(group.channel).kind,
        "temperature_degC": group.temperature_degC,
        "unit_temperature_degC": unit_degC,
    }


def quality_of(group: Group, fit: ScaleFactor | DmmScaleFactor, campaign: Campaign) -> dict[str, Any]:
    """Return how well a group fits, as results.json has it."""
    return conditions_of(group, fit.unit_temperature_degC, campaign) | {
        "repeat": group.repeat,
        "reduced_chi2": fit.chi2 / fit.dof if fit.dof else float("nan"),
        "dof": fit.dof,
        "n": fit.n,
        "dropped": group.dropped + fit.dropped,
    }


def bias_estimate(group: Group, unit_degC: float, bias: Bias, std_A: float, campaign: Campaign) -> Estimate:
    """Return the bias of the open records of a group whose closed ones were at ``unit_degC``."""
    conditions = conditions_of(group, unit_degC, campaign) | {"unit_temperature_degC": bias.unit_temperature_degC}
    rows = group.opened.gate_s.size
    return estimate("bias", "A", bias.value_A, std_A, conditions, n=rows, dropped=group.open_planned - rows)


def left_out_notes(groups: Iterable[Group]) -> list[str]:
    """Return a note on each reason for which records were left out."""
    left_out: Counter[str] = Counter()
    for group in groups:
        left_out.update(group.left_out)
    return [say("note.left_out", count=count, reason=reason) for reason, count in sorted(left_out.items())]


def require_closed(group: Group) -> None:
    """Raise FitError B-FIT-012 for a group of which no record with the route closed may enter the fit."""
    if not group.closed.gate_s.size:
        raise FitError(
            "B-FIT-012",
            f"no record with the route closed may enter the fit (left out: {reasons(group)})",
            next_step="see the quality of the records in the report; take the group again",
        )


def reasons(group: Group) -> str:
    """Return why records of a group were left out, in words."""
    return ", ".join(f"{count} {reason}" for reason, count in sorted(group.left_out.items())) or "none: none was taken"


def _polynomials(fitted: list[GroupFit], campaign: Campaign) -> dict[tuple[str, int], TemperaturePolynomial]:
    polynomials: dict[tuple[str, int], TemperaturePolynomial] = {}
    for channel in sorted({visit.group.channel for visit in fitted}):
        visits = first_visits(fitted, channel)
        for index, quantity in enumerate(QUANTITIES):
            polynomial = fit_temperature(
                np.array([visit.fit.unit_temperature_degC for visit in visits]),
                np.array([visit.fit.dsf_ppm[index] for visit in visits]),
                np.diag([visit.fit.noise_ppm2[index, index] for visit in visits]),
                shared_ppm(visits, index),
                campaign.reference_temperature_degC,
            )
            if polynomial is not None:
                polynomials[quantity, channel] = polynomial
        with_bias = [visit for visit in visits if visit.bias is not None]
        walk_A_rth = campaign.channel(channel).noise.walk_A_rth
        polynomial = _bias_polynomial(with_bias, walk_A_rth, campaign.reference_temperature_degC)
        if polynomial is not None:
            polynomials["bias", channel] = polynomial
    return polynomials


def standard_labels(visits: Iterable[GroupFit]) -> list[str]:
    """Return the labels of all errors of the calibrator, in the order of ``TemperaturePolynomial.effects``."""
    return sorted({label for visit in visits for label in visit.fit.standard_ppm})


def shared_ppm(visits: Sequence[GroupFit], index: int) -> Floats:
    """Return what one sigma of each error of the calibrator makes of DSF_N or DSF_P, (k, j) by ``standard_labels``."""
    labels, nothing = standard_labels(visits), np.zeros(2)
    return np.array([[visit.fit.standard_ppm.get(label, nothing)[index] for label in labels] for visit in visits])


def _bias_polynomial(visits: list[GroupFit], walk_A_rth: float, reference_degC: float) -> TemperaturePolynomial | None:
    """Bias against temperature; the random walk between the visits is part of the covariance."""
    biases = [visit.bias for visit in visits if visit.bias is not None]
    hours = np.array([visit.group.opened.time_s[0] / 3600.0 for visit in visits])
    walk = walk_A_rth**2 * np.minimum.outer(hours - hours.min(initial=0), hours - hours.min(initial=0))
    return fit_temperature(
        np.array([bias.unit_temperature_degC for bias in biases]),
        np.array([bias.value_A for bias in biases]),
        np.diag([bias.std_uncertainty_A**2 for bias in biases]) + walk,
        np.zeros((len(biases), 0)),
        reference_degC,
    )


def missing_groups(
    rows: Iterable[RecordRow],
    done: Collection[Place],
    refused: Iterable[tuple[Group, FitError]],
    campaign: Campaign,
) -> list[str]:
    """Return every promised channel and temperature without scale-factor errors, with the reason; one sentence each.

    Promised are all places the records name, and every declared channel at every temperature any record names.
    A channel without any record is named once.
    """
    taken = {place_of(row.window.conditions): None for row in rows}
    reason = {group.place: f"{error.message} ({error.code}){_left_out(group)}" for group, error in refused}
    recorded = {channel for channel, _, _ in taken}
    places: dict[Place, None] = dict(taken)
    for temperature_degC in dict.fromkeys(at for _, at, _ in taken):
        places |= {
            (channel.number, temperature_degC, 0): None for channel in campaign.channels if channel.number in recorded
        }
    missing = [
        say("missing", place=place_name(place), reason=reason.get(place, say("missing.no_record")))
        for place in sorted(places)
        if place not in done
    ]
    return missing + [
        say("missing.channel", channel=channel.number)
        for channel in campaign.channels
        if channel.number not in recorded
    ]


def _left_out(group: Group) -> str:
    return f"; left out: {reasons(group)}" if group.left_out and group.closed.gate_s.size else ""


def about(group: Group) -> dict[str, float]:
    """Return conditions of the estimates that a group gives."""
    return {"channel": group.channel, "temperature_degC": group.temperature_degC}


def plausible(group: Group, dsf_ppm: Floats, campaign: Campaign) -> Iterator[Evidence]:
    """Yield what cannot be: a counter that follows the other polarity or none, an error beyond the declared bound.

    ``dsf_ppm``: scale-factor errors that the group gave, of either counter or their mean.
    """
    where = place_name(group.place)
    follows = _followed(group, campaign)
    against, beside = float(np.mean(follows < -_FOLLOWS)), float(np.mean(follows <= _FOLLOWS))
    if against > _NEARLY_ALL:
        sentence = say("evidence.swapped", place=where, share=100 * against)
        yield _refusal("swapped_leads", sentence, against, group)
    elif beside > 0.0:
        sentence = say("evidence.not_followed", place=where, share=100 * beside)
        yield _refusal("stimulus_not_followed", sentence, beside, group)
    elif (spread := clock_spread(group, campaign)) > CLOCK_STEADY:
        sentence = say("evidence.clocks", place=where, spread=_PPM * spread)
        yield Evidence(
            "clock_unsteady", sentence, _PPM * spread, 0.0, math.inf, (*SCALE_FACTORS, "dsf_mean"), about(group)
        )
    else:
        bound_ppm = _PPM * campaign.channel(group.channel).plausible_error
        worst_ppm = float(np.abs(dsf_ppm).max())
        if worst_ppm > bound_ppm:
            sentence = say("evidence.implausible", place=where, worst=worst_ppm, bound=bound_ppm)
            yield _refusal("implausible_scale_factor", sentence, worst_ppm, group)


def _followed(group: Group, campaign: Campaign) -> Floats:
    """Return what each level drives beyond the zeros, (l,), relative to it: 1 for its own counter, -1 for the other.

    A level that is no larger than the bias of the converter drives no less than the others, once the bias is off.
    """
    rows = group.closed
    n_A, p_A = pulse_currents_A(rows, campaign.converter(group.channel))
    levels, driven_A = rows.level_A > 0, n_A - p_A
    bias_A = float(driven_A[~levels].mean()) if not levels.all() else 0.0
    return (rows.polarity * (driven_A - bias_A))[levels] / rows.level_A[levels]


def _refusal(code: str, sentence: str, figure: float, group: Group) -> Evidence:
    return Evidence(
        code,
        sentence,
        figure,
        0.0,
        quantities=(*SCALE_FACTORS, "dsf_mean", "bias"),
        conditions=about(group),
        refuses=True,
    )
