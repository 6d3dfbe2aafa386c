"""A campaign of one channel and a few levels whose points may end early, made of the shipped short one."""

from pathlib import Path

from plan_sample import reworded
from rehearsal import compiled

from bench.plan import Plan, check_plan

ROOT = Path(__file__).resolve().parents[3]
BY_NOISE = "{random: 20 nA, most: 20}"
BY_SCATTER = "{random: 10 ppm, most: 60, by: scatter}"
CUTS = [
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
        *CUTS,
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
