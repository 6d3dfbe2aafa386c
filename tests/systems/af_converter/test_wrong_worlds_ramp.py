"""Ramps of wrong worlds: the joint fit of a bias ramp is doubted there, and not in a right one.

Heat, slack and pulses are those of support/systems (bias_simulation); nothing of the product makes them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bias_simulation as sim
import numpy as np
import pytest

from bench.analysis import Material, Trace, build_results, is_sound
from bench.systems.af_converter.bias_ramp.analysis import analyse

PROVENANCE = {"simulated": True, "plan_sha256": "", "frame_sha256": "", "session_sha256": "", "software": "test"}


def results_of(ramps: dict[int, Any]) -> dict[str, Any]:
    world = next(iter(ramps.values()))
    trace = Trace(world.trace_t_s, world.air_degC, world.sensor_degC)
    analysis = analyse(Material(sim.rows(ramps), sim.campaign(ramps), {"generator": {}}, trace))
    return build_results("session", analysis, {}, PROVENANCE)


def doubted(results: dict[str, Any], quantity: str, channel: int = 1) -> set[str]:
    """Return the codes against a quantity of a channel; it must not look sound."""
    entries = [
        one
        for one in results["estimates"]
        if one["quantity"] == quantity and one["conditions"].get("channel") == channel
    ]
    assert entries
    assert not any(is_sound(one) for one in entries)
    return {reason["code"] for one in entries for reason in one["reasons"]}


@pytest.fixture
def three_plays(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three pistons in parallel, each a third of the hysteresis: slack of 0.4, 1.5 and 3.5 times the half-width."""
    one = sim.slack

    def parallel(temperature: np.ndarray, half_width: float) -> np.ndarray:
        pistons = [(one(temperature, half_width * times) - temperature) / times for times in (0.4, 1.5, 3.5)]
        return temperature + np.mean(pistons, axis=0)

    monkeypatch.setattr(sim, "slack", parallel)


@pytest.mark.usefixtures("three_plays")
@pytest.mark.parametrize("seed", range(3))
def test_hysteresis_of_three_plays_is_doubted_and_the_rival_has_the_width(seed: int) -> None:
    ramp = sim.ramp(seed)
    results = results_of({1: ramp})
    assert {"lack_of_fit", "rival_several_play_operators"} <= doubted(results, "hysteresis_width")
    sentences = [reason["sentence"] for one in results["estimates"] for reason in one["reasons"]]
    (said,) = {one for one in sentences if one.startswith("Several play operators describe channel 1")}
    width_nA = float(said.split("about ")[1].split(" nA")[0])
    assert width_nA == pytest.approx(1e9 * ramp.unit.width_A, abs=4.0)
    assert max(len(one) for one in sentences) <= 200


@pytest.mark.parametrize("seed", range(3))
def test_two_thermal_lags_without_hysteresis_are_doubted(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of the converter follows the air within 25 min, half within 150 min."""
    quick = sim.heat(1500.0)
    both = (quick.unit_degC + sim.follow(quick.air_degC, 9000.0)) / 2.0
    monkeypatch.setattr(sim, "heat", lambda _=0.0: sim.Heat(quick.t_s, quick.air_degC, both, quick.windows))
    unit = sim.draw(np.random.default_rng(seed), "gyro", hysteresis=False)
    assert "rival_second_thermal_lag" in doubted(results_of({1: sim.ramp(seed, "gyro", unit)}), "hysteresis_width")


def test_a_step_of_the_bias_is_doubted_on_its_channel_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    flow: Callable[..., Any] = sim.flow

    def jumping(unit: Any, rng: np.random.Generator, **switches: bool) -> Any:
        made = flow(unit, rng, **switches)
        if unit.kind == "accelerometer":
            return made
        late = np.arange(made.bias_A.size) > 0.6 * made.bias_A.size
        bias = made.bias_A + 1e-8 * late
        charge = made.charge_C - np.concatenate(([0.0], np.cumsum(1e-8 * late[1:]) * sim.STEP_s))
        return sim.Flow(bias, charge, made.walk_A)

    monkeypatch.setattr(sim, "flow", jumping)
    results = results_of({1: sim.ramp(1), 2: sim.ramp(2, "accelerometer")})
    assert "rival_step" in doubted(results, "bias")
    assert all(is_sound(one) for one in results["estimates"] if one["conditions"].get("channel") == 2)


@pytest.mark.parametrize("hysteresis", [True, False])
@pytest.mark.parametrize("seed", range(8))
def test_a_right_ramp_is_not_doubted(seed: int, hysteresis: bool) -> None:
    rng = np.random.default_rng(seed)
    kinds = ("gyro", "accelerometer")
    ramps = {
        number: sim.ramp(seed + 50 * number, kind, sim.draw(rng, kind, hysteresis=hysteresis))
        for number, kind in enumerate(kinds, 1)
    }
    results = results_of(ramps)
    assert [one["reasons"] for one in results["estimates"] if not is_sound(one)] == []
