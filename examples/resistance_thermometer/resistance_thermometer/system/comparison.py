"""One thermometer beside the reference: its deviations from IEC 60751, and what makes them uncertain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from bench.model.errors import FitError
from numpy.typing import NDArray

from resistance_thermometer.system.estimators.callendar import IMPROBABLE, CallendarFit, fit_callendar
from resistance_thermometer.system.estimators.iec60751 import slope_per_degC, temperature_degC
from resistance_thermometer.system.points import Point
from resistance_thermometer.system.setup import Setup, Thermometer

Array = NDArray[np.float64]
ROOM_DEGC = 23.0  # where the chamber has no gradient
_RECTANGULAR = np.sqrt(3.0)


@dataclass(frozen=True)
class Part:
    """One cause of uncertainty: its standard uncertainty at each point, degC; ``common``: one error for all points."""

    name: str
    std_degC: Array
    common: bool
    evaluation: str = "B"


@dataclass(frozen=True)
class Comparison:
    """One thermometer; arrays are (m,), one value per point that it can be compared at.

    ``fit`` is None if there is none, ``refused`` says why; ``absent_degC`` are set-points without a reading.
    """

    thermometer: Thermometer
    setpoint_degC: Array
    t_degC: Array
    resistance_ohm: Array
    deviation_degC: Array
    n: Sequence[int]
    dropped: Sequence[int]
    parts: Sequence[Part]
    fit: CallendarFit | None
    refused: str
    absent_degC: Sequence[float]

    @property
    def std_degC(self) -> Array:
        """Standard uncertainty of the deviations."""
        return np.sqrt(np.diag(covariance_degC2(self.parts)))


def reference_degC(points: Sequence[Point], setup: Setup) -> Array:
    """Return the temperature of the reference probe by its certificate, (m,), degC; NaN without a reading."""
    ohm = np.array([point.reference.value for point in points])
    return temperature_degC(ohm / setup.reference_r0_ohm, setup.reference_curve)


def covariance_degC2(parts: Sequence[Part]) -> Array:
    """Return the covariance of the deviations, (m, m)."""
    of_parts = (np.outer(p.std_degC, p.std_degC) if p.common else np.diag(p.std_degC**2) for p in parts)
    return np.asarray(sum(of_parts), np.float64)


def compare(thermometer: Thermometer, points: Sequence[Point], setup: Setup) -> Comparison:
    """Compare one thermometer with the reference at every point at which both were read."""
    reference = reference_degC(points, setup)
    has_both = [
        thermometer.channel in point.by_channel
        and point.by_channel[thermometer.channel].n > 1
        and point.reference.n > 1
        and bool(np.isfinite(t_degC))
        for point, t_degC in zip(points, reference, strict=True)
    ]
    used = [point for point, both in zip(points, has_both, strict=True) if both]
    t_degC = reference[has_both]
    means = [point.by_channel[thermometer.channel] for point in used]
    ohm = np.array([mean.value for mean in means])
    indicated_degC = temperature_degC(ohm / thermometer.nominal_ohm) - thermometer.self_heating_degC
    parts = _parts(thermometer, used, t_degC, setup)
    fit, refused = _fit(thermometer, t_degC, ohm, parts)
    return Comparison(
        thermometer=thermometer,
        setpoint_degC=np.array([point.setpoint_degC for point in used]),
        t_degC=t_degC,
        resistance_ohm=ohm,
        deviation_degC=indicated_degC - t_degC,
        n=[mean.n for mean in means],
        dropped=[mean.dropped for mean in means],
        parts=parts,
        fit=fit,
        refused=refused,
        absent_degC=[point.setpoint_degC for point, both in zip(points, has_both, strict=True) if not both],
    )


def slope_ohm_degC(thermometer: Thermometer, t_degC: Array) -> Array:
    """Return how the resistance of a nominal thermometer rises, (m,), ohm per degC."""
    return thermometer.nominal_ohm * slope_per_degC(t_degC)


def _parts(thermometer: Thermometer, points: Sequence[Point], t_degC: Array, setup: Setup) -> list[Part]:
    """Return all causes; the first are errors of a standard, which is the same at every temperature."""
    means = [point.by_channel[thermometer.channel] for point in points]
    own, reference = (np.array([mean.value for mean in group]) for group in (means, [p.reference for p in points]))
    noise, reference_noise = (np.array([m.std for m in group]) for group in (means, [p.reference for p in points]))
    per_ohm = 1.0 / slope_ohm_degC(thermometer, t_degC)
    per_reference_ohm = 1.0 / (setup.reference_r0_ohm * slope_per_degC(t_degC, setup.reference_curve))
    span = np.max(np.abs(t_degC - ROOM_DEGC), initial=1.0)
    every = np.ones_like(t_degC)
    return [
        Part("calibration of the reference probe", setup.reference_std_degC * every, True),
        Part("gain of the meter", setup.meter.relative * reference * per_reference_ohm, True),
        Part("zero of the meter", setup.meter.floor_ohm * per_reference_ohm, True),
        Part("gain of the scanner", setup.scanner.relative * own * per_ohm, True),
        Part("zero of the scanner", setup.scanner.floor_ohm * per_ohm, True),
        Part("uniformity of the chamber", setup.uniformity_std_degC * (t_degC - ROOM_DEGC) / span, True),
        Part("self-heating", 0.5 * thermometer.self_heating_degC / _RECTANGULAR * every, True),
        Part("stability of the chamber", setup.stability_std_degC * every, False),
        Part("noise of the readings", np.hypot(noise * per_ohm, reference_noise * per_reference_ohm), False, "A"),
    ]


def _fit(thermometer: Thermometer, t_degC: Array, ohm: Array, parts: Sequence[Part]) -> tuple[CallendarFit | None, str]:
    """Fit at the temperature that the element really has, its own heating included; else say why not."""
    slope = slope_ohm_degC(thermometer, t_degC)
    try:
        element_degC = t_degC + thermometer.self_heating_degC
        fit = fit_callendar(element_degC, ohm, covariance_degC2(parts) * np.outer(slope, slope))
    except FitError as error:
        return None, error.message
    if fit.probability < IMPROBABLE:
        return fit, (
            f"chi-square is {fit.chi2:.3g} at {fit.dof} degrees of freedom, so its readings do not follow the "
            "Callendar-Van Dusen equation: was it moved, exchanged or not settled?"
        )
    return fit, ""
