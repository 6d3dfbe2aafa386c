"""Two simulated lock-in amplifiers, a filter and a level with their drivers, on a bench with a signal of its own."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any
from unittest.mock import MagicMock

import pyvisa
from lock_in_rig import Turning
from pyvisa.resources import MessageBasedResource

from bench.model.clock import VirtualClock
from sim_instruments.worlds.simulation import open_world


class NorthBench:
    """Two lock-in amplifiers, one behind the filter; the table turns at 1 Hz from the beginning."""

    def __init__(self, table: Turning, **options: Any) -> None:
        self.clock = VirtualClock()
        self.on_line: Callable[..., None] = lambda *_: None
        entries = {
            "direct": {"driver": "srs_sr830", "resource": "GPIB0::8::INSTR", "options": {"input": "fog"} | options},
            "filtered": {
                "driver": "srs_sr830", "resource": "GPIB0::9::INSTR",
                "options": {"input": "filter", "reference": "index_b"} | options,
            },
            "filter": {"driver": "krohn_hite_3988", "resource": "GPIB0::10::INSTR", "options": {}},
            "level": {"driver": "leica_nivel_220", "resource": "ASRL3::INSTR", "options": {}},
        }  # fmt: skip
        station = {"instruments": entries, "links": {}}
        self.world: Any = open_world(
            "af_converter", clock=self.clock, seed=1, station=station, unit_factory=lambda *_: MagicMock()
        )
        self.world.waveform, self.world.pulses = table.waveform, table.pulses
        self.visa = pyvisa.ResourceManager(self.world.visa_library)
        self.driver = {role: self._open(role, entry) for role, entry in entries.items()}

    def _open(self, role: str, entry: dict[str, Any]) -> Any:
        resource = self.visa.open_resource(entry["resource"], resource_pyclass=MessageBasedResource)
        made = importlib.import_module(f"instruments.{entry['driver']}").DRIVER
        return made(resource, role=role, clock=self.clock, transcript=self._line, options=entry["options"])

    def _line(self, *line: Any) -> None:
        self.on_line(*line)

    def close(self) -> None:
        self.visa.close()
        self.world.close()
