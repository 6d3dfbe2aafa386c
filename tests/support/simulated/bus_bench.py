"""For tests of the bus: a simulated bench with every model once, and drivers with all their rungs."""

from __future__ import annotations

import importlib
from typing import Any
from unittest.mock import MagicMock

import pyvisa
from pyvisa.resources import MessageBasedResource

from bench.model.clock import VirtualClock
from sim_instruments.worlds.simulation import open_world

SEED = 41
DRIVERS = (
    "agilent_33250a", "agilent_34401a", "agilent_34970a", "agilent_53230a", "agilent_e3631a",
    "fluke_5720a", "hp_3458a", "hp_6632b", "keithley_7002", "thermotron_3800",
)  # fmt: skip
ADDRESS = {name: f"GPIB0::{number}::INSTR" for number, name in enumerate(DRIVERS, 1)}


class Bench:
    """A simulated bench with every model once; ``lines`` is the transcript."""

    def __init__(self) -> None:
        self.clock = VirtualClock()
        self.lines: list[tuple[str, str, str, int]] = []
        entries = {name: {"driver": name, "resource": at, "options": {}} for name, at in ADDRESS.items()}
        station = {"instruments": entries, "links": {}}
        self.world = open_world(
            "af_converter", clock=self.clock, seed=SEED, station=station, unit_factory=lambda *_: MagicMock()
        )
        self.visa = pyvisa.ResourceManager(self.world.visa_library)

    def open(self, name: str) -> MessageBasedResource:
        return self.visa.open_resource(ADDRESS[name], resource_pyclass=MessageBasedResource)  # type: ignore[return-value]

    def driver(self, name: str, resource: Any = None, rungs: dict[str, Any] | None = None, **options: Any) -> Any:
        return importlib.import_module(f"instruments.{name}").DRIVER(
            resource or self.open(name), role=name, clock=self.clock, options=options,
            transcript=lambda *line: self.lines.append(line), **(rungs or {}),
        )  # fmt: skip

    def sent(self) -> list[str]:
        return [text for _, direction, text, _ in self.lines if direction == "tx" and not text.startswith("<")]

    def close(self) -> None:
        self.visa.close()
        self.world.close()
