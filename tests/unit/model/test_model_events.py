"""Events: what a session holds is read back as it was written, and nothing that it holds is refused."""

from __future__ import annotations

import math
from dataclasses import MISSING, fields

import pytest

from bench.model import events
from bench.model.events import Error, Event, Hold, Late, Record, Resume, event_of

RECORD = Record(
    number=1, link="port_a", first_counter=5, frames=100, t_start_ns=0, t_end_ns=9, conditions={"channel": 1}, step=3
)
MODELS = sorted(
    (model for model in vars(events).values() if isinstance(model, type) and issubclass(model, Event) and model.kind),
    key=lambda model: model.__name__,
)


@pytest.mark.parametrize(
    "event", [RECORD, Hold(step=1, by="kim", reason="door"), Error(code="B-X", text="t", where="w")]
)
def test_an_event_is_read_back_as_it_was_written(event: Event) -> None:
    again = event_of(event.kind, event.document())
    assert (again, again.raw) == (event, None)


def test_what_an_event_does_not_have_is_left_out_and_what_it_may_lack_is_null() -> None:
    assert set(RECORD.document()) == {
        "number", "link", "first_counter", "frames", "t_start_ns", "t_end_ns", "conditions", "step",
    }  # fmt: skip
    assert Hold(step=1, by="kim", reason="door", uut="SN 2").document()["uut"] == "SN 2"
    assert Resume(reason="x").document() == {"reason": "x", "stopped_utc_ns": None, "away_s": None, "unit_degC": None}


def test_a_number_that_was_none_comes_back_as_none() -> None:
    late = event_of("late", {"step": 2, "policy": "hold", "last_degC": None, "slope_degC_min": 0.5})
    assert isinstance(late, Late)
    assert math.isnan(late.last_degC)
    assert late.sentence == "step 2: not stable at the end of its slot, last none degC, +0.500 degC/min: hold"


def test_a_late_soak_names_its_chamber_and_its_target() -> None:
    late = Late(step=2, policy="hold", last_degC=48.2, slope_degC_min=0.01, role="chamber", target_degC=50.0)
    said = "step 2: chamber 50 degC not stable at the end of its slot, last 48.20 degC, +0.010 degC/min: hold"
    assert late.sentence == said


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.__name__)
def test_no_event_of_a_foreign_session_is_refused(model: type[Event]) -> None:
    for document in ({}, {field.name: {"strange": [1]} for field in fields(model)}):
        event = model.read(document)
        assert (event.sentence, event.severity, event.topic) is not None
    lacks = any(field.default is MISSING and field.default_factory is MISSING for field in fields(model))
    assert (model.read({}).raw is not None) == lacks


def test_a_field_that_is_missing_or_of_another_type_is_unknown() -> None:
    strange = event_of("retake", {"record": 2.5})
    assert (strange.unknown, strange.document()) == (("record", "reason"), {"record": -1, "reason": ""})
    whole = event_of("retake", {"record": 2.0, "reason": "x"})
    assert (whole.unknown, whole.document()) == ((), {"record": 2, "reason": "x"})


def test_a_kind_that_is_not_known_is_an_event_without_words() -> None:
    event = event_of("something", {"a": 1})
    assert (type(event), event.sentence, event.raw) == (Event, "", {"a": 1})
