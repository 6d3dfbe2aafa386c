"""Happenings of a run, in words: each kind of event at its time, commands, alarms and temperatures for the report."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import pytest

from bench.model.clock import NS
from bench.model.events import Event, Phase, event_of
from bench.model.shipped import find_shipped
from bench.session.happenings import (
    alarms_raised,
    commands_given,
    happening_tables,
    happenings,
    length_s,
    surroundings,
)

BOOT_S = 16_000  # the bench clock begins with the machine, not with the run
E = TypeVar("E", bound=Event)
START_ns = 7 * NS


@dataclass
class Session:
    events: list[tuple[int, Event]]

    def events_of(self, model: type[E]) -> list[tuple[int, E]]:
        return [(t_ns, event) for t_ns, event in self.events if isinstance(event, model)]


def ran(*events: tuple[str, int, Mapping[str, Any]]) -> Session:
    phases = (("phase", BOOT_S, {"name": "prepare"}), ("phase", BOOT_S + 9, {"name": "campaign"}))
    return Session([(t_s * NS, event_of(kind, fields)) for kind, t_s, fields in (*phases, *events)])


EVENTS: dict[str, tuple[dict[str, Any], str]] = {
    "late": ({"step": 7, "policy": "hold", "last_degC": 23.0, "slope_degC_min": -3.4421}, "-3.442 degC/min: hold"),
    "overrun": ({"seconds": 0.3041, "step": 38}, "step 38: began 0.3 s late, what was before it took longer"),
    "alarm": ({"what": "hold", "step": 3, "seconds": 600.2, "reasons": {"link port_a": "no good frame"}}, "holding"),
    "link": ({"link": "port_a", "state": "lost", "reason": "the port was hung up"}, "link port_a is lost: the port"),
    "guard": ({"state": "withheld", "parts": ["sequencer", "links"]}, "no sign of life of sequencer, links"),
}


@pytest.mark.parametrize("kind", EVENTS)
def test_each_kind_is_a_sentence_at_the_time_since_the_run_began(kind: str) -> None:
    fields, words = EVENTS[kind]
    (line,) = happenings(ran((kind, BOOT_S + 3661, fields)))
    assert line.startswith(f"{kind} at 1:01:01: ")
    assert words in line
    assert "[" not in line


def test_the_table_of_the_report_is_in_order_of_time() -> None:
    (table,) = happening_tables(
        ran(("link", BOOT_S + 5, {"state": "x"}), ("late", BOOT_S + 4, {"state": "y"}), ("link", 0, {"state": "open"}))
    )
    assert table.prose is True
    assert [row[:2] for row in table.rows] == [["0:00:04", "late"], ["0:00:05", "link"]]


def told(*events: tuple[str, float, dict[str, Any]]) -> Session:
    phase = (START_ns, Phase(name="prepare", t_start_ns=0))
    return Session([phase, *((START_ns + round(at_s * NS), event_of(kind, fields)) for kind, at_s, fields in events)])


def test_commands_say_when_what_who_why_and_what_else() -> None:
    view = told(
        ("control", 60.0, {"what": "pause", "by": "A, operator, 10.0.0.7", "reason": "lunch"}),
        ("control", 3661.0, {"what": "acknowledge", "by": "B", "reason": "", "alarm": "lab_air"}),
    )
    assert commands_given(view) == [
        {"time": "0:01:00", "what": "pause", "by": "A, operator, 10.0.0.7", "reason": "lunch"},
        {"time": "1:01:01", "what": "acknowledge", "by": "B", "reason": "–", "alarm": "lab_air"},
    ]


def test_alarms_and_interlocks_in_order_of_time_and_nothing_else() -> None:
    trip = {
        "name": "unit_hot", "signal": "unit_temperature", "of": "", "state": "tripped", "value": 61.0, "unit": "degC",
        "limit": 60.0, "action": "abort",
    }  # fmt: skip
    held = {"what": "hold", "step": 4, "seconds": 600.0, "reasons": {"operator": "lunch"}}
    view = told(
        ("interlock", 90.0, trip), ("alarm", 30.0, held), ("control", 10.0, {"what": "pause", "by": "A", "reason": "r"})
    )
    found = alarms_raised(view)
    assert [(one["time"], one["what"]) for one in found] == [("0:00:30", "alarm"), ("0:01:30", "interlock")]
    assert found[1]["text"] == "interlock unit_hot: unit_temperature is 61 degC, limit 60 degC: abort"


def test_length_is_from_the_first_phase_to_the_end() -> None:
    assert length_s(told(("end", 99.5, {}))) == pytest.approx(99.5)
    assert math.isnan(length_s(told()))
    assert math.isnan(length_s(Session([(1, event_of("end", {}))])))


def test_the_station_says_which_channel_is_the_room() -> None:
    scans = [
        ("surroundings", at, {"role": "logger", "degC": {"101": 23.0 + at / 1e4, "103": 50.0}}) for at in (0.0, 1500.0)
    ]
    path = find_shipped("stations", "af_bench_sim")
    view, text = told(*scans), path.read_text(encoding="utf-8")
    room, unit = surroundings(view, {"stations/af_bench_sim.yaml": text}, START_ns + 600 * NS)
    assert (room.name, room.laboratory, unit.name, unit.laboratory) == ("logger 101", True, "logger 103", False)
    assert room.t_s.tolist() == [-600.0, 900.0]
    assert room.degC.tolist() == pytest.approx([23.0, 23.15])
    unknown = surroundings(view, {"stations/other.yaml": "no: station\n"}, 0)
    assert [one.laboratory for one in unknown] == [False, False]
