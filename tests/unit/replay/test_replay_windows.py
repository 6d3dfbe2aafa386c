"""Which records of a session count, and which follow the one before them without a gap."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from bench.model.errors import SessionDamaged
from bench.replay.windows import RecordedWindow, recorded_windows


def record(number: int, first: int, frames: int = 50, link: str = "imu", **more: Any) -> tuple[str, dict[str, Any]]:
    times = {"t_start_ns": 10**9 * number, "t_end_ns": 10**9 * number + 5}
    return "record", {"number": number, "link": link, "first_counter": first, "frames": frames, "conditions": {},
                      **times, **more}  # fmt: skip


def found(*events: tuple[str, dict[str, Any]]) -> list[RecordedWindow]:
    messages: Any = [
        SimpleNamespace(event=lambda one=one: one, t_ns=1000 + k, sequence=k) for k, one in enumerate(events)
    ]
    return recorded_windows(messages)


def test_a_record_follows_only_the_frame_behind_the_one_before_of_its_link_and_part() -> None:
    resume: tuple[str, dict[str, Any]] = ("resume", {})
    kept = found(
        record(1, 100), record(2, 150), record(3, 201), record(4, 251, link="egi"), resume, record(5, 301),
        record(6, 351), record(8, 401),
    )  # fmt: skip
    assert [one.chained for one in kept] == [False, True, False, False, False, True, False]
    assert [one.part for one in kept] == [0, 0, 0, 0, 1, 1, 1]
    assert [one.until_ns for one in kept] == [1000, 1001, 1002, 1003, 1005, 1006, 1007]


def test_what_is_taken_back_or_taken_again_does_not_count() -> None:
    kept = found(record(1, 100), record(2, 150), ("retake", {"record": 2}), record(2, 180), record(3, 230))
    assert [(one.window.number, one.window.first_counter, one.chained) for one in kept] == [
        (1, 100, False), (2, 180, False), (3, 230, True),
    ]  # fmt: skip
    assert found(record(1, 100), record(1, 120))[0].window.first_counter == 120


def test_marks_of_a_record() -> None:
    plain, marked = found(record(1, 0), record(2, 50, step=7, samples=True, pulse_timing=True))
    assert (plain.sampled, plain.timed, plain.window.step) == (False, False, -1)
    assert (marked.sampled, marked.timed, marked.window.step) == (True, True, 7)


def test_a_record_event_that_lacks_a_field_is_damage() -> None:
    kind, fields = record(1, 0)
    del fields["frames"]
    with pytest.raises(SessionDamaged, match="message 0") as caught:
        found((kind, fields))
    assert caught.value.code == "B-RPL-003"
