"""Simulated truth: what a perfect analysis of the records would find. Nothing of the product reads it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.model.clock import NS
from bench.model.ports import RecordWindow
from sim_instruments.worlds.af_converter.truth_bias import bias_estimates, bias_windows
from sim_instruments.worlds.af_converter.unit_truth import REFERENCE_TEMPERATURE_DEGC, UnitTruth, times_ns
from sim_instruments.worlds.common.thermal import Thermal
from sim_instruments.worlds.common.world import entry


def estimates(truth: UnitTruth, thermal: Thermal, windows: Sequence[RecordWindow]) -> list[dict[str, Any]]:
    """Return True values in the contract's form, one block per channel and temperature of the measuring windows.

    Scale factors are those at the unit's true temperature averaged over the windows of that channel and temperature
    (wiring checks and closing repeats left out); the bias is averaged over the open-input windows among them, with
    the hysteresis as it was then. A bias campaign has a list of its own.
    """
    if ramp := bias_windows(windows):
        return bias_estimates(truth, ramp, thermal.unit_lag_s)
    found: list[dict[str, Any]] = []
    groups = _groups(windows)
    for (channel, kind, nominal_degC), group in groups.items():
        conditions = {"channel": channel, "kind": kind, "temperature_degC": nominal_degC}
        found += _at_temperature(truth, thermal, group, conditions)
    for channel, kind in dict.fromkeys((channel, kind) for channel, kind, _ in groups):
        found += _coefficients(truth, channel, kind)
    for nominal_degC in sorted({nominal_degC for _, _, nominal_degC in groups}):
        spans = [w for (_, _, degC), group in groups.items() if degC == nominal_degC for w in group]
        found += _clocks(truth, thermal.unit_degC(times_ns(spans)), {"temperature_degC": nominal_degC})
    return found


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
    truth: UnitTruth, thermal: Thermal, windows: Sequence[RecordWindow], conditions: dict[str, Any]
) -> list[dict[str, Any]]:
    channel = conditions["channel"]
    unit_degC = float(thermal.unit_degC(times_ns(windows)).mean())
    n_ppm, p_ppm = float(truth.dsf_n_ppm(channel, unit_degC)), float(truth.dsf_p_ppm(channel, unit_degC))
    open_ns = times_ns([w for w in windows if w.conditions.get("route") == "open"] or windows)
    offset_degC = thermal.play_offset_degC(open_ns, truth.half_width_degC[channel - 1])
    bias_A = truth.bias_A(channel, thermal.unit_degC(open_ns), open_ns / NS, offset_degC).mean()
    return [
        entry("dsf_n", "ppm", n_ppm, conditions),
        entry("dsf_p", "ppm", p_ppm, conditions),
        entry("dsf_asymmetry", "ppm", n_ppm - p_ppm, conditions),
        entry("bias", "A", bias_A, conditions),
    ]


def _clocks(truth: UnitTruth, unit_degC: np.ndarray, conditions: dict[str, Any]) -> list[dict[str, Any]]:
    master = truth.master_error_ppm(unit_degC) * 1e-6
    ratio = (1.0 + master) / (1.0 + truth.af_clock_error_ppm * 1e-6) - 1.0
    return [
        entry("clock_ratio_error", "ppm", ratio.mean() * 1e6, conditions),
        entry("master_clock_error", "ppm", master.mean() * 1e6, conditions),
    ]


def _coefficients(truth: UnitTruth, channel: int, kind: str) -> list[dict[str, Any]]:
    conditions = {"channel": channel, "kind": kind, "reference_temperature_degC": REFERENCE_TEMPERATURE_DEGC}
    found = []
    for side in ("n", "p"):
        tc1, tc2 = truth.tc_ppm(channel, side, REFERENCE_TEMPERATURE_DEGC)
        found.append(entry(f"dsf_{side}_tc1", "ppm/degC", tc1, conditions))
        found.append(entry(f"dsf_{side}_tc2", "ppm/degC2", tc2, conditions))
    return found
