"""A simulated bench for tests: the ten instruments, and a unit that only writes down what its inputs see."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
import pyvisa

from bench.model.clock import Clock, VirtualClock
from sim_instruments.worlds.common.world import World
from sim_instruments.worlds.simulation import open_world

DRIVERS = {
    "calibrator": "fluke_5720a",
    "switch": "keithley_7002",
    "dmm": "hp_3458a",
    "function_generator": "agilent_33250a",
    "counter": "agilent_53230a",
    "chamber": "thermotron_3800",
    "supply": "hp_6632b",
    "aux_supply": "agilent_e3631a",
    "logger": "agilent_34970a",
    "rail_dmm": "agilent_34401a",
}
ADDRESSES = {role: f"GPIB0::{number}::INSTR" for number, role in enumerate(DRIVERS, start=4)}


class PlainTruth:
    """Parameters chosen so that every expected value can be written down."""

    af_clock_error_ppm = 20.0
    kinds = ("gyro",) * 6 + ("accelerometer",) * 4
    half_width_degC = np.full(10, 2.0)
    hysteresis_A = np.full(10, 8e-9)

    def dsf_n_ppm(self, channel: Any, unit_degC: Any) -> Any:
        return 100.0 * channel + unit_degC

    def dsf_p_ppm(self, channel: Any, unit_degC: Any) -> Any:
        return 50.0 * channel + 0 * unit_degC

    def tc_ppm(self, channel: int, polarity: str, about_degC: float) -> tuple[float, float]:
        return (1.0 if polarity == "n" else 0.0, about_degC / 1000.0)

    def bias_A(self, channel: Any, unit_degC: Any, t_s: Any, play_offset_degC: Any = 0.0) -> Any:
        return 1e-9 * channel + 0 * unit_degC + 1e-12 * t_s + 2e-9 * play_offset_degC

    def bias_tc_A(self, channel: int, order: int) -> float:
        return 1e-12 * channel / order

    def master_error_ppm(self, unit_degC: Any) -> Any:
        return np.asarray(unit_degC) * 0 + 1.5

    def master_tc_ppm(self, order: int) -> float:
        return 0.0 if order else 1.5


class RecordingUnit:
    """Writes down every change of its inputs, with the time."""

    def __init__(self, clock: Clock, seed: int, thermal: Callable[[Any], Any], options: Mapping[str, str]) -> None:
        self.clock, self.seed, self.thermal, self.options = clock, seed, thermal, dict(options)
        self.truth = PlainTruth()
        self.inputs: dict[int, float | None] = dict.fromkeys(range(1, 11))
        self.history: list[tuple[int, int, float | None]] = []
        self.power: list[tuple[int, bool, float]] = []
        self.fg: list[tuple[int, float]] = []

    def set_input(self, channel: int, current_A: float, t_ns: int) -> None:
        self.inputs[channel] = current_A
        self.history.append((t_ns, channel, current_A))

    def set_open(self, channel: int, t_ns: int) -> None:
        self.inputs[channel] = None
        self.history.append((t_ns, channel, None))

    def set_power(self, on: bool, t_ns: int, voltage_V: float) -> None:
        self.power.append((t_ns, on, voltage_V))

    def set_fg(self, frequency_Hz: float, t_ns: int) -> None:
        self.fg.append((t_ns, frequency_Hz))


class Bench:
    """An open world with one PyVISA resource per role."""

    def __init__(self, world: World, manager: pyvisa.ResourceManager) -> None:
        self.world = world
        self.clock: Any = world.clock
        self.unit: Any = world.unit
        self.manager = manager
        self._resources: dict[str, Any] = {}

    def __getitem__(self, role: str) -> Any:
        if role not in self._resources:
            self._resources[role] = self.manager.open_resource(
                ADDRESSES[role], read_termination="\n", write_termination="\n"
            )
        return self._resources[role]

    def ask(self, role: str, *messages: str) -> str:
        """Send the messages but the last, then query that one."""
        for message in messages[:-1]:
            self[role].write(message)
        return str(self[role].query(messages[-1]))

    def send(self, role: str, *messages: str) -> None:
        """Send messages that have no reply."""
        for message in messages:
            self[role].write(message)


def station(options: Mapping[str, Mapping[str, Any]] | None = None) -> dict[str, Any]:
    """The ten instruments at their addresses; ``options`` by role."""
    entries = {
        role: {"driver": driver, "resource": ADDRESSES[role], "options": dict((options or {}).get(role, {}))}
        for role, driver in DRIVERS.items()
    }
    return {"instruments": entries, "links": {}}


@contextmanager
def open_bench(
    seed: int = 1,
    clock: Clock | None = None,
    options: Mapping[str, str] | None = None,
    instruments: Mapping[str, Mapping[str, Any]] | None = None,
) -> Iterator[Bench]:
    """Open a bench around a ``RecordingUnit`` and close everything afterwards."""
    world = open_world(
        "af_converter",
        clock=clock or VirtualClock(),
        seed=seed,
        station=station(instruments),
        options=options,
        unit_factory=RecordingUnit,
    )
    manager = pyvisa.ResourceManager(world.visa_library)
    try:
        yield Bench(world, manager)
    finally:
        manager.close()
        world.close()
