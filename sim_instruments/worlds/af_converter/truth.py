"""Simulated truth: what a perfect analysis of the records would find. Nothing of the product reads it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.model.arrays import Integers
from bench.model.clock import NS
from bench.model.ports import RecordWindow
from sim_instruments.worlds.af_converter.constants import REFERENCE_DEGC
from sim_instruments.worlds.af_converter.unit_constants import NguTruth
from sim_instruments.worlds.common.thermal import PlaceInAir, Thermal
from sim_instruments.worlds.common.world import entry

_POINTS_PER_WINDOW = 11
TEMPERATURES_DEGC = (-10.0, 5.0, 20.0, 35.0, 50.0)
_ORDERS = 4
_REFERENCE = {"reference_temperature_degC": REFERENCE_DEGC}


def per_degC(unit: str, order: int) -> str:
    """Return unit of the coefficient of (T - T_ref)^order."""
    return unit if order == 0 else f"{unit}/degC{order if order > 1 else ''}"


def times_ns(windows: Sequence[RecordWindow]) -> Integers:
    """Return bench times spread evenly over the windows."""
    return np.concatenate([np.linspace(w.t_start_ns, w.t_end_ns, _POINTS_PER_WINDOW).astype(np.int64) for w in windows])


def estimates(truth: NguTruth, thermal: Thermal | PlaceInAir, windows: Sequence[RecordWindow]) -> list[dict[str, Any]]:
    """Return true values in the contract's form, one block per channel and temperature of the measuring windows.

    Scale factors are those at the unit's true temperature averaged over the windows of that channel and temperature
    (wiring checks and closing repeats left out); the bias is averaged over the open-input windows among them, with
    the hysteresis as it was then. A bias campaign has a list of its own.
    """
    if ramp := bias_windows(windows):
        return bias_estimates(truth, ramp, thermal.unit_lag_s)
    entries: list[dict[str, Any]] = []
    groups = _groups(windows)
    for (channel, kind, nominal_degC), group in groups.items():
        conditions = {"channel": channel, "kind": kind, "temperature_degC": nominal_degC}
        entries += _at_temperature(truth, thermal, group, conditions)
    for channel, kind in dict.fromkeys((channel, kind) for channel, kind, _ in groups):
        entries += _coefficients(truth, channel, kind)
    for nominal_degC in sorted({nominal_degC for _, _, nominal_degC in groups}):
        spans = [w for (_, _, degC), group in groups.items() if degC == nominal_degC for w in group]
        entries += _clocks(truth, thermal.unit_degC(times_ns(spans)), {"temperature_degC": nominal_degC})
    return entries


def _groups(windows: Sequence[RecordWindow]) -> dict[tuple[int, str, float], list[RecordWindow]]:
    groups: dict[tuple[int, str, float], list[RecordWindow]] = {}
    for window in windows:
        conditions = window.conditions
        if not {"channel", "kind", "temperature_degC"} <= conditions.keys():
            continue
        if conditions.get("repeat") or conditions.get("purpose") == "wiring":
            continue
        key = (int(conditions["channel"]), str(conditions["kind"]), float(conditions["temperature_degC"]))
        groups.setdefault(key, []).append(window)
    return groups


def _at_temperature(
    truth: NguTruth, thermal: Thermal | PlaceInAir, windows: Sequence[RecordWindow], conditions: dict[str, Any]
) -> list[dict[str, Any]]:
    channel = conditions["channel"]
    unit_degC = float(thermal.unit_degC(times_ns(windows)).mean())
    n_ppm, p_ppm = truth.dsf_ppm(channel, unit_degC).tolist()
    open_ns = times_ns([w for w in windows if w.conditions.get("route") == "open"] or windows)
    offset_degC = thermal.play_offset_degC(open_ns, truth.half_width_degC[channel - 1])
    bias_A = truth.bias_A(channel, thermal.unit_degC(open_ns), open_ns / NS, offset_degC).mean()
    return [
        entry("dsf_n", "ppm", n_ppm, conditions),
        entry("dsf_p", "ppm", p_ppm, conditions),
        entry("dsf_asymmetry", "ppm", n_ppm - p_ppm, conditions),
        entry("bias", "A", bias_A, conditions),
    ]


def _clocks(truth: NguTruth, unit_degC: np.ndarray, conditions: dict[str, Any]) -> list[dict[str, Any]]:
    master = truth.master_error_ppm(unit_degC) * 1e-6
    ratio = (1.0 + master) / (1.0 + truth.af_clock_error_ppm * 1e-6) - 1.0
    return [
        entry("clock_ratio_error", "ppm", ratio.mean() * 1e6, conditions),
        entry("master_clock_error", "ppm", master.mean() * 1e6, conditions),
    ]


def _coefficients(truth: NguTruth, channel: int, kind: str) -> list[dict[str, Any]]:
    conditions = {"channel": channel, "kind": kind, "reference_temperature_degC": REFERENCE_DEGC}
    entries = []
    for side in ("n", "p"):
        tc1, tc2 = truth.tc_ppm(channel, side)
        entries.append(entry(f"dsf_{side}_tc1", "ppm/degC", tc1, conditions))
        entries.append(entry(f"dsf_{side}_tc2", "ppm/degC2", tc2, conditions))
    return entries


def bias_windows(windows: Sequence[RecordWindow]) -> list[RecordWindow]:
    """Return the windows of a bias campaign: on a branch of the temperature, of no single channel."""
    return [w for w in windows if "branch" in w.conditions and "channel" not in w.conditions]


def bias_estimates(truth: NguTruth, windows: Sequence[RecordWindow], unit_lag_s: float) -> list[dict[str, Any]]:
    """Return true values as in the contract, by channel and for the oscillator; ``unit_lag_s`` behind the air.

    ``bias`` is the curve between the branches with the mean of the random walk over the windows; a unit without
    hysteresis has the width 0 and no half-width.
    """
    entries = []
    for number in range(1, len(truth.kinds) + 1):
        lag = entry("thermal_lag", "min", unit_lag_s / 60.0, {"channel": number, "kind": truth.kinds[number - 1]})
        entries += [*_of_channel(truth, number, windows), lag]
    entries += [
        entry("master_clock_error", "ppm", truth.master_error_ppm(degC), {"temperature_degC": degC})
        for degC in TEMPERATURES_DEGC
    ]
    entries += [
        entry(f"master_clock_error_tc{order}", per_degC("ppm", order), truth.master_tc_ppm(order), _REFERENCE)
        for order in range(_ORDERS)
    ]
    return entries


def _of_channel(truth: NguTruth, number: int, windows: Sequence[RecordWindow]) -> list[dict[str, Any]]:
    channel = {"channel": number, "kind": truth.kinds[number - 1]}
    t_s = times_ns(windows) / NS
    entries = [
        entry("bias", "A", truth.bias_A(number, degC, t_s).mean(), {**channel, "temperature_degC": degC})
        for degC in TEMPERATURES_DEGC
    ]
    entries += [
        entry(f"bias_tc{order}", per_degC("A", order), truth.bias_tc_A(number, order), {**channel, **_REFERENCE})
        for order in range(1, _ORDERS)
    ]
    width_A = truth.hysteresis_A[number - 1]
    entries.append(entry("hysteresis_width", "A", width_A, {**channel, **_REFERENCE}))
    if width_A:
        entries.append(entry("play_half_width", "degC", truth.half_width_degC[number - 1], channel))
    return entries
