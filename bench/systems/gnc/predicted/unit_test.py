"""Predicts how well a unit test will know the values it measures: its judges on the answers of a nominal module."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from bench.analysis import UNIT, Estimates, Planned, Prediction
from bench.systems.gnc.estimators.sensor_noise import SensorNoise, expected_range
from bench.systems.gnc.limits import Limits, limits_of
from bench.systems.gnc.predicted.declared import noise_of
from bench.systems.gnc.unit_test.analysis import values_of_item
from bench.systems.gnc.unit_test.answers import Answer, Findings, asked_of
from bench.systems.gnc.unit_test.processor import judge_timer
from bench.systems.gnc.unit_test.sensors import judge_imu
from bench.systems.gnc.unit_test.units import ItemResult, unit_of
from bench.systems.gnc.wording import say

_AT_REST = {"gyro": np.zeros(3), "accel": np.array([0.0, 0.0, 1.0])}
_LABORATORY_degC = 25.0
_SENSORS = {"gyro": "gyro", "accel": "accelerometer"}


def predicted(planned: Planned) -> Prediction:
    """Return measured values of nominal modules with the uncertainties that their tests will give.

    Raises:  FitError B-GNC-001 for limits that are not usable.
    """
    limits, missing = limits_of(planned.campaign), list[str]()
    of_units: dict[str, dict[str, list[Answer]]] = {}
    for exchange in planned.exchanges:
        if exchange.item == exchange.name in ("timer", "imu"):
            asked = asked_of(exchange)
            if not asked:
                missing.append(say("predicted.other_request", item=exchange.item, length=len(exchange.sent)))
                continue
            unit = unit_of(exchange.conditions, str(planned.campaign["uut"]["serial"]))
            of_units.setdefault(unit, {}).setdefault(exchange.item, []).append(Answer(exchange, asked, {}))
    asked_imu = any("imu" in items for items in of_units.values())
    noise = {name: noise_of(planned.campaign, kind, missing) for name, kind in _SENSORS.items()} if asked_imu else {}
    estimates: Estimates = []
    for unit, items in of_units.items():
        for item, answers in items.items():
            found = _timer(answers, limits) if item == "timer" else _imu(answers, limits, noise)
            estimates += values_of_item(ItemResult(item, found, len(answers)), {UNIT: unit})
    return Prediction([entry for entry in estimates if entry["std_uncertainty"] > 0.0], list(dict.fromkeys(missing)))


def _timer(answers: list[Answer], limits: Limits) -> Findings:
    return judge_timer([replace(answer, fields=_on_time(answer)) for answer in answers], limits)


def _on_time(answer: Answer) -> dict[str, Any]:
    setting_us, ticks = answer.asked["setting_us"], answer.asked["ticks"]
    return {"intervals_us": [setting_us] * ticks, "interrupts": ticks}


def _imu(answers: list[Answer], limits: Limits, noise: Mapping[str, SensorNoise | None]) -> Findings:
    return judge_imu([replace(answer, fields=_at_rest(answer, noise)) for answer in answers], limits, {})


def _at_rest(answer: Answer, noise: Mapping[str, SensorNoise | None]) -> dict[str, Any]:
    """Return means and extremes of a module at rest; sensors whose noise is not declared have none."""
    samples = int(answer.asked["samples"])
    fields: dict[str, Any] = {"samples": samples}
    for name, mean in _AT_REST.items():
        declared = noise[name]
        std = 0.0 if declared is None else math.sqrt(declared.density / declared.interval_s)
        reach = std * expected_range(samples) / 2.0 if samples > 1 else 0.0
        fields |= {name: mean, f"{name}_low": mean - reach, f"{name}_high": mean + reach}
        fields[f"{name}_temperature"] = _LABORATORY_degC
    return fields
