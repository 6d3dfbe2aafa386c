"""A small sequence on a copy of the simulated bench, and ways to break it."""

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bench.model.errors import InputError, InputErrors
from bench.plan import Plan, Step, check_plan, compile_sequence
from bench.plan.step_kinds import step_of

ROOT = Path(__file__).resolve().parents[2]

SEQUENCE = """\
sequence: sample
title: a sample
station: af_bench_sim
frame: {port_a: ngu_a, port_b: ngu_b}
analysis: scale_factor
reference_temperature: 20 degC
duration: 660 s
records: 3
uut:
  model: NGU
  serial: SIM-1
  af_clock: 256 kHz
  master_clock: 10 MHz
  function_generator: 10 MHz
  temperature_sensor_uncertainty: 0.1 degC
  kinds:
    gyro: {k0: 1.25 uC, full_scale: 299 mA, sensor_full_scale: 83 deg/s, stability_limit: 100 ppm,
      white_noise_per_rtHz: 2 nA, bias_walk_per_rth: 0.3 nA}
unit_commands:
  start_stream: {code: 2, payload: "64"}
parameters:
  dwell: 10 s
  temperatures: [20 degC]
tables:
  levels: [1 mA]
channels:
  - {numbers: 1-2, kind: gyro, levels: levels}
prepare:
  - prompt: {text: earth, value: {unit: ohm, high: 0.5 ohm}}
  - calibrator.standby
  - switch.open_all
  - unit: {port_b: start_stream}
  - settle: 5 s
steps:
  - for: temperature
    in: "{temperatures}"
    do:
      - soak: {temperature: "{temperature}", ramp: 0.5 degC/min, slot: 570 s, stable: {within: 1 degC, for: 5 min}}
      - for: channel
        in: {channels: 2}
        do:
          - point: {current: 0 A, polarity: +}
          - for: level
            in: "{channel.levels}"
            do:
              - point: {current: "{level}", polarity: +}
              - point: {current: "{level}", polarity: -}
finally:
  - calibrator.standby
  - switch.open_all
procedures:
  point:
    arguments: {current: required, polarity: required, repeat: 0}
    do:
      - calibrator.standby
      - switch.route: {channel: "{channel}", polarity: "{polarity}"}
      - calibrator.output: {current: "{current}", range: lowest_that_holds}
      - calibrator.operate
      - settle: 20 s
      - record:
          seconds: "{dwell}"
          retry: 2
          max_lost: 0.1 %
          conditions: {current: "{current}", polarity: "{polarity}", range: "{calibrator.range}", repeat: "{repeat}"}
      - verify: calibrator.operating
"""

FLAT = """\
sequence: flat
station: af_bench_sim
frame: {port_a: ngu_a, port_b: ngu_b}
timeline:
  - {at: "00:00:00", call: calibrator.standby}
  - {at: 1 s, call: switch.open_all}
  - {at: "00:00:10", record: 10 s}
  - {at: "00:00:20", call: switch.open_all}
"""


TRACED = ", specification: relative, age: 2160 h, certificate_U: 8 ppm, common_with: SIM-0001}"  # in the register


def make_bench(folder: Path, sequence: str = SEQUENCE, station: tuple[str, str] = ("", "")) -> Path:
    """Write a bench into ``folder`` and return the path of its sequence; ``station`` is (old, new) text."""
    for kind in ("frames", "stations"):
        if not (folder / kind).exists():
            shutil.copytree(ROOT / kind, folder / kind)
    file = folder / "stations" / "af_bench_sim.yaml"
    text = (ROOT / "stations" / "af_bench_sim.yaml").read_text()
    assert station[0] in text
    file.write_text(text.replace(*station, 1) if station[0] else text)
    path = folder / "sequences" / "sample.yaml"
    path.parent.mkdir(exist_ok=True)
    path.write_text(sequence)
    return path


def changed(old: str, new: str, text: str = SEQUENCE) -> str:
    """The sample with one place changed."""
    assert text.count(old) >= 1, old
    return text.replace(old, new, 1)


def reworded(text: str, *changes: tuple[str, str], once: bool = False) -> str:
    """Return a text with other words, each of which must stand there; ``once``: in one place only."""
    for old, new in changes:
        assert text.count(old) == 1 if once else old in text, old
        text = text.replace(old, new)
    return text


WALL_30_s = ROOT / "sequences" / "scale_factor_wall_30s.yaml"
ONE_TEMPERATURE = 5  # records
CUT = {
    "in: [23 degC, 23.3 degC]": "in: [23 degC]",
    "duration: 31.5 s\nrecords: 10": "duration: 15.75 s\nrecords: 5",
}


def one_temperature(folder: Path) -> Path:
    """Write the half-minute campaign of drills cut down to one temperature; return its file."""
    path = folder / WALL_30_s.name
    path.write_text(reworded(WALL_30_s.read_text(), *CUT.items(), once=True))
    return path


def mistakes(path: Path, overrides: dict[str, str] | None = None) -> list[InputError]:
    """Everything that loading, compiling and checking find."""
    try:
        plan: Plan = compile_sequence(path, None, overrides)
    except InputErrors as error:
        return error.errors
    except InputError as error:
        return [error]
    return check_plan(plan)


def planned(
    kind: str, number: int = 0, *, phase: str = "campaign", at_s: float = 0.0, duration_s: float = 0.0, role: str = "",
    name: str = "", conditions: Mapping[str, Any] | None = None, where: str = "", **arguments: Any,
) -> Step:  # fmt: skip
    """Return a step; arguments are named as in a plan file."""
    usual: dict[str, dict[str, Any]] = {
        "settle": {"bus_s": 0.0},
        "record": {
            "seconds": duration_s, "retry": 0, "max_lost": 0.0, "purpose": "measurement", "retry_step": number,
        },
        "soak": {
            "temperature": 23.0, "ramp": 1.0, "slot": duration_s, "within": 1.0, "for": 60.0, "sensor": "unit",
            "late": "hold", "hold_limit": duration_s,
        },
        "prompt": {"text": "", "confirm": "operator"},
        "unit": {"payload": ()},
    }  # fmt: skip
    return step_of(
        {
            "number": number, "phase": phase, "kind": kind, "at_s": at_s, "duration_s": duration_s, "role": role,
            "name": name, "arguments": {**usual.get(kind, {}), **arguments}, "conditions": conditions or {},
            "where": where or f"test.yaml:{number + 1}:1",
        }
    )  # fmt: skip
