"""The controller's side of a guard: what it is told and when, and that no run goes on without one that answers."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from waiting import until

from bench.model.clock import NS, VirtualClock
from bench.model.errors import RunError
from bench.run.guard import start
from bench.run.guard.decision import Address, Brief
from bench.run.guard.health import CHAMBER_AIR, LINKS, SEQUENCER, Health
from bench.run.guard.start import BEAT_S, GOODBYE_S, UNANSWERED_S, GuardProcess
from bench.run.stop import StopSwitch

LONGEST_S = 30.0  # only ends a test that hangs
BRIEF = Brief(1, "@py", (Address("calibrator", "fluke_5720a", "GPIB0::4::INSTR"),), {}, 2.0, "guard.jsonl")
GUARD = """\
import os, sys
log = open(sys.argv[1], "ab", buffering=0)
os.write(1, b"rea"); log.write(sys.stdin.buffer.readline()); os.write(1, b"dy\\n")
while line := sys.stdin.buffer.readline():
    log.write(line)
    try: "answers" in sys.argv and os.write(1, b".")
    except OSError: pass
    if "dies" in sys.argv and not os.path.exists(sys.argv[1] + ".died"):
        open(sys.argv[1] + ".died", "w").close(); sys.exit()
log.write(b"null\\n")
"""


class Run:
    """A run in virtual time with a guard that is a process of a few lines, which notes what it hears."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch, *ways: str, program: str = GUARD) -> None:
        self.log = folder / "heard"
        command = [sys.executable, "-I", "-S", "-c", program, str(self.log), *ways]
        monkeypatch.setattr(start, "own_process", lambda _: command)
        self.clock, self.stop = VirtualClock(), StopSwitch()
        self.health = Health(self.clock)
        self.told: list[dict[str, Any]] = []
        self.guard = GuardProcess(
            BRIEF, self.health, self.stop, self.clock, lambda event: self.told.append(event.document())
        )

    def states(self) -> list[str]:
        return [event["state"] for event in self.told]

    def heard(self, what: Callable[[list[Any]], bool]) -> list[Any]:
        """Wait until the guard has heard something; return its messages behind the brief."""
        messages: list[Any] = []

        def has_come() -> bool:
            messages[:] = [json.loads(line) for line in self.log.read_bytes().splitlines()][1:]
            return what(messages)

        until(has_come, lambda: messages, LONGEST_S, each_s=0.01)
        return messages

    def beats(self, until_s: float) -> None:
        """Let time pass, beat by beat; the guard has heard each, and answered where it does."""
        while self.clock.now_ns() < until_s * NS:
            before = len(self.heard(lambda _: True))
            self.health.alive(SEQUENCER, "step 7")
            self.health.alive(LINKS)
            self.clock.sleep(BEAT_S)
            if "lost" not in self.states():
                self.heard(lambda messages, least=before: len(messages) > least)


def test_each_heartbeat_is_told_in_time_and_a_goodbye_ends_the_guard(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = Run(tmp_path, monkeypatch, "answers")
    with run.guard:
        run.heard(lambda messages: len(messages) == 1)  # at once
        run.beats(2.0)
        run.health.note(CHAMBER_AIR, 41.5)
        run.beats(3.0)
    first, *_, before, last, goodbye, end = run.heard(lambda messages: messages[-1:] == [None])
    assert first == {"values": {}, "air_age_s": 0.0, "at": ["", 0.0]}
    assert (before["values"], before["air_age_s"]) == ({CHAMBER_AIR: 41.5}, 0.5)
    assert (last["air_age_s"], last["at"]) == (1.0, ["step 7", 3.0])
    assert goodbye == {"goodbye": {}, "heat_off": False}
    assert end is None
    assert run.states() == ["ready"]
    assert run.guard._process.returncode == 0  # it left by itself: its pipes were closed
    run.stop.check()


def test_what_is_left_at_the_end_is_the_guards_at_once_and_said_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = Run(tmp_path, monkeypatch, "answers")
    with run.guard:
        run.health.begin(["calibrator", "dmm"])  # the guard has no meter to make safe
        run.health.over({"calibrator": "commanded", "dmm": "unreachable"}, heat_off=True)
        run.guard.beat()
        run.guard.beat()
    goodbyes = [message for message in run.heard(lambda all_: all_[-1:] == [None]) if message and "goodbye" in message]
    assert goodbyes == [{"goodbye": {"calibrator": "commanded"}, "heat_off": True}]
    assert start._AT_WORK.pop() is run.guard._process  # it is left alone, and outlives this process
    assert run.guard._process.wait(GOODBYE_S) == 0


def test_a_guard_that_died_is_replaced_where_somebody_has_to_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = Run(tmp_path, monkeypatch, "dies")
    with run.guard:
        run.health.begin(["calibrator"])
        run.guard._process.wait(LONGEST_S)
        run.guard.beat()
        assert run.states() == ["ready", "lost"]
        with pytest.raises(RunError, match="B-RUN-091"):
            run.stop.check()
    messages = run.heard(lambda all_: all_[-1:] == [None])
    assert messages[-2] == {"goodbye": {"calibrator": "unreachable"}, "heat_off": False}
    assert start._AT_WORK.pop().wait(GOODBYE_S) == 0


def test_a_guard_that_does_not_answer_for_5_s_ends_the_run_and_no_sooner(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = Run(tmp_path, monkeypatch)
    with run.guard:
        run.beats(UNANSWERED_S)  # the first beat that can be missed is that at once
        assert run.states() == ["ready"]
        run.stop.check()
        run.beats(UNANSWERED_S + 2 * BEAT_S)
        assert run.states() == ["ready", "lost"]
        with pytest.raises(RunError, match="has not answered for 5 s"):
            run.stop.check()
        run.beats(UNANSWERED_S + 10 * BEAT_S)
    assert run.states() == ["ready", "lost"]
    beats = [message for message in run.heard(lambda all_: all_[-1:] == [None]) if message and "at" in message]
    assert max(beat["at"][1] for beat in beats) <= UNANSWERED_S + 2 * BEAT_S  # nothing is told to one that is lost


@pytest.mark.parametrize("program", ["import sys; sys.exit('no bus')", "import os; os.write(1, b'ready')"])
def test_a_guard_that_ends_before_it_is_ready_starts_no_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str
) -> None:
    with pytest.raises(RunError) as refused:
        Run(tmp_path, monkeypatch, program=program).guard.__enter__()
    assert refused.value.code == "B-RUN-090"
    assert ("no bus" in refused.value.message) == ("no bus" in program)
