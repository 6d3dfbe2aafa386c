"""What did not go to plan, in words: each kind of event as a sentence, at the time since the run began."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

import pytest

from bench.model.clock import NS
from bench.model.events import Event, event_of
from bench.session.happenings import KINDS, happening_tables, happenings

E = TypeVar("E", bound=Event)
BOOT_S = 16_000  # the bench clock begins with the machine, not with the run


class Session:
    def __init__(self, *events: tuple[str, int, Mapping[str, Any]]) -> None:
        phases = (("phase", BOOT_S, {"name": "prepare"}), ("phase", BOOT_S + 9, {"name": "campaign"}))
        self.events = [(t_s * NS, event_of(kind, fields)) for kind, t_s, fields in (*phases, *events)]

    def events_of(self, model: type[E]) -> list[tuple[int, E]]:
        return [(t_ns, event) for t_ns, event in self.events if isinstance(event, model)]


EVENTS: dict[str, tuple[dict[str, Any], str]] = {
    "late": ({"step": 7, "policy": "hold", "last_degC": 23.0, "slope_degC_min": -3.4421}, "-3.442 degC/min: hold"),
    "slip": ({"step": 7, "seconds": 1.0, "reason": "soak"}, "step 7: 1 s later than planned (soak)"),
    "overrun": ({"seconds": 0.3041, "step": 38}, "step 38: began 0.3 s late, what was before it took longer"),
    "alarm": (
        {"what": "stimulus", "step": 3, "role": "calibrator", "code": "B-INST-001", "text": "no answer"},
        "calibrator is not confirmed safe at step 3: B-INST-001: no answer",
    ),
    "link": (
        {"link": "port_a", "state": "back", "seconds": 19.27, "how": "port opened again"},
        "link port_a is back after 19.3 s: port opened again",
    ),
    "guard": ({"state": "withheld", "parts": ["sequencer", "links"]}, "no sign of life of sequencer, links"),
    "clock_step": ({"step_s": -3600.0, "t_utc_ns": 0}, "UTC has jumped by -3600.000 s"),
}


@pytest.mark.parametrize("kind", EVENTS)
def test_each_kind_is_a_sentence_at_the_time_since_the_run_began(kind: str) -> None:
    fields, words = EVENTS[kind]
    (line,) = happenings(Session((kind, BOOT_S + 3661, fields)))
    assert line.startswith(f"{kind} at 1:01:01: ")
    assert words in line
    assert "[" not in line


def test_an_alarm_of_a_hold_and_a_link_that_was_lost() -> None:
    hold = {"what": "hold", "step": 3, "seconds": 600.2, "reasons": {"link port_a": "no good frame"}}
    lost = {"link": "port_a", "state": "lost", "reason": "the port was hung up"}
    lines = happenings(Session(("alarm", BOOT_S, hold), ("link", BOOT_S, lost)))
    assert lines == [
        "alarm at 0:00:00: still holding at step 3 after 600 s: no good frame",
        "link at 0:00:00: link port_a is lost: the port was hung up",
    ]


@pytest.mark.parametrize("kind", sorted(set(EVENTS) & set(KINDS)))
def test_fields_of_another_version_are_shown_as_they_are(kind: str) -> None:
    (line,) = happenings(Session((kind, BOOT_S, {"state": "strange", "new": 1.23456})))
    assert line == f"{kind} at 0:00:00: state strange, new 1.235"


def test_the_table_of_the_report_is_in_order_of_time() -> None:
    (table,) = happening_tables(
        Session(
            ("link", BOOT_S + 5, {"state": "x"}), ("late", BOOT_S + 4, {"state": "y"}), ("link", 0, {"state": "open"})
        )
    )
    assert table.prose is True
    assert [row[:2] for row in table.rows] == [["0:00:04", "late"], ["0:00:05", "link"]]
