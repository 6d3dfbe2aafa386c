"""Estimates of a scale-factor campaign: scale-factor errors, asymmetry, bias and clocks, and those that have a verdict.

Table 1 of the paper states stability, so it judges what compensation leaves over and what changed since the calibration
before; a scale-factor error itself has no limit.

Determines fits, drift of the calibrator and estimates from the records of a scale-factor campaign.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.analysis import (
    Common,
    Document,
    Estimate,
    Estimates,
    Material,
    count_problem,
    covariance_by_standards,
    estimate,
    sharing,
)
from bench.maths.arrays import Floats
from bench.maths.budget import effective_dof
from bench.maths.verdict import coverage_factor
from bench.systems.af_converter.coefficients import UNITS, per_degC
from bench.systems.af_converter.constants import (
    CALIBRATOR,
    FREQUENCY,
    FUNCTION_GENERATOR,
    Campaign,
    Register,
    Standards,
    common_errors,
    read_campaign,
    read_standards,
)
from bench.systems.af_converter.estimators.readings import clock_ratio, count_noise, master_clock_error, scatter_A2
from bench.systems.af_converter.group_fit import (
    QUANTITIES,
    Fitted,
    GroupFit,
    TemperaturePolynomial,
    bias_estimate,
    conditions_of,
    fit_groups,
    shared_ppm,
    standard_labels,
)
from bench.systems.af_converter.groups import campaign_rows, group_rows, unit_temperatures
from bench.systems.af_converter.scale_factor.calibrator_drift import (
    CalibratorDrift,
    calibrator_drift,
    drift_estimates,
    repeats,
)
from bench.systems.af_converter.wording import say

if TYPE_CHECKING:
    from bench.record import RecordRow

_PPM = 1e6
_ONE = np.eye(2)
_SENSOR, _DRIFT, _STEADY_DRIFT = (say(f"component.{error}") for error in ("sensor", "drift_bound", "steady_drift"))


def sensor_effect_ppm(visit: GroupFit, fitted: Fitted, campaign: Campaign) -> Floats:
    """Signed effect (2,) on DSF_N, DSF_P of one standard deviation of the unit's temperature, ppm: sensor and gradient.

    A result says at which unit temperature it holds; a wrong thermometer makes it the result of another temperature.
    Zero while the coefficients of the channel or the uncertainty of the sensor are not known; a note says so.
    """
    slopes = fitted.slopes_ppm_degC(visit.group.channel, visit.fit.unit_temperature_degC)
    return np.array(slopes) * campaign.thermal_std_degC


def calibrator_parts(visit: GroupFit, contrast: Floats) -> dict[str, float]:
    """Return what each error of the calibrator brings to ``contrast`` (2,) of both, standard, signed, ppm, by label."""
    return {label: float(contrast @ effect_ppm) for label, effect_ppm in visit.fit.standard_ppm.items()}


def calibrator_dof(
    std_ppm: float, parts_ppm: Mapping[str, float], standards: Standards, scatter: Iterable[tuple[float, float]] = ()
) -> float:
    """Return effective degrees of freedom of a result to which errors of the calibrator, by label, bring some parts.

    ``scatter``: of points that are known by the scatter of their records, see ``scatter_parts``.
    """
    of_calibrator = [(part**2, standards.dof_of(label)) for label, part in parts_ppm.items()]
    return effective_dof(std_ppm**2, [*of_calibrator, *scatter])


def scatter_parts(visit: GroupFit, contrast: Floats, campaign: Campaign) -> list[tuple[float, float]]:
    """Return what each point known by its scatter brings to ``contrast`` (2,): variance, ppm², degrees of freedom."""
    rows = visit.group.closed
    variance_A2 = scatter_A2(rows, campaign.converter(visit.group.channel))
    parts_ppm2 = (contrast @ visit.fit.operator_ppm) ** 2 * variance_A2
    known = rows.scatter_dof > 0
    return list(zip(parts_ppm2[known].tolist(), rows.scatter_dof[known].tolist(), strict=True))


def scale_factor_std_ppm(visit: GroupFit, standards: Standards, index: int) -> float:
    """Standard uncertainty of DSF_N (index 0) or DSF_P (1) with all of the calibrator, without the sensor's part."""
    of_standard = math.fsum(part**2 for part in calibrator_parts(visit, _ONE[index]).values())
    return math.sqrt(visit.fit.noise_ppm2[index, index] + of_standard + standards.drift_ppm**2)


def scale_factor_estimates(visit: GroupFit, fitted: Fitted, campaign: Campaign, standards: Standards) -> Estimates:
    """dsf_n, dsf_p with the calibrator's common gain added, and dsf_asymmetry, where the gain cancels.

    A drift of the calibrator between the rows of one polarity and those of the other does not cancel.
    """
    conditions, fit = conditions_of(visit.group, visit.fit.unit_temperature_degC, campaign), visit.fit
    sensor_ppm, register = sensor_effect_ppm(visit, fitted, campaign), standards.register
    counted = {"n": fit.n, "dropped": visit.group.dropped + fit.dropped}
    entries = []
    for index, quantity in enumerate(QUANTITIES):
        std_ppm = float(np.hypot(scale_factor_std_ppm(visit, standards, index), sensor_ppm[index]))
        parts = calibrator_parts(visit, _ONE[index])
        common = common_errors(
            register, CALIBRATOR, parts, {_DRIFT: standards.drift_ppm, _SENSOR: float(sensor_ppm[index])}
        )
        scatter = scatter_parts(visit, _ONE[index], campaign)
        dof, value_ppm = calibrator_dof(std_ppm, parts, standards, scatter), fit.dsf_ppm[index]
        entries.append(sharing(estimate(quantity, "ppm", value_ppm, std_ppm, conditions, dof=dof, **counted), common))
    contrast = np.array([1.0, -1.0])
    parts = calibrator_parts(visit, contrast)
    of_campaign = {
        _STEADY_DRIFT: float(contrast @ fit.drift_ppm_s) * fitted.drift_ppm_s(standards),
        _SENSOR: float(contrast @ sensor_ppm),
    }
    squares = math.fsum(part**2 for part in (*parts.values(), *of_campaign.values()))
    std_ppm = math.sqrt(float(contrast @ fit.noise_ppm2 @ contrast) + squares)
    dof = calibrator_dof(std_ppm, parts, standards, scatter_parts(visit, contrast, campaign))
    value_ppm = float(contrast @ fit.dsf_ppm)
    common = common_errors(register, CALIBRATOR, parts, of_campaign)
    entry = estimate("dsf_asymmetry", "ppm", value_ppm, std_ppm, conditions, dof=dof, **counted)
    return [*entries, sharing(entry, common)]


def bias_estimates(visit: GroupFit, fitted: Fitted, campaign: Campaign) -> Estimates:
    """Bias of the open row: diagnostic only, it never enters the compensation (paper, end of section 3.3)."""
    if visit.bias is None:
        return []
    at_degC = visit.bias.unit_temperature_degC
    polynomial = fitted.polynomials.get(("bias", visit.group.channel))
    slope_A_degC = polynomial.slope(at_degC) if polynomial else 0.0
    thermal_degC = np.hypot(campaign.thermal_std_degC, np.max(visit.group.opened.temperature_std_degC))
    std_A = float(np.hypot(visit.bias.std_uncertainty_A, slope_A_degC * thermal_degC))
    return [bias_estimate(visit.group, visit.fit.unit_temperature_degC, visit.bias, std_A, campaign)]


def residual_estimates(fitted: Fitted, campaign: Campaign, standards: Standards) -> Estimates:
    """dsf_n_residual, dsf_p_residual: DSF(T) minus its own polynomial at the measured temperature, against the limit.

    The polynomial is what the navigation computer compensates with. What all temperatures share, the gain of the
    calibrator and the error of the unit's sensor, is in value and polynomial alike and leaves nothing. There is no such
    estimate for a channel with as few temperatures as coefficients: the polynomial would pass through every point.
    """
    entries = []
    for (quantity, channel), polynomial in fitted.polynomials.items():
        visits = fitted.visits(channel)
        if quantity not in QUANTITIES or len(visits) <= polynomial.coefficients.size:
            continue
        index, labels = QUANTITIES.index(quantity), standard_labels(visits)
        warmth_degC = np.array([visit.fit.unit_temperature_degC for visit in visits]) - polynomial.reference_degC
        design = np.vander(warmth_degC, polynomial.coefficients.size, increasing=True)
        left = np.eye(len(visits)) - design @ polynomial.operator
        shared = left @ shared_ppm(visits, index)
        noise_ppm2 = left**2 @ np.array([visit.fit.noise_ppm2[index, index] for visit in visits])
        time_s = np.array([visit.fit.time_s for visit in visits])
        drift_ppm = left @ (time_s - time_s.mean()) * fitted.drift_ppm_s(standards)
        limit = campaign.channel(channel).stability_limit_ppm
        for at, (visit, value_ppm) in enumerate(zip(visits, polynomial.residual.tolist(), strict=True)):
            parts = dict(zip(labels, shared[at].tolist(), strict=True))
            std_ppm = math.sqrt(noise_ppm2[at] + math.fsum(part**2 for part in parts.values()) + drift_ppm[at] ** 2)
            scatter = [
                part
                for one, weight in zip(visits, left[at].tolist(), strict=True)
                for part in scatter_parts(one, weight * _ONE[index], campaign)
            ]
            dof = calibrator_dof(std_ppm, parts, standards, scatter)
            common = common_errors(standards.register, CALIBRATOR, parts, {_STEADY_DRIFT: float(drift_ppm[at])})
            conditions = conditions_of(visit.group, visit.fit.unit_temperature_degC, campaign)
            counted = {"n": visit.fit.n, "dropped": visit.group.dropped + visit.fit.dropped}
            entry = estimate(
                f"{quantity}_residual", "ppm", value_ppm, std_ppm, conditions, limit=limit, dof=dof, **counted
            )
            entries.append(sharing(entry, common))
    return entries


def change_estimates(estimates: Iterable[Estimate], campaign: Campaign) -> Estimates:
    """Change against a previous calibration, judged against the stability limit (paper table 1).

    What both calibrations took from the same standards, as their estimates say, is left out of its uncertainty.
    """
    earlier = {
        _place(entry.get("quantity"), entry.get("conditions", {})): entry
        for entry in campaign.previous
        if entry.get("quantity") in QUANTITIES
    }
    entries = []
    for now in estimates:
        then = earlier.get(_place(now.quantity, now.conditions))
        if now.quantity not in QUANTITIES or then is None:
            continue
        limit = campaign.channel(now.conditions["channel"]).stability_limit_ppm
        shared = then.get("common")
        shared_ppm2 = covariance_by_standards(now.common, Common(**shared) if shared else None)
        stds_ppm = now.std_uncertainty, float(then["std_uncertainty"])
        own_ppm2 = [max(std_ppm**2 - shared_ppm2, 0.0) for std_ppm in stds_ppm]
        std_ppm = math.sqrt(math.fsum(own_ppm2))
        dofs = now.dof or math.inf, then.get("dof", math.inf)
        dof = effective_dof(std_ppm**2, zip(own_ppm2, dofs, strict=True))
        change_ppm = now.value - then["value"]
        name = f"{now.quantity}_change"
        entries.append(estimate(name, "ppm", change_ppm, std_ppm, now.conditions, n=now.n, limit=limit, dof=dof))
    return entries


def _place(quantity: Any, conditions: Document) -> tuple[Any, ...]:
    return quantity, conditions.get("channel"), conditions.get("temperature_degC")


def clock_estimates(rows: Iterable[RecordRow], campaign: Campaign, standards: Standards) -> Estimates:
    """clock_ratio_error (r - 1) and master_clock_error at every temperature, from all good records taken there.

    The uncertainty takes the fraction of a pulse at the ends of a record as common to all of them: two steady clocks
    and records at a steady pace may cut every count at the same place, and nothing in a record tells.
    """
    members_at: dict[float, list[RecordRow]] = {}
    taken = list(rows)
    for row in taken:
        if not count_problem(row):
            members_at.setdefault(float(row.window.conditions["temperature_degC"]), []).append(row)
    known = unit_temperatures(taken)
    entries = []
    for nominal_degC, members in members_at.items():
        gate_s = np.array([int(row.sums["master_count"]) for row in members]) / campaign.master_Hz
        af_count = np.array([int(row.sums["af_clock"]) for row in members], dtype=np.float64)
        fg_count = np.array([int(row.sums.get("fg_count", 0)) for row in members], dtype=np.float64)
        conditions: dict[str, Any] = {"temperature_degC": nominal_degC}
        warmth = [known[row.window.number].value_degC for row in members if row.window.number in known]
        if warmth:
            conditions["unit_temperature_degC"] = float(np.mean(warmth))
        ratio = clock_ratio(af_count, gate_s, campaign.af_clock_Hz) - 1.0
        entries += _clock("clock_ratio_error", ratio, count_noise(af_count), 0.0, math.inf, conditions)
        master = master_clock_error(fg_count, gate_s, campaign.fg_Hz)
        generator = standards.function_generator, standards.generator_dof
        entries += _clock(
            "master_clock_error", master, count_noise(fg_count), *generator, conditions, standards.register
        )
    return entries


def _clock(
    quantity: str, values: Any, noise: Any, generator: float, generator_dof: float, conditions: dict[str, Any],
    register: Register | None = None,
) -> Estimates:  # fmt: skip
    seen = np.isfinite(values)
    n = int(seen.sum())
    if n == 0:
        return []
    std = float(np.hypot(np.mean(noise[seen]), generator))
    value_ppm, std_ppm = float(np.mean(values[seen])) * _PPM, std * _PPM
    dof, dropped = effective_dof(std**2, [(generator**2, generator_dof)]), int((~seen).sum())
    common = common_errors(register or {}, FUNCTION_GENERATOR, {FREQUENCY: generator * _PPM}, {})
    return [sharing(estimate(quantity, "ppm", value_ppm, std_ppm, conditions, n=n, dropped=dropped, dof=dof), common)]


def coefficient_estimates(fitted: Fitted, campaign: Campaign, standards: Standards) -> Estimates:
    """<quantity>_tc0, _tc1, _tc2: value and coefficients about the reference temperature of the campaign."""
    entries = []
    for (quantity, channel), polynomial in fitted.polynomials.items():
        visits = fitted.visits(channel)
        conditions = {
            "channel": channel,
            "kind": campaign.channel(channel).kind,
            "reference_temperature_degC": campaign.reference_temperature_degC,
        }
        for order, value in enumerate(polynomial.coefficients):
            std = float(np.hypot(polynomial.std_uncertainty(order), _sensor_effect(polynomial, order, campaign)))
            parts: dict[str, float] = {}
            scatter = [(float(polynomial.misfit[order]) ** 2, polynomial.misfit_dof)] if polynomial.misfit_dof else []
            of_campaign = {_SENSOR: _sensor_effect(polynomial, order, campaign)}
            if quantity in QUANTITIES:
                contrast = _ONE[QUANTITIES.index(quantity)]
                for visit, weight in zip(visits, polynomial.operator[order].tolist(), strict=True):
                    scatter += scatter_parts(visit, weight * contrast, campaign)
                parts = dict(zip(standard_labels(visits), polynomial.effects[order].tolist(), strict=True))
                drift_ppm = _drift_ppm(order, polynomial, visits, fitted, standards)
                std = float(np.hypot(std, drift_ppm))
                of_campaign[_STEADY_DRIFT if order else _DRIFT] = drift_ppm
            dof = calibrator_dof(std, parts, standards, scatter)
            common = common_errors(standards.register, CALIBRATOR, parts, of_campaign)
            name, unit = f"{quantity}_tc{order}", per_degC(UNITS[quantity], order)
            entries.append(sharing(estimate(name, unit, value, std, conditions, n=len(visits), dof=dof), common))
    return entries


def _sensor_effect(polynomial: TemperaturePolynomial, order: int, campaign: Campaign) -> float:
    """One standard deviation of the unit's sensor in a coefficient, the error being the same at all temperatures.

    It moves the polynomial along the axis: tc0 by tc1, tc1 by 2 tc2. A gain error of the sensor of 0.1 % would change
    tc1 by as much, and is left to the sensor's own certificate.
    """
    later = polynomial.coefficients[order + 1 :]
    return float((order + 1) * later[0] * campaign.thermal_std_degC) if later.size else 0.0


def _drift_ppm(
    order: int, polynomial: TemperaturePolynomial, visits: list[GroupFit], fitted: Fitted, standards: Standards
) -> float:
    """Drift of the calibrator in a coefficient: a drift in time looks like one in temperature, to second order."""
    if order == 0:
        return standards.drift_ppm
    time_s = np.array([visit.fit.time_s for visit in visits])
    since_ppm = (time_s - time_s.mean()) * fitted.drift_ppm_s(standards)
    first, second = polynomial.operator[order] @ np.column_stack(
        [since_ppm, 1e-6 * (coverage_factor() * since_ppm) ** 2]
    )
    return math.hypot(first, second)


if TYPE_CHECKING:
    from bench.record import RecordRow


@dataclass(frozen=True)
class Determined:
    """Fits and estimates of a campaign. ``standards``: with the drift of the calibrator that it leaves possible."""

    constants: Campaign
    standards: Standards
    rows: Sequence[RecordRow]
    fitted: Fitted
    drift: CalibratorDrift
    estimates: Estimates


def determine(material: Material, method: str) -> Determined:
    """Return fits and estimates of a campaign, without what explains them. Raises: as ``analysis.analyse``."""
    constants, declared = read_campaign(material.campaign), read_standards(material.standards)
    rows = campaign_rows(material.rows)
    fitted = fit_groups(group_rows(rows, constants.master_Hz), constants, declared, method)
    again = repeats(fitted, constants, declared, method)
    drift = calibrator_drift(again, fitted, rows, material.readings)
    standards = drift.applied_to(declared)
    entries: Estimates = []
    for visit in fitted.groups:
        if visit.group.repeat == 0:
            entries += scale_factor_estimates(visit, fitted, constants, standards)
            entries += bias_estimates(visit, fitted, constants)
    entries += residual_estimates(fitted, constants, standards)
    entries += coefficient_estimates(fitted, constants, standards)
    entries += clock_estimates(rows, constants, standards)
    entries += drift_estimates(again, fitted, constants) + drift.estimates
    entries += change_estimates(entries, constants)
    return Determined(constants, standards, rows, fitted, drift, entries)
