"""Simulated truth of a bias campaign: all channels at once, the temperature going up and down."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bench.model.clock import NS
from bench.model.ports import RecordWindow
from sim_instruments.worlds.af_converter.unit_truth import REFERENCE_TEMPERATURE_DEGC, UnitTruth, per_degC, times_ns
from sim_instruments.worlds.common.world import entry

TEMPERATURES_DEGC = (-10.0, 5.0, 20.0, 35.0, 50.0)
_ORDERS = 4
_REFERENCE = {"reference_temperature_degC": REFERENCE_TEMPERATURE_DEGC}


def bias_windows(windows: Sequence[RecordWindow]) -> list[RecordWindow]:
    """Return the windows of a bias campaign: on a branch of the temperature, of no single channel."""
    return [w for w in windows if "branch" in w.conditions and "channel" not in w.conditions]


def bias_estimates(truth: UnitTruth, windows: Sequence[RecordWindow], unit_lag_s: float) -> list[dict[str, Any]]:
    """True values in the contract's form, by channel and for the master oscillator; ``unit_lag_s`` behind the air.

    ``bias`` is the curve between the branches with the mean of the random walk over the windows; a unit without
    hysteresis has the width 0 and no half-width.
    """
    found = []
    for number in range(1, len(truth.kinds) + 1):
        lag = entry("thermal_lag", "min", unit_lag_s / 60.0, {"channel": number, "kind": truth.kinds[number - 1]})
        found += [*_of_channel(truth, number, windows), lag]
    found += [
        entry("master_clock_error", "ppm", truth.master_error_ppm(degC), {"temperature_degC": degC})
        for degC in TEMPERATURES_DEGC
    ]
    found += [
        entry(f"master_clock_error_tc{order}", per_degC("ppm", order), truth.master_tc_ppm(order), _REFERENCE)
        for order in range(_ORDERS)
    ]
    return found


def _of_channel(truth: UnitTruth, number: int, windows: Sequence[RecordWindow]) -> list[dict[str, Any]]:
    channel = {"channel": number, "kind": truth.kinds[number - 1]}
    t_s = times_ns(windows) / NS
    found = [
        entry("bias", "A", truth.bias_A(number, degC, t_s).mean(), {**channel, "temperature_degC": degC})
        for degC in TEMPERATURES_DEGC
    ]
    found += [
        entry(f"bias_tc{order}", per_degC("A", order), truth.bias_tc_A(number, order), {**channel, **_REFERENCE})
        for order in range(1, _ORDERS)
    ]
    width_A = truth.hysteresis_A[number - 1]
    found.append(entry("hysteresis_width", "A", width_A, {**channel, **_REFERENCE}))
    if width_A:
        found.append(entry("play_half_width", "degC", truth.half_width_degC[number - 1], channel))
    return found
