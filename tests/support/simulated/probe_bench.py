"""A bench without a serial unit: three resistances in a chamber, read by a scanner and a meter. World, files, analysis.

Probe 1 and 2 hang at channels 101 and 102 of the scanner, the reference at the meter; all follow the chamber's unit.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bench.analysis import registry
from bench.analysis.analysis import Analysis
from bench.analysis.estimates import estimate
from bench.analysis.material import Material
from bench.plan import Plan, check_analysis, check_plan, compile_sequence
from sim_instruments.worlds import simulation
from sim_instruments.worlds.common.terminals import Source
from sim_instruments.worlds.common.thermal import Thermal
from sim_instruments.worlds.common.world import World

ANALYSIS = "probe_means"
OHM_AT_0, OHM_PER_DEGC = 100.0, 0.39
LEAD_OHM = 1.5
TEMPERATURES_DEGC = (23.0, 40.0)

STATION = """\
station: probe_bench
title: Resistances in a chamber, simulated
simulated: true
visa: "@bench"

world:
  name: probes

instruments:
  chamber:
    driver: thermotron_3800
    resource: GPIB0::9::INSTR
    safe_order: 1
    options: {dialect: "8800"}
    limits: {temperature: [-20 degC, 60 degC]}
    standard: {model: "8800", serial: SIM8800, certificate: SIM-1, calibrated: "1999-11-01", due: "2000-11-01"}
  scanner:
    driver: agilent_34970a
    resource: GPIB0::10::INSTR
    safe_order: 2
    options: {thermocouple: none, channels: []}
    standard: {model: 34970A, serial: SIM34970, certificate: SIM-2, calibrated: "1999-11-01", due: "2000-11-01"}
  meter:
    driver: agilent_34401a
    resource: GPIB0::22::INSTR
    safe_order: 3
    standard: {model: 34401A, serial: SIM34401, certificate: SIM-3, calibrated: "1999-11-01", due: "2000-11-01"}

links: {}
"""

RECORD = """\
      - record:
          seconds: 60 s
          every: 20 s
          readings:
            - scanner.measure_resistance: {channel: 101, range: 1 kohm, cycles: 10}
            - scanner.measure_resistance: {channel: 102, range: 1 kohm, cycles: 10}
            - meter.measure_resistance: {range: 1 kohm, cycles: 10}
            - chamber.measure_air
"""

SEQUENCE = f"""\
sequence: probes
title: Two probes against a reference
station: probe_bench
analysis: {ANALYSIS}
records: 4
uut: {{model: PT100, serial: P-1}}

tables:
  temperatures: [23 degC, 40 degC]

steps:
  - for: temperature
    in: temperatures
    do:
      - soak:
          temperature: "{{temperature}}"
          ramp: 5 degC/min
          slot: 60 min
          stable: {{within: 1 degC, for: 5 min, sensor: air}}
{RECORD}{RECORD}"""


class ProbeWorld(World):
    """Probes in the chamber; nothing is supplied and nothing sends frames."""

    ports = ()

    def __init__(self, *, clock: Any, seed: int, options: Mapping[str, Any]) -> None:
        super().__init__(clock=clock, seed=seed, unit=None, thermal=Thermal(), options=options)
        probe = Source(resistance_ohm=self._ohm, lead_ohm=LEAD_OHM)
        self.terminals.connect(probe, "scanner", 101)
        self.terminals.connect(probe, "scanner", 102)
        self.terminals.connect(probe, "meter")

    def _ohm(self, t_ns: int) -> float:
        return OHM_AT_0 + OHM_PER_DEGC * float(self.thermal.unit_degC(t_ns))


def analyse(material: Material, method: str = "mean") -> Analysis:
    """Mean resistance of each probe at each temperature, and the air's mean beside it."""
    assert method == "mean"
    found: dict[tuple[float, str], list[float]] = {}
    for row in material.rows:
        for reading in material.readings_of(row):
            name = f"{reading.role} {reading.arguments.get('channel', 0)}"
            found.setdefault((reading.conditions["temperature_degC"], name), []).append(reading.value)
    estimates = [
        estimate(
            "air" if name.startswith("chamber") else "resistance", "degC" if name.startswith("chamber") else "ohm",
            float(np.mean(values)), 0.01, {"temperature_degC": temperature_degC, "probe": name}, n=len(values),
        )
        for (temperature_degC, name), values in found.items()
    ]  # fmt: skip
    return Analysis(ANALYSIS, method, material.campaign["uut"], estimates)


@contextmanager
def installed() -> Iterator[None]:
    """The world, its options and the analysis are known while the context is open."""
    world, options = ModuleType("sim_instruments.probe_world"), ModuleType("sim_instruments.probe_options")
    vars(world)["ProbeWorld"] = ProbeWorld
    vars(options).update(PROBE_OPTIONS={}, PROBE_NUMBERS={}, PROBE_TEXTS={})
    with pytest.MonkeyPatch.context() as patch:
        for module in (world, options):
            patch.setitem(sys.modules, module.__name__, module)
        patch.setattr(simulation, "WORLDS", (*simulation.WORLDS, "probes"))
        patch.setitem(simulation.KINDS, "probes", "probe")
        patch.setitem(check_analysis.ASKED, ANALYSIS, ("temperature_degC",))
        patch.setattr(check_analysis, "OF_READINGS", {ANALYSIS})
        patch.setitem(registry.ANALYSES, ANALYSIS, SimpleNamespace(METHODS=("mean",), analyse=analyse))
        yield


def written(folder: Path, *changes: tuple[str, str]) -> Path:
    """The sequence, changed, and its station as files of a lab's folder."""
    for kind in ("stations", "sequences"):
        (folder / kind).mkdir(parents=True, exist_ok=True)
    texts = {"stations/probe_bench.yaml": STATION, "sequences/probes.yaml": SEQUENCE}
    for old, new in changes:
        name = next(name for name, text in texts.items() if old in text)
        texts[name] = texts[name].replace(old, new)
    for name, text in texts.items():
        (folder / name).write_text(text)
    return folder / "sequences/probes.yaml"


def probe_plan(folder: Path, *changes: tuple[str, str]) -> Plan:
    plan = compile_sequence(written(folder, *changes))
    assert check_plan(plan) == []
    return plan
