"""Late replies over HiSLIP: never taken for the answer to another question, with stock PyVISA and pyvisa-py."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pyvisa.errors import VisaIOError
from sim_served import Served

SEED = 4880
ROLE = "supply"


class Questions:
    """Asks for numbers that change with each question, of an instrument that is late now and then."""

    def __init__(self, served: Served, timeout_s: float, *, late: float, by_socket: bool = False) -> None:
        served.no_latency()
        self.served, self.by_socket, self.timeout_s, self.late = served, by_socket, timeout_s, late
        self.rng = np.random.default_rng(SEED)
        self.faults = served.world.faults.instrument(ROLE)
        self.session = self._open()
        self.answers = self.timeouts = self.mismatches = self.broken_clears = 0

    def _open(self) -> Any:
        opening = self.served.open_socket if self.by_socket else self.served.open
        return opening(ROLE, round(1000 * self.timeout_s))

    def ask(self, number: int, *, clear: bool) -> None:
        """Set a register to the number and ask for it, once, with a seeded delay about the timeout."""
        self.session.write(f"*ESE {number % 256}")
        self.faults.late_s = float(self.rng.uniform(0.0, 2.5 * self.timeout_s))
        self.faults.late_replies = int(self.rng.random() < self.late)
        try:
            answer = self.session.query("*ESE?")
        except VisaIOError:
            self.timeouts += 1
            if clear:
                self._recover()
            return
        self.answers += 1
        self.mismatches += answer != str(number % 256)

    def _recover(self) -> None:
        """Serial poll, take a reply that is there, clear; a clear that finds one more reply needs a new session."""
        try:
            if self.session.read_stb() & 16:
                self.session.read()
            self.session.clear()
        except (VisaIOError, OSError, RuntimeError):
            self.broken_clears += 1
            self.session.close()
            self.session = self._open()


def _report(questions: Questions, capsys: pytest.CaptureFixture[str]) -> None:
    with capsys.disabled():
        print(
            f"\nseed {SEED}: {questions.answers} answers, {questions.timeouts} time-outs, "
            f"{questions.mismatches} mismatches, {questions.broken_clears} sessions reopened"
        )


def test_after_a_timeout_the_next_question_gets_its_own_answer(served: Served) -> None:
    questions = Questions(served, 0.02, late=0.5)
    for number in range(500):
        questions.ask(number, clear=False)
    assert (questions.mismatches, questions.answers + questions.timeouts) == (0, 500)
    assert questions.timeouts > 50
    assert questions.answers > 100


def test_ladder_of_poll_clear_and_repeat_finds_the_way_back(served: Served) -> None:
    questions = Questions(served, 0.04, late=0.5)
    for number in range(60):
        questions.ask(number, clear=True)
    questions.late = 0.0
    questions.timeout_s = 5.0
    questions.session.timeout = 5000
    before = questions.answers
    for number in range(60, 80):
        questions.ask(number, clear=True)
    assert questions.mismatches == 0
    assert questions.answers == before + 20


def test_the_same_questions_over_a_raw_socket_do_get_wrong_answers(served: Served) -> None:
    questions = Questions(served, 0.02, late=0.5, by_socket=True)
    for number in range(200):
        questions.ask(number, clear=False)
    assert questions.mismatches > 10


def test_clear_with_an_unread_reply_needs_a_new_session(served: Served) -> None:
    questions = Questions(served, 5.0, late=0.0)
    session = questions.session
    session.write("*ESE?")
    while not session.read_stb() & 16:
        pass
    with pytest.raises(RuntimeError, match="DeviceClearAcknowledge"):
        session.clear()  # pyvisa-py does not throw away what came before the acknowledgement, as it should
    session.close()
    questions.session = questions._open()
    questions.ask(77, clear=True)
    assert (questions.answers, questions.mismatches) == (1, 0)


def test_poll_after_an_interrupted_question_needs_a_new_session(served: Served) -> None:
    questions = Questions(served, 5.0, late=1.0)
    session = questions.session
    questions.faults.late_s, questions.faults.late_replies = 60.0, 1
    session.write("*ESE?")
    assert session.query("*ESE?") == "0"
    with pytest.raises(RuntimeError, match="AsyncInterrupted"):
        session.read_stb()  # pyvisa-py takes the next message of the second channel for its answer
    session.close()
    assert questions._open().read_stb() == 0


@pytest.mark.sweep
def test_hundred_thousand_questions(served: Served, capsys: pytest.CaptureFixture[str]) -> None:
    questions = Questions(served, 0.004, late=0.2)
    for number in range(100_000):
        questions.ask(number, clear=False)
    _report(questions, capsys)
    assert questions.mismatches == 0
    assert questions.timeouts > 5_000


@pytest.mark.sweep
def test_a_thousand_clears(served: Served, capsys: pytest.CaptureFixture[str]) -> None:
    questions = Questions(served, 0.02, late=0.6)
    for number in range(4_000):
        questions.ask(number, clear=True)
    _report(questions, capsys)
    assert questions.mismatches == 0
    assert questions.timeouts > 1_000
