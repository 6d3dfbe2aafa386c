"""A synthetic campaign for the tests of the report: ten channels, five temperatures, seeded numbers, no physics."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
from planned_step import planned

from bench.model.quality import Quality
from bench.plan import Step
from bench.report import RunStory, Surrounding, TemperatureTrace, report_model
from bench.report.model import ReportModel

TEMPERATURES_degC = (-10.0, 5.0, 20.0, 35.0, 50.0)
LEVELS_A = {
    "gyro": (3e-5, 1e-4, 1e-3, 1e-2, 0.1, 0.2),
    "accelerometer": (5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2),
}
_SLOT_s, _POINT_s = 9000.0, 120.0


@dataclass(frozen=True)
class SamplePlan:
    title: str
    steps: tuple[Step, ...]
    prepare_s: float


def kind_of(channel: int) -> str:
    return "gyro" if channel <= 6 else "accelerometer"


def sample_steps(temperatures: tuple[float, ...] = TEMPERATURES_degC) -> tuple[Step, ...]:
    steps = [planned("prompt", phase="prepare"), planned("settle", phase="prepare", duration_s=600.0)]
    now_s = 0.0
    for index, temperature in enumerate(temperatures):
        told = {"temperature": temperature, "ramp": 0.5, "conditions": {"temperature_degC": temperature}}
        steps.append(planned("soak", at_s=now_s, duration_s=_SLOT_s, **told))
        now_s += _SLOT_s
        rounds = [(channel, 0) for channel in range(1, 11)]
        rounds += [(1, 1)] if index == len(temperatures) - 1 else []
        for channel, repeat in rounds:
            for _ in range(15):
                conditions = {"channel": channel, "repeat": repeat}
                steps.append(planned("settle", at_s=now_s, duration_s=20.0, conditions={"channel": channel}))
                steps.append(planned("record", at_s=now_s + 20.0, duration_s=100.0, conditions=conditions))
                now_s += _POINT_s
    steps.append(planned("settle", phase="finally", duration_s=60.0))
    return tuple(steps)


def estimate(quantity: str, unit: str, value: float, expanded: float, **conditions: Any) -> dict[str, Any]:
    found = {"quantity": quantity, "unit": unit, "value": value, "conditions": conditions, "n": 14, "dropped": 0}
    stated = {"std_uncertainty": expanded / 1.96, "coverage_factor": 1.96, "expanded_uncertainty": expanded}
    return {**found, **stated, "limit": None, "verdict": "none"}


def unsound(entry: dict[str, Any], quality: str = "doubtful") -> dict[str, Any]:
    """Return an entry as a check leaves it that speaks against it."""
    numbers = "std_uncertainty", "coverage_factor", "expanded_uncertainty", *["value"] * (quality == "refused")
    reason = {"code": "odd", "sentence": "It is odd.", "figure": None}
    return {**entry, **dict.fromkeys(numbers), "quality": quality, "reasons": [reason], "verdict": "indeterminate"}


def sample_estimates(rng: np.random.Generator) -> list[dict[str, Any]]:
    rows = []
    for channel in range(1, 11):
        base = {"channel": channel, "kind": kind_of(channel)}
        n, p = rng.normal(0.0, 400.0, 2)
        for t in TEMPERATURES_degC:
            where = {**base, "temperature_degC": t, "unit_temperature_degC": t + 0.4}
            rows.append(estimate("dsf_n", "ppm", n + 8.0 * (t - 20), 19.9, **where))
            rows.append(estimate("dsf_p", "ppm", p + 7.0 * (t - 20), 19.9, **where))
            rows.append(estimate("dsf_asymmetry", "ppm", n - p + (t - 20), 0.2, **where))
            rows.append(estimate("bias", "A", -4e-7, 1e-8, **where))
        reference = {**base, "reference_temperature_degC": 20.0}
        for order, unit, value in (("tc0", "", 100.0), ("tc1", "/degC", 8.0), ("tc2", "/degC2", 0.03)):
            rows += [estimate(f"{q}_{order}", f"ppm{unit}", value, value / 50, **reference) for q in ("dsf_n", "dsf_p")]
            rows.append(estimate(f"bias_{order}", f"A{unit}", value * 1e-9, value * 1e-11, **reference))
    drift = {"channel": 1, "kind": "gyro", "temperature_degC": 50.0, "repeat": 1}
    rows.append(estimate("dsf_n_drift", "ppm", 0.3, 2.1, **drift))
    rows.append(estimate("master_clock_error", "ppm", 1.5, 0.01, temperature_degC=50.0))
    return rows


def sample_results(simulated: bool = True) -> dict[str, Any]:
    hashes = {"plan_sha256": "ab" * 32, "frame_sha256": "cd" * 32, "session_sha256": "ef" * 32}
    frames = {"frames": 15_048_000, "frames_bad": 3, "frames_lost": 2}
    return {
        "schema": 1,
        "session": "20000101T000000Z_scale_factor_38h_SIM-1",
        "campaign": "scale_factor",
        "uut": {"model": "NGU", "serial": "SIM-1"},
        "estimates": sample_estimates(np.random.default_rng(7)),
        "quality": {"records": 765, **frames, "splices": 0, "retaken": 1},
        "provenance": {"simulated": simulated, **hashes, "software": "inertial-bench 0.1.0"},
    }


def sample_residuals(rng: np.random.Generator) -> list[dict[str, Any]]:
    rows = []
    for channel in range(1, 11):
        floor_A = 5e-9 if channel <= 6 else 4e-10
        for t in TEMPERATURES_degC:
            for level in LEVELS_A[kind_of(channel)]:
                for sign in (1, -1):
                    residual = rng.normal(0.0, floor_A + 1e-6 * level)
                    where = {"channel": channel, "kind": kind_of(channel), "temperature_degC": t}
                    rows.append({**where, "current_A": sign * level, "residual_A": residual})
            rows.append({"channel": channel, "temperature_degC": t, "current_A": 0.0, "residual_A": floor_A})
    return rows


def sample_trace() -> TemperatureTrace:
    t_s = np.arange(0.0, 136_800.0, 10.0)
    corners = np.array([0, 3960, 27000, 28800, 54000, 55800, 81000, 82800, 108000, 109800, 136800])
    air = np.interp(t_s, corners, [23, -10, -10, 5, 5, 20, 20, 35, 35, 50, 50])
    unit = air.copy()
    for index in range(1, unit.size):
        unit[index] = unit[index - 1] + (air[index] - unit[index - 1]) * 10 / 1500
    return TemperatureTrace(t_s, air, unit)


def sample_room() -> Surrounding:
    t_s = np.arange(0.0, 136_800.0, 1500.0)
    return Surrounding("logger 101", t_s, 23.0 + 0.2 * np.sin(t_s / 2e4), laboratory=True)


def sample_manifest() -> dict[str, Any]:
    kinds = {"gyro": (0.299, 83.0, "deg/s"), "accelerometer": (0.0242, 20.2, "g")}
    keys = ("full_scale_A", "sensor_full_scale", "sensor_unit")
    channels = [
        {"number": number, "kind": kind_of(number), **dict(zip(keys, kinds[kind_of(number)], strict=True))}
        for number in range(1, 11)
    ]
    certificate = {"certificate": "SIM-0001", "calibrated": "1999-11-01", "due": "2000-11-01"}
    corrections = [{"range_A": 2.2e-4, "gain": 0.0, "offset_A": 0.0}]
    standard = {"driver": "fluke_5720a", "model": "5720A", "serial": "SIM-5720", **certificate}
    standard |= {"corrections": corrections}
    return {
        "title": "AF-converter scale factor, 5 temperatures x 10 channels x 15 steps",
        "campaign": {"reference_temperature_degC": 20.0, "channels": channels},
        "standards": {"calibrator": standard, "counter": {**standard, "model": "53230A", "corrections": []}},
        "software": {"python": "3.11", "packages": {"numpy": "2.4"}},
        "identities": {"calibrator": {"manufacturer": "FLUKE", "model": "5720A"}},
    }


def sample_model(simulated: bool = True) -> ReportModel:
    window = SimpleNamespace(conditions={"channel": 1})
    rows = [SimpleNamespace(window=window, frames=10_000, lost=0, bad=0, quality=Quality.GOOD)] * 764
    flags = Quality.LOST | Quality.RETAKEN
    rows.append(SimpleNamespace(window=window, frames=9_990, lost=10, bad=2, quality=flags))
    return report_model(
        sample_results(simulated),
        rows,
        sample_steps(),
        sample_trace(),
        sample_manifest(),
        residuals=sample_residuals(np.random.default_rng(8)),
        components=[
            {"kind": "gyro", "component": "calibrator gain", "distribution": "normal", "std_uncertainty_ppm": 10.0},
            {"kind": "gyro", "component": "quantisation", "distribution": "triangular", "std_uncertainty_ppm": 1.84},
        ],
        prompts=[{"step": 0, "text": "Calibrator output floating?", "confirm": "operator", "by": "simulation"}],
        notes=["The bias of this campaign is diagnostic; it enters no coefficient."],
        run=sample_story(),
    )


def sample_story() -> RunStory:
    return RunStory(
        commands=({"time": "1:00:00", "what": "pause", "by": "A. Person, operator", "reason": "lunch"},),
        alarms=({"time": "2:00:00", "what": "interlock", "text": "lab_air warned: 24.3 degC, limit 24 degC"},),
        surroundings=(sample_room(),),
        length_s=140_657.0,
        hashes={"sequences/scale_factor_38h.yaml": "12" * 32},
    )


def small_model() -> ReportModel:
    """The same with one channel and no residuals: for tests of what is not drawn."""
    model = sample_model()
    rows = [row for row in model.results["estimates"] if row["conditions"].get("channel", 1) == 1]
    return replace(model, results={**model.results, "estimates": rows}, residuals=())
