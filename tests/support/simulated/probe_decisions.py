"""A sequence that decides by what it reads, on the bench of probes: it warms up until the air has reached 35 degC."""

from pathlib import Path
from typing import Any

from probe_bench import ANALYSIS, written

from bench.plan import Plan, check_plan, compile_sequence
from bench.record import SessionReader

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
SEQUENCE = HEAD + WARM_UP + BEHIND


def sequence_file(folder: Path, text: str = SEQUENCE) -> Path:
    """The sequence as a file of a lab's folder, with its station."""
    path = written(folder)
    path.write_text(text)
    return path


def deciding_plan(folder: Path, text: str = SEQUENCE) -> Plan:
    plan = compile_sequence(sequence_file(folder, text))
    assert check_plan(plan) == []
    return plan


def events_of(folder: Path, kind: str) -> list[dict[str, Any]]:
    """Return the fields of all events of a kind."""
    return [dict(fields) for _, _, fields in SessionReader(folder).events(kind)]
