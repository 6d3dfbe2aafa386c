"""The master oscillator of the unit over temperature, from the same windows as the bias."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.analysis import estimate
from bench.systems.af_converter.bias_ramp.records import RampRecords
from bench.systems.af_converter.constants import Campaign, read_generator
from bench.systems.af_converter.estimators.oscillator import OscillatorFit, OscillatorWindows, fit_oscillator

_ORDER = 3


def fit_master_clock(
    records: RampRecords, campaign: Campaign, standards: Mapping[str, Mapping[str, Any]]
) -> OscillatorFit:
    """Cubic of dMSTR about the reference temperature. Raises FitError B-FIT-026 if the windows do not determine it."""
    pulses = records.pulses
    length_s = (pulses.frames + pulses.lost) * pulses.frame_s
    return fit_oscillator(
        OscillatorWindows(
            times_s=records.start_s + length_s / 2.0,
            gate_s=pulses.gate_s,
            fg_count=records.fg_count,
            unit_degC=records.unit_degC,
            contiguous=pulses.follows,
        ),
        campaign.fg_Hz,
        order=_ORDER,
        reference_degC=campaign.reference_temperature_degC,
        generator_std=read_generator(standards),
        sensor_std_degC=campaign.sensor_std_degC,
    )


def master_clock_estimates(fit: OscillatorFit, at_degC: Sequence[float], dropped: int) -> list[dict[str, Any]]:
    """master_clock_error at temperatures, and its coefficients _tc0 ... about the reference temperature."""
    counts = {"n": fit.n_used, "dropped": fit.n_dropped + dropped}
    name = "master_clock_error"
    found = [
        estimate(name, "ppm", fit.value_ppm(at), fit.std_ppm(at), {"temperature_degC": at}, **counts) for at in at_degC
    ]
    reference = {"reference_temperature_degC": fit.reference_degC}
    for order, value in enumerate(fit.coefficients_ppm):
        unit = "ppm" + ("", "/degC")[order] if order < 2 else f"ppm/degC{order}"
        std = fit.coefficient_std_ppm(order)
        found.append(estimate(f"{name}_tc{order}", unit, float(value), std, reference, **counts))
    return found


def master_clock_compensation(fit: OscillatorFit) -> dict[str, Any]:
    """Return the entry for coefficients.json."""
    return {
        "channel": None,
        "kind": None,
        "parameter": "master_clock",
        "unit": "ppm",
        "reference_temperature_degC": fit.reference_degC,
        "coefficients": [float(one) for one in fit.coefficients_ppm],
        "valid_degC": list(fit.span_degC),
    }
