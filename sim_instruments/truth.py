"""Simulated truth: what a perfect analysis of the records would find. Nothing of the product reads it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from bench.model.clock import NS
from bench.model.ports import RecordWindow
from sim_instruments.thermal import Thermal

REFERENCE_TEMPERATURE_DEGC = 20.0
_POINTS_PER_WINDOW = 11


class UnitTruth(Protocol):
    """True parameters of the unit under test; channels are numbered from 1."""

    af_clock_error_ppm: float

    def dsf_n_ppm(self, channel: Any, unit_degC: Any) -> Any:
        """Scale-factor error of the N pulses (positive currents), ppm."""

    def dsf_p_ppm(self, channel: Any, unit_degC: Any) -> Any:
        """Scale-factor error of the P pulses, ppm."""

    def tc_ppm(self, channel: int, polarity: str, about_degC: float) -> tuple[float, float]:
        """Coefficients of side "n" or "p" about a temperature: ppm/degC and ppm/degC²."""

    def bias_A(self, channel: Any, unit_degC: Any, t_s: Any) -> Any:
        """i_AFbias, ampere: the correction added to the reading, negative of the open-input reading."""

    def master_error_ppm(self, unit_degC: Any) -> Any:
        """Relative error of the master oscillator, ppm."""


def estimates(truth: UnitTruth, thermal: Thermal, windows: Sequence[RecordWindow]) -> list[dict[str, Any]]:
    """True values in the contract's form, one block per channel and temperature of the measuring windows.

    Scale factors are those at the unit's true temperature averaged over the windows of that channel and temperature
    (wiring checks and closing repeats left out); the bias is averaged over the open-input windows among them.
    """
    found: list[dict[str, Any]] = []
    groups = _groups(windows)
    for (channel, kind, nominal_degC), group in groups.items():
        conditions = {"channel": channel, "kind": kind, "temperature_degC": nominal_degC}
        found += _at_temperature(truth, thermal, group, conditions)
    for channel, kind in dict.fromkeys((channel, kind) for channel, kind, _ in groups):
        found += _coefficients(truth, channel, kind)
    for nominal_degC in sorted({nominal_degC for _, _, nominal_degC in groups}):
        spans = [w for (_, _, degC), group in groups.items() if degC == nominal_degC for w in group]
        found += _clocks(truth, thermal.unit_degC(_times_ns(spans)), {"temperature_degC": nominal_degC})
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


def _times_ns(windows: Sequence[RecordWindow]) -> np.ndarray:
    return np.concatenate([np.linspace(w.t_start_ns, w.t_end_ns, _POINTS_PER_WINDOW).astype(np.int64) for w in windows])


def _at_temperature(
    truth: UnitTruth, thermal: Thermal, windows: Sequence[RecordWindow], conditions: dict[str, Any]
) -> list[dict[str, Any]]:
    channel = conditions["channel"]
    unit_degC = float(thermal.unit_degC(_times_ns(windows)).mean())
    n_ppm, p_ppm = float(truth.dsf_n_ppm(channel, unit_degC)), float(truth.dsf_p_ppm(channel, unit_degC))
    open_ns = _times_ns([w for w in windows if w.conditions.get("route") == "open"] or windows)
    bias_A = truth.bias_A(channel, thermal.unit_degC(open_ns), open_ns / NS).mean()
    return [
        _estimate("dsf_n", "ppm", n_ppm, conditions),
        _estimate("dsf_p", "ppm", p_ppm, conditions),
        _estimate("dsf_asymmetry", "ppm", n_ppm - p_ppm, conditions),
        _estimate("bias", "A", bias_A, conditions),
    ]


def _clocks(truth: UnitTruth, unit_degC: np.ndarray, conditions: dict[str, Any]) -> list[dict[str, Any]]:
    master = truth.master_error_ppm(unit_degC) * 1e-6
    ratio = (1.0 + master) / (1.0 + truth.af_clock_error_ppm * 1e-6) - 1.0
    return [
        _estimate("clock_ratio_error", "ppm", ratio.mean() * 1e6, conditions),
        _estimate("master_clock_error", "ppm", master.mean() * 1e6, conditions),
    ]


def _coefficients(truth: UnitTruth, channel: int, kind: str) -> list[dict[str, Any]]:
    conditions = {"channel": channel, "kind": kind, "reference_temperature_degC": REFERENCE_TEMPERATURE_DEGC}
    found = []
    for side in ("n", "p"):
        tc1, tc2 = truth.tc_ppm(channel, side, REFERENCE_TEMPERATURE_DEGC)
        found.append(_estimate(f"dsf_{side}_tc1", "ppm/degC", tc1, conditions))
        found.append(_estimate(f"dsf_{side}_tc2", "ppm/degC2", tc2, conditions))
    return found


def _estimate(quantity: str, unit: str, value: float, conditions: dict[str, Any]) -> dict[str, Any]:
    return {"quantity": quantity, "unit": unit, "value": float(value), "conditions": conditions}
