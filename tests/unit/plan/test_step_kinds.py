"""The typed steps and their form in a plan file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from planned_step import planned

from bench.model.errors import SessionDamaged
from bench.plan import PlannedCommand, PlannedRecord, SetPoint, plan_json, steps_of
from bench.plan.plan import steps_sha256
from bench.record import SessionReader

GOLDEN = Path(__file__).resolve().parents[2] / "golden"
SESSIONS = sorted(path.parent for path in GOLDEN.glob("*/*/20000101T*/session.0001.mcap"))  # runs, not logs


@pytest.mark.parametrize("folder", SESSIONS, ids=lambda folder: folder.name)
def test_the_plan_of_an_older_session_is_read_and_written_byte_for_byte(folder: Path) -> None:
    reader = SessionReader(folder)
    steps = steps_of(reader.texts["plan.json"])
    assert plan_json(steps) == reader.texts["plan.json"]
    assert steps_sha256(steps) == reader.manifest["plan_sha256"]


def test_what_is_not_asked_for_is_left_out_of_the_file() -> None:
    record = planned("record", 1, duration_s=2.0)
    assert list(record.told()) == ["seconds", "retry", "max_lost", "purpose", "retry_step"]
    reading = {"role": "dmm", "name": "measure_dc_voltage", "arguments": {"nplc": 10}}
    more = {"readings": [reading], "every": 1.0, "pulse_timing": True, "samples": True, "follows": True}
    full = planned("record", 1, duration_s=2.0, **more)
    assert isinstance(full, PlannedRecord)
    assert list(full.told().items())[5:] == list(more.items())
    assert [(call.number, call.role, call.arguments) for call in full.calls] == [(1, "dmm", {"nplc": 10})]
    assert list(planned("unit", command=1).told()) == ["command", "payload"]
    test = planned("unit", command=1, timeout=0.2, item="memory", takes=3.0)
    assert isinstance(test, PlannedCommand)
    assert list(test.told()) == ["command", "payload", "timeout", "item", "takes"]
    assert list(planned("prompt").told()) == ["text", "confirm"]
    assert planned("prompt", unit="ohm", high=0.5).told() == {
        "text": "", "confirm": "operator", "unit": "ohm", "low": None, "high": 0.5
    }  # fmt: skip


def test_set_points_are_those_of_the_chamber() -> None:
    assert planned("soak", role="oven", temperature=5.0, ramp=1.0).set_point == SetPoint(5.0, 1.0)
    assert planned("call", role="chamber", temperature=7.0, ramp=0.5).set_point == SetPoint(7.0, 0.5)
    assert planned("call", role="supply", temperature=7.0).set_point is None
    assert planned("call", role="chamber").set_point is None
    assert planned("settle").set_point is None


@pytest.mark.parametrize("change", [{"kind": "dance"}, {"arguments": {"tempo": 1}}, {"arguments": None}, {"more": 1}])
def test_what_is_no_plan_is_one_clear_error(change: dict[str, object]) -> None:
    text = json.dumps([{**planned("settle").as_json(), **change}])
    for wrong in (text, "[1]", "7", "{"):
        with pytest.raises(SessionDamaged, match="B-RES-004") as caught:
            steps_of(wrong, "sessions/a")
        assert caught.value.where == "sessions/a"
