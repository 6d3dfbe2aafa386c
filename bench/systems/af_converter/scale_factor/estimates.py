"""Estimates of a scale-factor campaign: scale-factor errors, asymmetry, bias and clocks, and those that have a verdict.

Table 1 of the paper states stability, so it judges what compensation leaves over and what changed since the calibration
before; a scale-factor error itself has no limit.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.analysis import Estimate, Estimates, count_problem, estimate
from bench.maths.budget import effective_dof
from bench.systems.af_converter.coefficients import UNITS
from bench.systems.af_converter.constants import Campaign, Standards
from bench.systems.af_converter.estimators.readings import clock_ratio, count_noise, master_clock_error
from bench.systems.af_converter.estimators.temperature import TemperaturePolynomial
from bench.systems.af_converter.group_fit import QUANTITIES, Fitted, GroupFit, conditions_of
from bench.systems.af_converter.groups import unit_temperatures

if TYPE_CHECKING:
    from bench.record import RecordRow

_PPM = 1e6


def sensor_effect_ppm(visit: GroupFit, fitted: Fitted, campaign: Campaign) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Signed effect (2,) on DSF_N, DSF_P of one standard deviation of the unit's temperature sensor, ppm.

    A result says at which unit temperature it holds; a wrong thermometer makes it the result of another temperature.
    Zero while the coefficients of the channel or the uncertainty of the sensor are not known; a note says so.
    """
    slopes = fitted.slopes_ppm_degC(visit.group.channel, visit.fit.unit_temperature_degC)
    return np.array(slopes) * campaign.sensor_std_degC


def calibrator_parts_ppm(visit: GroupFit, standards: Standards, index: int) -> list[float]:
    """Return what the calibrator's certificate brings to DSF_N (index 0) or DSF_P (1), part by part, standard, ppm."""
    of_ranges = [float(effect_ppm[index]) for effect_ppm in visit.fit.shared_ppm.values()]
    return [*of_ranges, float(visit.fit.gain_ppm[index]), (standards.traceability or 0.0) * _PPM]


def calibrator_dof(std_ppm: float, parts_ppm: Iterable[float], standards: Standards) -> float:
    """Return effective degrees of freedom of a result to which the calibrator's certificate brings some parts."""
    return effective_dof(std_ppm**2, ((part**2, standards.calibrator_dof) for part in parts_ppm))


def scale_factor_std_ppm(visit: GroupFit, standards: Standards, index: int) -> float:
    """Standard uncertainty of DSF_N (index 0) or DSF_P (1) with the calibrator's gain, without the sensor's part."""
    variance = (
        visit.fit.covariance_ppm2[index, index] + visit.fit.gain_ppm[index] ** 2 + standards.common_relative_ppm**2
    )
    return float(np.sqrt(variance))


def scale_factor_estimates(visit: GroupFit, fitted: Fitted, campaign: Campaign, standards: Standards) -> Estimates:
    """dsf_n, dsf_p with the calibrator's common gain added, and dsf_asymmetry, where the gain cancels.

    A drift of the calibrator between the rows of one polarity and those of the other does not cancel.
    """
    conditions, fit = conditions_of(visit.group, visit.fit.unit_temperature_degC, campaign), visit.fit
    sensor_ppm = sensor_effect_ppm(visit, fitted, campaign)
    counted = {"n": fit.n, "dropped": visit.group.dropped + fit.dropped}
    entries = []
    for index, quantity in enumerate(QUANTITIES):
        std_ppm = float(np.hypot(scale_factor_std_ppm(visit, standards, index), sensor_ppm[index]))
        dof = calibrator_dof(std_ppm, calibrator_parts_ppm(visit, standards, index), standards)
        entries.append(estimate(quantity, "ppm", fit.dsf_ppm[index], std_ppm, conditions, dof=dof, **counted))
    contrast = np.array([1.0, -1.0])
    common_ppm = [fit.gain_ppm, sensor_ppm, fit.drift_ppm_s * fitted.drift_ppm_s(standards)]
    variance = contrast @ fit.covariance_ppm2 @ contrast + sum((contrast @ part) ** 2 for part in common_ppm)
    value_ppm, std_ppm = float(contrast @ fit.dsf_ppm), float(np.sqrt(variance))
    parts_ppm = [float(contrast @ part) for part in (*fit.shared_ppm.values(), fit.gain_ppm)]
    dof = calibrator_dof(std_ppm, parts_ppm, standards)
    entries.append(estimate("dsf_asymmetry", "ppm", value_ppm, std_ppm, conditions, dof=dof, **counted))
    return entries


def bias_estimates(visit: GroupFit, fitted: Fitted, campaign: Campaign) -> Estimates:
    """Bias of the open row: diagnostic only, it never enters the compensation (paper, end of section 3.3)."""
    if visit.bias is None:
        return []
    at_degC = visit.bias.unit_temperature_degC
    polynomial = fitted.polynomials.get(("bias", visit.group.channel))
    slope_A_degC = polynomial.slope(at_degC) if polynomial else 0.0
    thermal_degC = np.hypot(campaign.sensor_std_degC, np.max(visit.group.opened.temperature_std_degC))
    std_A = float(np.hypot(visit.bias.std_uncertainty_A, slope_A_degC * thermal_degC))
    conditions = conditions_of(visit.group, visit.fit.unit_temperature_degC, campaign) | {
        "unit_temperature_degC": at_degC
    }
    rows = visit.group.opened.gate_s.size
    return [
        estimate("bias", "A", visit.bias.value_A, std_A, conditions, n=rows, dropped=visit.group.open_planned - rows)
    ]


def residual_estimates(fitted: Fitted, campaign: Campaign, standards: Standards) -> Estimates:
    """dsf_n_residual, dsf_p_residual: DSF(T) minus its own polynomial at the measured temperature, against the limit.

    The polynomial is what the navigation computer compensates with. What it leaves over is known as well as DSF(T)
    itself: the calibrator's gain counts in full, because the compensation takes it over; the error of the unit's
    temperature sensor does not, because the compensation reads the same sensor. There is no such estimate for a channel
    with as few temperatures as coefficients: the polynomial would pass through every point.
    """
    entries = []
    for (quantity, channel), polynomial in fitted.polynomials.items():
        visits = fitted.visits(channel)
        if quantity not in QUANTITIES or len(visits) <= polynomial.coefficients.size:
            continue
        limit = campaign.channel(channel).stability_limit_ppm
        for visit, value_ppm in zip(visits, polynomial.residual, strict=True):
            index = QUANTITIES.index(quantity)
            std_ppm = scale_factor_std_ppm(visit, standards, index)
            dof = calibrator_dof(std_ppm, calibrator_parts_ppm(visit, standards, index), standards)
            conditions = conditions_of(visit.group, visit.fit.unit_temperature_degC, campaign)
            counted = {"n": visit.fit.n, "dropped": visit.group.dropped + visit.fit.dropped}
            name = f"{quantity}_residual"
            entries.append(
                estimate(name, "ppm", float(value_ppm), std_ppm, conditions, limit=limit, dof=dof, **counted)
            )
    return entries


def change_estimates(estimates: Iterable[Estimate], campaign: Campaign) -> Estimates:
    """Change against a previous calibration, judged against the stability limit (paper table 1).

    Both uncertainties count in full: nothing says that the two calibrations shared a standard.
    """
    earlier = {_place(entry): entry for entry in campaign.previous if entry.get("quantity") in QUANTITIES}
    entries = []
    for now in estimates:
        then = earlier.get(_place(now))
        if now["quantity"] not in QUANTITIES or then is None:
            continue
        limit = campaign.channel(now["conditions"]["channel"]).stability_limit_ppm
        std_ppm = float(np.hypot(now["std_uncertainty"], then["std_uncertainty"]))
        dof = effective_dof(std_ppm**2, ((of["std_uncertainty"] ** 2, of.get("dof", math.inf)) for of in (now, then)))
        change_ppm = now["value"] - then["value"]
        name = f"{now['quantity']}_change"
        entries.append(estimate(name, "ppm", change_ppm, std_ppm, now["conditions"], n=now["n"], limit=limit, dof=dof))
    return entries


def _place(entry: Any) -> tuple[Any, ...]:
    conditions = entry.get("conditions", {})
    return entry.get("quantity"), conditions.get("channel"), conditions.get("temperature_degC")


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
        common = standards.function_generator, standards.generator_dof
        entries += _clock("master_clock_error", master, count_noise(fg_count), *common, conditions)
    return entries


def _clock(
    quantity: str, values: Any, noise: Any, common: float, common_dof: float, conditions: dict[str, Any]
) -> Estimates:
    seen = np.isfinite(values)
    n = int(seen.sum())
    if n == 0:
        return []
    std = float(np.hypot(np.mean(noise[seen]), common))
    value_ppm, std_ppm = float(np.mean(values[seen])) * _PPM, std * _PPM
    dof = effective_dof(std**2, [(common**2, common_dof)])
    return [estimate(quantity, "ppm", value_ppm, std_ppm, conditions, n=n, dropped=int((~seen).sum()), dof=dof)]


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
            parts = polynomial.effects[order].tolist()
            if quantity in QUANTITIES:
                std = float(np.hypot(std, _standard_ppm(order, polynomial, visits, fitted, standards)))
                parts += [] if order else [(standards.traceability or 0.0) * _PPM]
            dof = calibrator_dof(std, parts, standards)
            unit = UNITS[quantity] + ("", "/degC", "/degC2")[order]
            entries.append(estimate(f"{quantity}_tc{order}", unit, value, std, conditions, n=len(visits), dof=dof))
    return entries


def _sensor_effect(polynomial: TemperaturePolynomial, order: int, campaign: Campaign) -> float:
    """One standard deviation of the unit's sensor in a coefficient, the error being the same at all temperatures.

    It moves the polynomial along the axis: tc0 by tc1, tc1 by 2 tc2. A gain error of the sensor of 0.1 % would change
    tc1 by as much, and is left to the sensor's own certificate.
    """
    later = polynomial.coefficients[order + 1 :]
    return float((order + 1) * later[0] * campaign.sensor_std_degC) if later.size else 0.0


def _standard_ppm(
    order: int, polynomial: TemperaturePolynomial, visits: list[GroupFit], fitted: Fitted, standards: Standards
) -> float:
    """Traceability and drift of the calibrator in a coefficient: a drift in time looks like one in temperature."""
    if order == 0:
        return standards.common_relative_ppm
    time_s = np.array([visit.fit.time_s for visit in visits])
    return float(polynomial.operator[order] @ (time_s - time_s.mean()) * fitted.drift_ppm_s(standards))
