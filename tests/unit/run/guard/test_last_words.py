"""The last words of a guard: what a person is told, and that neither terminal nor file can keep the guard waiting."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from bench.run.guard import last_words as module
from bench.run.guard.diary import guard_word
from bench.run.guard.last_words import guard_lines, last_words, terminal_of, write_to_terminal

UTC = "2026-03-01T01:00:02.123+00:00"
WORD: dict[str, Any] = {"reason": "no heartbeat for 2.05 s", "safe": True, "unsafe": {}, "utc": UTC, "by": ""}
HEAD = "The guard of night has acted (no heartbeat for 2.05 s), last heard of at 2026-03-01T01:00:02Z. "


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {},
            "Confirmed: every instrument is off, or on hold. Next: find out why, then 'bench resume night'.",
        ),
        (
            {"safe": False, "unsafe": {"calibrator": "unreachable", "supply": "commanded"}},
            "NOT confirmed: calibrator (unreachable), supply (commanded); every other instrument is off, or on hold. "
            "Next: switch these off at their front panels before anybody touches the bench; the guard goes on trying, "
            "then 'bench resume night'.",
        ),
        (
            {"safe": None, "unsafe": {}},
            "NOT confirmed: any instrument; it is at it. Next: look again in a minute, until then hands off.",
        ),
        (
            {"safe": None, "unsafe": {"calibrator": "unreachable"}},
            "NOT confirmed: calibrator (unreachable); it is at it. Next: look again in a minute, until then hands off.",
        ),
        (
            {"safe": False, "unsafe": {"calibrator": ""}, "by": "kim"},
            "NOT confirmed when kim took the bench over: calibrator. "
            "Next: kim has to say what is on; switch off by hand what it does not reach.",
        ),
    ],
)
def test_why_it_acted_what_is_confirmed_and_what_to_do(changes: dict[str, Any], said: str) -> None:
    assert last_words({**WORD, **changes}, "night") == HEAD + said


@pytest.mark.parametrize(
    ("entries", "safe"),
    [
        ([{"what": "safe"}], True),
        ([{"what": "instrument", "role": "dmm"}], None),
        ([{"what": "safe", "instruments": ["dmm"]}], False),
        ([{"what": "safe"}, {"what": "taken over", "by": "kim"}], False),
        ([{"what": "unsafe"}], False),
    ],
)
def test_a_word_that_contradicts_itself_confirms_nothing(
    entries: list[dict[str, Any]], safe: bool | None, tmp_path: Path
) -> None:
    lines = [json.dumps(entry) + "\n" for entry in ({"what": "act", "text": "too hot"}, *entries)]
    (tmp_path / "guard.jsonl").write_text("".join(lines))
    word = guard_word(tmp_path)
    assert word is not None
    assert word["safe"] is safe


def test_a_guard_that_did_not_act_has_no_words(tmp_path: Path) -> None:
    assert guard_lines(tmp_path) == []
    (tmp_path / "guard.jsonl").write_text('{"what":"act","text":"too hot","utc":"2026-03-01T01:00:02+00:00"}\n')
    (line,) = guard_lines(tmp_path)
    assert line.startswith(f"The guard of {tmp_path} has acted (too hot), last heard of at 2026-03-01T01:00:02Z.")


@pytest.mark.parametrize("by_path", [True, False])
def test_a_terminal_shows_one_line_and_its_cursor_and_obeys_no_text(by_path: bool) -> None:
    controller, terminal = os.openpty()
    try:
        place = terminal_of(terminal) if by_path else terminal
        assert write_to_terminal(place, "ended\nby its\x1b[31m guard \x07")
        assert os.read(controller, 4096).replace(b"\r\r\n", b"\r\n") == b"\r\n\x1b[?25hended by its?[31m guard ?\r\n"
        os.fstat(terminal)  # it stays open
    finally:
        os.close(controller)
        os.close(terminal)


def test_a_file_gets_the_paragraph_behind_what_it_has(tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    with log.open("w") as stream:
        stream.write("record 50/765")
        stream.flush()
        assert terminal_of(stream.fileno()) == str(log)
    assert write_to_terminal(log, "ended by its guard")
    assert log.read_text() == "record 50/765\nended by its guard\n"


def test_a_pipe_has_no_path_and_a_place_that_is_gone_takes_nothing(tmp_path: Path) -> None:
    reading, writing = os.pipe()
    try:
        assert terminal_of(writing) == ""
    finally:
        os.close(reading)
        os.close(writing)
    assert terminal_of(writing) == ""
    assert not write_to_terminal("", "x")
    assert not write_to_terminal(tmp_path / "gone", "x")
    assert not (tmp_path / "gone").exists()


def test_a_place_that_takes_nothing_is_not_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "WRITE_S", 0.05)
    place = tmp_path / "stopped"
    os.mkfifo(place)  # nobody reads it: opening it waits, as a write to a terminal that was stopped does
    assert not write_to_terminal(place, "x")
    os.close(os.open(place, os.O_RDONLY | os.O_NONBLOCK))  # the thread that waits there may leave
