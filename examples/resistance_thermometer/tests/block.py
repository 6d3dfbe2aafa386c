"""A campaign without instruments: readings made of the simulated elements, with meters whose errors are drawn here."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from bench.analysis import Material, Reading
from bench.model.clock import NS, VirtualClock
from bench.model.ports import RecordWindow
from bench.model.quantities import Quality
from bench.plan import Plan, compile_sequence
from bench.plan.station import load_station
from bench.record import RecordRow

from resistance_thermometer.world.world import CHANNELS, BlockWorld

ROOT = Path(__file__).parents[1]
SEQUENCE = ROOT / "sequences" / "resistance_thermometer.yaml"
STATION = ROOT / "stations" / "thermometer_bench_sim.yaml"
SETPOINTS_DEGC = (0.0, -20.0, -40.0, 20.0, 40.0, 60.0, 80.0, 100.0)
SLOT_S, EVERY_S, ROUNDS = 7800.0, 30.0, 20
GAIN, ZERO_OHM, NOISE_OHM = 50e-6, 0.005, 0.00033
AIR_OFFSET_DEGC = 0.1


@cache
def plan() -> Plan:
    return compile_sequence(SEQUENCE)


@cache
def standards() -> dict[str, dict[str, Any]]:
    return load_station(STATION).standards()


def material(seed: int, **options: Any) -> tuple[Material, list[dict[str, Any]]]:
    """What a campaign gives, and its truth."""
    world = BlockWorld(clock=VirtualClock(), seed=seed, options=options)
    try:
        windows = [_soaked(world, number, degC) for number, degC in enumerate(SETPOINTS_DEGC)]
        rows = [RecordRow(window, {}, 0, 0, 0, Quality.GOOD, readings=ROUNDS * 6) for window in windows]
        readings = [reading for window in windows for reading in _readings(world, window)]
        return Material(rows, plan().campaign, standards(), readings=readings), world.truth(windows)
    finally:
        world.close()


def _soaked(world: BlockWorld, number: int, degC: float) -> RecordWindow:
    begin_ns = round(number * SLOT_S * NS)
    world.thermal.ramp(degC, 2.0, begin_ns)
    start_ns = begin_ns + round(7200.0 * NS)
    end_ns = start_ns + round(ROUNDS * EVERY_S * NS)
    return RecordWindow(number + 1, "", 0, 0, start_ns, end_ns, {"temperature_degC": degC}, number)


def _readings(world: BlockWorld, window: RecordWindow) -> Iterator[Reading]:
    errors = {role: world.rng(f"{role} ohms").normal(0.0, (GAIN, ZERO_OHM)) for role in ("scanner", "meter")}
    noise = world.rng("noise", window.number)
    for number in range(ROUNDS):
        t_ns = window.t_start_ns + round((number * EVERY_S + 5.0) * NS)
        for role, channel in (*(("scanner", channel) for channel in CHANNELS), ("meter", 0)):
            source = world.terminals.source(role, channel)
            assert source is not None
            ohm = source.ohm(4, t_ns)
            value = float(ohm * (1.0 + errors[role][0]) + errors[role][1] + noise.normal(0.0, NOISE_OHM))
            arguments = {"channel": channel} if channel else {}
            yield Reading(t_ns / NS, window.step, role, "measure_resistance", value, window.conditions, arguments)
        air_degC = float(world.thermal.air_degC(t_ns)) + AIR_OFFSET_DEGC
        yield Reading(t_ns / NS, window.step, "chamber", "measure_air", air_degC, window.conditions)


def by_place(estimates: list[dict[str, Any]], quantity: str) -> dict[tuple[Any, ...], dict[str, Any]]:
    """Estimates of one quantity by channel and set-point."""
    return {
        (entry["conditions"]["channel"], entry["conditions"].get("temperature_degC")): entry
        for entry in estimates
        if entry["quantity"] == quantity
    }


def with_noise(values: np.ndarray, seed: int, std: float) -> np.ndarray:
    return values + np.random.default_rng(seed).normal(0.0, std, values.shape)
