"""A bench without a serial unit: three resistances in a chamber, read by a scanner and a meter; who is at its meter; a
sequence that decides by what it reads.

World and analysis are a stranger's. Probe 1 and 2 hang at channels 101 and 102 of the scanner, the reference at the
meter; all follow the chamber's unit.
"""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from bench.cli import app
from bench.model import installed as installed_module
from bench.model import systems
from bench.model.events import Event, Hold
from bench.plan import Plan, check_plan, compile_sequence
from bench.record import SessionReader
from bench.run.context import RunContext
from bench.run.control.channel import RELEASABLE
from bench.run.observers import Observer

STRANGERS = Path(__file__).resolve().parents[1] / "strangers"
ANALYSIS = "probe_means"
OHM_AT_0, OHM_PER_DEGC = 100.0, 0.39
TEMPERATURES_DEGC = (23.0, 40.0)
NAME = "20000101T000000Z_probes_P-1"

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


@contextmanager
def installed() -> Iterator[None]:
    """A distribution of somebody else is installed while the context is open: its system and its world."""
    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.syspath_prepend(STRANGERS)
            _forget()
            yield
    finally:
        _forget()


def _forget() -> None:
    """Let what is installed be looked up again."""
    for cached in (installed_module.offers, installed_module._examined_packages, systems._own, systems._foreign):
        cached.cache_clear()


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


def command(*words: object) -> str:
    """Return what a command says; it must succeed."""
    done = CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.output


class AtMeter:
    """Does something to the run at calls of the meter, numbered from 1; a Beside of ``conduct``.

    With ``held_s`` every hold is released after this time, by somebody who may; else what holds the run must let it go.
    ``held`` has their reasons.
    """

    def __init__(self, act: Callable[[RunContext, int], object], held_s: float | None = None) -> None:
        self._calls, self._act, self._held_s = 0, act, held_s
        self.held: list[str] = []

    def __call__(self, context: RunContext) -> AbstractContextManager[None]:
        meter: Any = context.instruments["meter"]
        plain, here = meter.measure_resistance, self

        def measure(**arguments: Any) -> float:
            here._calls += 1
            here._act(context, here._calls)
            return float(plain(**arguments))

        class Releasing(Observer):
            def event(self, event: Event, t_mono_ns: int) -> None:
                if here._held_s is not None and isinstance(event, Hold):
                    here.held.append(event.reason)
                    assert event.by in RELEASABLE
                    context.clock.sleep(here._held_s)
                    assert context.stop.holds.release(event.by)

        meter.measure_resistance = measure
        context.observers.add(Releasing())
        return nullcontext()


def at_reading(nth: int, act: Callable[[RunContext], object], held_s: float | None = None) -> AtMeter:
    """Do something at the nth call of the meter."""
    return AtMeter(lambda context, number: act(context) if number == nth else None, held_s)


TURNS = 20
HEAD = f"""\
sequence: probes
title: Probes that decide
station: probe_bench
analysis: {ANALYSIS}
uut: {{model: PT100, serial: P-1}}
parameters: {{limit: 35 degC}}
steps:
"""
WARM_UP = f"""\
  - chamber.set_temperature: {{temperature: 40 degC, ramp: 1 degC/min}}
  - chamber.run
  - settle: 10 s
  - chamber.measure_air
  - while: {{reading: chamber.measure_air, below: "{{limit}}"}}
    at_most: {TURNS}
    do:
      - settle: 60 s
      - record:
          seconds: 60 s
          every: 20 s
          conditions: {{temperature: 40 degC}}
          readings:
            - meter.measure_resistance: {{range: 1 kohm, cycles: 10}}
            - chamber.measure_air
"""
BEHIND = """\
  - if: {reading: chamber.measure_air, above: 36 degC}
    then:
      - settle: 30 min
    else:
      - settle: 60 s
      - record:
          seconds: 60 s
          conditions: {temperature: 40 degC}
          readings: [meter.measure_resistance: {range: 1 kohm, cycles: 10}]
  - choose: {meter.measure_resistance: {range: 1 kohm}}
    cases:
      - below: 110 ohm
        do: [settle: 1 h]
      - within: [110 ohm, 0.12 kohm]
        do:
          - settle: 60 s
          - record:
              seconds: 60 s
              conditions: {temperature: 40 degC}
              readings: [meter.measure_resistance: {range: 1 kohm, cycles: 10}]
  - chamber.stop
  - settle: 10 s
"""
DECIDING = HEAD + WARM_UP + BEHIND


def sequence_file(folder: Path, text: str = DECIDING) -> Path:
    """The sequence as a file of a lab's folder, with its station."""
    path = written(folder)
    path.write_text(text)
    return path


def deciding_plan(folder: Path, text: str = DECIDING) -> Plan:
    plan = compile_sequence(sequence_file(folder, text))
    assert check_plan(plan) == []
    return plan


def events_of(folder: Path, kind: str) -> list[dict[str, Any]]:
    """Return the fields of all events of a kind."""
    return [dict(fields) for _, _, fields in SessionReader(folder).events(kind)]
