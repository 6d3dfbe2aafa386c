"""A campaign of a few minutes that several units share, made of the shipped one, and its values beside single ones; one
of a channel and a few levels whose points may end early."""

from pathlib import Path
from typing import Any

from plan_sample import reworded
from rehearsal import compiled

from bench.plan import Plan, check_plan, compile_sequence
from bench.record import SessionReader

ROOT = Path(__file__).resolve().parents[3]
SERIALS = "SIM-1,SIM-2,SIM-3"
NAME = "20000101T000000Z_units_tiny_LOT-1"

CUTS = [  # of the shipped campaign: one gyro channel, two levels, one temperature, short slots
    ("{numbers: 1-6, kind: gyro", "{numbers: 2, kind: gyro"),
    ("  - {numbers: 7-10, kind: accelerometer, levels: accel_levels}\n", ""),
    ("[30 uA, 100 uA, 1 mA, 10 mA, 100 mA, 200 mA]", "[10 mA, 100 mA]"),
    ("[-10 degC, 5 degC, 20 degC, 35 degC, 50 degC]", "[23 degC]"),
    ("    in: [50 degC]", "    in: [23 degC]"),
    ("{channels: 1}", "{channels: 2}"),
    ("slot: 9000 s", "slot: 300 s"),
    ("stable_for: 10 min", "stable_for: 2 min"),
    ("dwell: 100 s", "dwell: 10 s"),
    ("slot: 3600 s ", "slot: 120 s "),
]
OF_ONE = [("sequence: scale_factor_38h", "sequence: units_tiny"), ("duration: 38 h\nrecords: 765\n", "")]
OF_SEVERAL = [("sequence: scale_factor_units", "sequence: units_tiny"), ("duration: 114.5 h\nrecords: 3060\n", "")]
TRUE_STANDARDS = {"world.calibrator_gain": "off", "world.calibrator_floor": "off"}  # as campaigns of one bench share


def cut(name: str, changes: list[tuple[str, str]]) -> str:
    """Return the text of a shipped sequence with its changes."""
    return reworded((ROOT / "sequences" / f"{name}.yaml").read_text(), *changes, once=True)


def compiled_text(folder: Path, text: str, settings: dict[str, str]) -> Plan:
    """Return the plan of a text, without mistakes."""
    path = folder / "units_tiny.yaml"
    path.write_text(text)
    plan = compile_sequence(path, None, {**settings, **TRUE_STANDARDS})
    assert check_plan(plan) == []
    return plan


def units_plan(folder: Path, *changes: tuple[str, str], serials: str = SERIALS) -> Plan:
    """Return the campaign of several units, cut down."""
    return compiled_text(folder, cut("scale_factor_units", [*OF_SEVERAL, *CUTS, *changes]), {"serials": serials})


def single_plan(folder: Path) -> Plan:
    """Return the same campaign of one unit."""
    return compiled_text(folder, cut("scale_factor_38h", [*OF_ONE, *CUTS]), {})


def ramp_plan(folder: Path) -> Plan:
    """Return the bias ramp of several units with 20 windows of 20 s each, over 0.2 degC."""
    cuts = [
        ("sequence: bias_ramp_units", "sequence: units_tiny"),
        ("duration: 25 h\nrecords: 3600\n", ""),
        ("windows: 72\n", "windows: 3\n"),
        ("windows: 360, follows: true, pulse_timing: true, conditions: {route: open, branch: up}",
         "windows: 6, follows: true, pulse_timing: true, conditions: {route: open, branch: up}"),
        ("windows: 36, ", "windows: 2, "),
        ("windows: 360, follows: true, pulse_timing: true, conditions: {route: open, branch: down}",
         "windows: 6, follows: true, pulse_timing: true, conditions: {route: open, branch: down}"),
        ("windows: 72, ", "windows: 3, "),
        ("window: 100 s", "window: 20 s"),
        ("cold: -10 degC", "cold: 23 degC"),
        ("hot: 50 degC", "hot: 23.2 degC"),
        ("slot: 10800 s", "slot: 900 s"),
        ("slot: 7800 s ", "slot: 100 s "),
    ]  # fmt: skip
    return compiled_text(folder, cut("bias_ramp_units", cuts), {"serials": SERIALS})


def events_of(folder: Path, kind: str) -> list[dict[str, Any]]:
    """Return the fields of all events of a kind."""
    return [fields for _, _, fields in SessionReader(folder).events(kind)]


BY_NOISE = "{random: 20 nA, most: 20}"
BY_SCATTER = "{random: 10 ppm, most: 60, by: scatter}"
STOP_CUTS = [
    ("sequence: scale_factor_short", "sequence: stopping"),
    ("duration: 10350 s\nrecords: 105\n", ""),
    ("{numbers: [1, 2], kind: gyro", "{numbers: 1, kind: gyro"),
    ("  - {numbers: 7, kind: accelerometer, levels: accel_levels}\n", ""),
    ("in: [23 degC, 25 degC]", "in: [23 degC]"),
    ("in: [25 degC]", "in: [23 degC]"),
    ("slot: 3600 s", "slot: 300 s"),
    ("stable_for: 5 min", "stable_for: 2 min"),
]


def stopping_text(until: str, seconds: str, levels: str = "10 mA, 100 mA") -> str:
    """Return the text of a campaign whose points, zeros and repeats have this rule."""
    text = reworded(
        (ROOT / "sequences" / "scale_factor_short.yaml").read_text(),
        *STOP_CUTS,
        ("[30 uA, 100 uA, 1 mA, 10 mA, 100 mA, 200 mA]", f"[{levels}]"),
        once=True,
    )
    before, point = text.split("\n  point:\n")
    dwell, ruled = '          seconds: "{dwell}"\n', f"          seconds: {seconds}\n          until: {until}\n"
    return f"{before}\n  point:\n" + point.replace(dwell, ruled, 1)


def stopping_plan(folder: Path, until: str, seconds: str, levels: str = "10 mA, 100 mA") -> Plan:
    """Return the plan of such a campaign, without mistakes."""
    path = folder / "stopping.yaml"
    path.write_text(stopping_text(until, seconds, levels))
    plan = compiled(path)
    assert check_plan(plan) == []
    return plan
