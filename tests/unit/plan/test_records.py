"""What a record says of itself against what the bench was told: each way in which they can part."""

from __future__ import annotations

from pathlib import Path

import pytest
from plan_sample import FLAT, ROOT, changed, make_bench, mistakes

from bench.plan import compile_sequence

SHORT = (ROOT / "sequences" / "scale_factor_short.yaml").read_text()
POINT = (
    '      - switch.route: {channel: "{channel}", polarity: "{polarity}"}\n      - calibrator.output: {current: "{cur'
)
RANGE = '            range: "{calibrator.range}"\n'
OPEN = "            current: 0 A\n            polarity: 0"
SOAK = '          temperature: "{temperature}"'
OPERATE = '      - calibrator.operate\n      - settle: "{settle}"'
RECORD = '            route: closed\n            level_index: "{level_index}"'


def found(tmp_path: Path, text: str) -> list[str]:
    """Messages of B-PLAN-076; nothing else may be found."""
    errors = mistakes(make_bench(tmp_path, text.replace("sequence: scale_factor_short", "sequence: sample")))
    assert {error.code for error in errors} <= {"B-PLAN-076"}, errors
    return [error.message for error in errors]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (POINT, POINT.replace('"{channel}"', "1"), "channel 2, but the route has 1"),
        (POINT, POINT.replace('"{polarity}"', "+"), "polarity -1, but the route has 1"),
        ('output: {current: "{current}"', "output: {current: 1 mA", "current 0 A, but calibrator was set to 0.001 A"),
        (RANGE + RECORD, "            range: 22 mA\n" + RECORD, "calibrator is on"),
        (RECORD, RECORD.replace("closed", "open"), "its route is open, but switch has channel 1 closed"),
        (OPEN, OPEN.replace("0 A", "1 mA"), "current 0.001 A, but an open input has 0"),
        ("            polarity: 0\n", "            polarity: +\n", "polarity 1, but an open input has 0"),
        ("            route: open\n", "            route: closed\n", "its route is closed, but no route is"),
        ("            route: open\n", "", "its route is closed, but no route is"),
        (SOAK, SOAK.replace('"{temperature}"', "24 degC"), "temperature 23 degC, but the chamber is at 24"),
        (OPERATE, OPERATE.split("\n")[1], "output of calibrator is off"),
    ],
)  # fmt: skip
def test_conditions_that_the_bench_does_not_meet_b_plan_076(tmp_path: Path, old: str, new: str, says: str) -> None:
    messages = found(tmp_path, changed(old, new, SHORT))
    assert any(says in message for message in messages), messages


def test_the_shipped_one_is_true(tmp_path: Path) -> None:
    assert found(tmp_path, SHORT) == []


def test_a_locked_range_is_followed(tmp_path: Path) -> None:
    zero = 'point: {current: 0 A, polarity: -, repeat: "{repeat}"}'
    locked = "      - calibrator.output: {current: 0 A, range: locked}\n      - calibrator.operate\n"
    text = changed(
        '      - calibrator.operate\n      - settle: "{settle}"', locked + '      - settle: "{settle}"', SHORT
    )
    text = changed(zero, 'point: {current: 0 A, polarity: +, repeat: "{repeat}"}', text)
    messages = found(tmp_path, text)
    assert all("range" not in message for message in messages)  # {calibrator.range} follows the lock
    assert any("current 3e-05 A, but calibrator was set to 0 A" in message for message in messages)


def test_a_range_locked_before_any_is_known(tmp_path: Path) -> None:
    wiring = "range: lowest_that_holds}\n      - calibrator.operate\n      - settle: 10 s"
    text = changed(wiring, wiring.replace("lowest_that_holds", "locked"), SHORT)
    errors = mistakes(make_bench(tmp_path, text))
    assert [error.code for error in errors] == ["B-PLAN-031"]


def test_what_follows_raw_text_is_not_believed_b_plan_076(tmp_path: Path) -> None:
    flat = changed("call: switch.open_all", "call: {switch.route: {channel: 1, polarity: +}}", FLAT)
    flat = changed("record: 10 s", "record: {seconds: 10 s, conditions: {current: 1 mA}}", flat)
    flat = changed('  - {at: "00:00:10"', '  - {at: 2 s, send: {calibrator: "OUT 1E-3 A"}}\n  - {at: "00:00:10"', flat)
    flat = flat.replace('at: "00:00:20", call: switch.open_all', 'at: "00:00:20", call: calibrator.standby')
    errors = mistakes(make_bench(tmp_path, flat))
    assert [error.code for error in errors] == ["B-PLAN-076"]
    assert "nobody knows the current of calibrator" in errors[0].message


def test_a_record_carries_the_band_of_its_soak() -> None:
    plan = compile_sequence("scale_factor_short", overrides={"within": "0.4 degC"})
    bands = {
        phase: {s.conditions.get("settle_band_degC") for s in plan.phase(phase) if s.kind == "record"}
        for phase in ("prepare", "campaign")
    }
    assert bands == {"prepare": {None}, "campaign": {0.4}}
