"""A question that several may answer, and early verdicts: whatever becomes of either, the run goes on."""

import errno
import json
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from run_rig import HoldRig
from waiting import until

from bench.analysis import Analysis, Estimate, link_checks
from bench.commands import conducting as at_the_terminal
from bench.commands import control as command
from bench.commands.conducting import Aside, StdinTerminal, terminal_here
from bench.model import posix
from bench.model.clock import WallClock
from bench.model.errors import BenchError, InputError, OperatorStop, RunError
from bench.plan.language.sequence import Early
from bench.run.context import RunContext
from bench.run.control.asking import AT_BENCH, Refused, WaitingOperator
from bench.run.control.channel import Control
from bench.run.control.early import EarlyVerdicts, judge_command
from bench.run.operator import AFAR, BENCH, Answer, Question, limits_of
from bench.systems.af_converter.constants import Campaign
from bench.systems.af_converter.early import drift_check, repeat_check, residual_check, scatter_check

OHMS = Question("resistance?", unit="ohm", high=0.5)
DOOR = Question("door closed?", "foreman")


class Typist:
    """A terminal at which lines are typed one after the other; ``act`` happens when none is left."""

    def __init__(self, *lines: str | Exception, act: Callable[[], object] = lambda: None) -> None:
        self.lines, self.act, self.said = list(lines), act, []  # type: ignore[var-annotated]

    def ask(self, question: Question) -> None:
        self.said.append(question.text)

    def tell(self, text: str) -> None:
        self.said.append(text)

    def line(self, timeout_s: float) -> str | None:
        if not self.lines:
            self.act()
            return None
        line = self.lines.pop(0)
        if isinstance(line, Exception):
            raise line
        return line


def waiting(folder: Path, terminal: Typist | None) -> tuple[HoldRig, Any, WaitingOperator]:
    rig = HoldRig(folder, 1)
    context = rig.context()
    context.folder = folder
    operator = WaitingOperator(terminal)
    operator.attach(context)
    return rig, context, operator


def test_the_terminal_may_answer_again_until_it_counts(tmp_path: Path) -> None:
    typist = Typist("much", "3", "3 V", "0.6 ohm", "", "200 mohm")
    _, _, operator = waiting(tmp_path, typist)
    assert operator.ask(OHMS) == Answer("operator", 0.2)
    assert sum("is outside the limits (at most 0.5 ohm)" in text for text in typist.said) == 1
    assert typist.said.count("resistance?") == 6
    typist = Typist("", "perhaps", "YES")
    _, _, operator = waiting(tmp_path, typist)
    assert operator.ask(DOOR) == Answer("foreman")


def test_only_the_first_answer_counts_a_wrong_one_changes_nothing_and_the_terminal_is_told(tmp_path: Path) -> None:
    typist, refused = Typist(), []
    _, _, operator = waiting(tmp_path, typist)

    def act() -> None:
        for prompt, value in (("2", 0.1), (None, 0.6), (None, "0.6 ohm"), (None, ""), (None, True), (None, None),
                              (None, float("nan")), (None, [1]), (None, 10**400), (None, float("-inf"))):  # fmt: skip
            with pytest.raises(Refused) as why:
                operator.propose(prompt, value, "kim", BENCH)
            refused.append(str(why.value))
        assert operator.document(lambda t_ns: 5.0) == {
            "id": "1", "text": "resistance?", "confirm": "operator", "unit": "ohm", "low": None, "high": 0.5,
            "presence": "bench", "arms": False, "since_utc_s": 5.0,
        }  # fmt: skip
        assert operator.propose(None, "0.1 ohm", "kim", BENCH) == "answered with 0.1 ohm"
        assert operator.document(lambda t_ns: 5.0) is None
        with pytest.raises(Refused, match="answered already by kim"):
            operator.propose("1", 0.2, "lee", BENCH)

    typist.act = act
    assert operator.ask(OHMS) == Answer("kim", 0.1)
    assert typist.said == ["resistance?", "answered by kim"]
    with pytest.raises(Refused, match="not asked"):
        operator.propose("1", 0.25, "lee", BENCH)
    assert len(refused) == 10
    assert refused[-1] == refused[-2] == "a finite number is due"


@pytest.mark.parametrize("presence", ["bench", "anywhere"])
def test_hands_are_needed_at_the_bench(tmp_path: Path, presence: str) -> None:
    typist, replies = Typist(), []
    _, _, operator = waiting(tmp_path, typist)

    def act() -> None:
        try:
            replies.append(operator.propose("1", True, "kim", AFAR))
        except Refused as why:
            replies.append(str(why))
            operator.propose("1", True, "lee", BENCH)

    typist.act = act
    answer = operator.ask(Question("clear to go on?", presence=presence))
    assert (answer.by, replies) == {"bench": ("lee", [AT_BENCH]), "anywhere": ("kim", ["confirmed"])}[presence]


@pytest.mark.parametrize("value", [None, True, "yes", " Y "])
def test_a_confirmation_from_elsewhere(tmp_path: Path, value: object) -> None:
    typist = Typist()
    _, _, operator = waiting(tmp_path, typist)

    def act() -> None:
        for wrong in (False, "no", 3, ""):
            with pytest.raises(Refused, match="a confirmation is 'yes'"):
                operator.propose("1", wrong, "kim", BENCH)
        assert operator.propose("1", value, "kim", BENCH) == "confirmed"

    typist.act = act
    assert operator.ask(DOOR) == Answer("kim")


def test_a_stop_is_heard_while_it_waits_and_the_sequencer_lives(tmp_path: Path) -> None:
    typist, checks = Typist(), []
    _, context, operator = waiting(tmp_path, typist)
    context.stop.live.append(lambda at: checks.append(1))
    typist.act = lambda: context.stop.request("SIGTERM") if len(checks) > 3 else None
    with pytest.raises(OperatorStop, match="B-RUN-010"):
        operator.ask(DOOR)
    assert operator.document(float) is None


def test_nobody_can_ever_answer(tmp_path: Path) -> None:
    _, _, operator = waiting(tmp_path, None)
    for nobody in (operator, WaitingOperator(None)):
        with pytest.raises(RunError, match="B-CLI-005"):
            nobody.ask(DOOR)
    gone = Typist(OSError(5, "hung up"))
    _, _, operator = waiting(tmp_path, gone)
    with pytest.raises(RunError, match="the terminal is gone"):
        operator.ask(DOOR)


def test_without_a_terminal_it_says_how_to_answer_tells_people_and_waits(tmp_path: Path) -> None:
    rig, context, operator = waiting(tmp_path, None)
    operator.reachable = True
    rig.at(3.0, lambda: operator.propose("1", 0.5, "kim", BENCH))
    assert operator.ask(OHMS) == Answer("kim", 0.5)
    assert rig.clock.now_ns() >= 3_000_000_000
    (message,) = rig.listener.messages
    assert "resistance? (at most 0.5 ohm)" in message
    assert f"bench answer {context.folder} VALUE" in message
    (alarm,) = rig.events("alarm")
    assert (alarm["what"], alarm["id"], alarm["text"], alarm["high"]) == ("prompt", "1", "resistance?", 0.5)


@pytest.mark.parametrize("before", [True, False])
def test_a_terminal_that_has_gone_leaves_it_to_the_others(tmp_path: Path, before: bool) -> None:
    gone = Typist(OSError(5, "hung up"))
    if before:  # the question
        gone.ask = lambda question: gone.line(0.0)  # type: ignore[assignment,return-value,method-assign]
    rig, context, operator = waiting(tmp_path, gone)
    operator.reachable = True
    rig.at(3.0, lambda: operator.propose("1", None, "kim", BENCH))
    assert operator.ask(DOOR) == Answer("kim")
    assert len(rig.events("alarm")) == 1  # told to the others instead, before it was asked or while it waits
    assert f"bench answer {context.folder}" in rig.listener.messages[0]


def test_the_end_of_a_terminal_is_not_its_refusal(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pseudo terminal whose other side is closed: the kernel reports the end of the input, like Ctrl-D."""
    ours, theirs = os.openpty()
    with os.fdopen(theirs) as stdin:
        monkeypatch.setattr(at_the_terminal.sys, "stdin", stdin)
        terminal = terminal_here()
        assert terminal is not None
        os.write(ours, b"\x04")
        with pytest.raises(OperatorStop):
            terminal.line(5.0)
        os.close(ours)
        with pytest.raises(OSError, match=r"hung up|Input/output error"):
            terminal.line(5.0)


def test_bench_answer(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    rig, context, operator = waiting(tmp_path, None)
    context.clock = WallClock()
    given: list[Answer] = []

    def refused(answer: Callable[[], object], words: str) -> None:
        with pytest.raises(InputError, match=words) as caught:
            answer()
        assert caught.value.code == "B-CTRL-002"

    with Control(context, None, operator).listening():
        refused(lambda: command.answer(tmp_path, ""), "the run asks nothing")
        asked = threading.Thread(target=lambda: given.extend([operator.ask(OHMS), operator.ask(DOOR)]), daemon=True)
        asked.start()
        for wrong in ("", "1 ohm", "2"):
            refused(lambda wrong=wrong: answered(tmp_path, "resistance?", wrong), "value|outside")  # type: ignore[misc]
        answered(tmp_path, "resistance?", "0.3 ohm")
        monkeypatch.setenv("SSH_CONNECTION", "192.0.2.7 51000 192.0.2.1 22")
        refused(lambda: answered(tmp_path, "door closed?", ""), "answered at the bench")
        monkeypatch.delenv("SSH_CONNECTION")
        answered(tmp_path, "door closed?", "")
        asked.join(20.0)
    assert [answer.value for answer in given] == [0.3, None]
    assert "(process" in given[0].by
    assert "answered with 0.3 ohm" in capsys.readouterr().out
    told = [(event["place"], event["ok"], event.get("value")) for event in rig.events("control")]
    assert told == [
        ("bench", False, None), ("bench", False, "1 ohm"), ("bench", False, "2"), ("bench", True, "0.3 ohm"),
        ("afar", False, None), ("bench", True, None),
    ]  # fmt: skip


def answered(folder: Path, text: str, value: str) -> None:
    until(lambda: (command.ask(folder, "status")["prompt"] or {}).get("text") == text, text)
    command.answer(folder, value)


def test_a_question_is_asked_aside_of_what_is_drawn() -> None:
    seen: list[str] = []

    @contextmanager
    def aside() -> Iterator[None]:
        seen.append("nothing is drawn")
        yield
        seen.append("drawn again")

    class Asked:
        def ask(self, question: Question) -> Answer:
            seen.append(question.text)
            return Answer("kim")

    assert Aside(Asked(), aside).ask(DOOR) == Answer("kim")
    assert seen == ["nothing is drawn", "door closed?", "drawn again"]


@pytest.mark.parametrize(
    ("question", "words"),
    [
        (Question("R?", unit="ohm", low=1e6), "at least 1 Mohm"),
        (Question("on?", unit="s", low=7200.0, high=3.6e7), "2 h to 10000 h"),
        (Question("on?", unit="s", low=0.0, high=90.0), "0 s to 1.5 min"),
        (Question("R?", unit="ohm"), "ohm"),
        (DOOR, ""),
    ],
)
def test_limits_as_a_person_would_write_them(question: Question, words: str) -> None:
    assert limits_of(question) == words


def test_what_is_typed(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    typed = ["0.2 ohm\n", "stop\n", ""]
    stdin: Any = SimpleNamespace(readline=lambda: typed.pop(0), isatty=lambda: True)
    monkeypatch.setattr(at_the_terminal.sys, "stdin", stdin)
    dropped: list[tuple[object, int]] = []
    monkeypatch.setattr(posix.termios, "tcflush", lambda *of: dropped.append(of))
    ready: list[list[object]] = [[], [stdin], [stdin], [stdin]]
    monkeypatch.setattr(at_the_terminal.select, "select", lambda *_: (ready.pop(0), [], []))
    terminal = terminal_here()
    assert isinstance(terminal, StdinTerminal)
    terminal.ask(OHMS)
    terminal.ask(DOOR)
    assert capsys.readouterr().err == "resistance?\nvalue (at most 0.5 ohm) or stop:\ndoor closed?\nyes or stop:\n"
    assert dropped == [(stdin, posix.termios.TCIFLUSH)] * 2  # typed before the question: no answer to it
    assert terminal.line(0.1) is None
    assert terminal.line(0.1) == "0.2 ohm"
    for _ in range(2):
        with pytest.raises(BenchError, match="B-CLI-006"):
            terminal.line(0.1)
    stdin.isatty = lambda: False
    assert terminal_here() is None


GOOD = {"ok": True, "records": 3, "checks": []}
BAD = {
    "ok": False, "records": 3,
    "checks": [{"name": "frames lost", "ok": False, "value": 0.5, "limit": 0.001, "text": "half of them"}],
}  # fmt: skip


def early(**changes: Any) -> Early:
    return Early.model_validate({"after": "1 s", "every": "2 s", **changes})


def judged(folder: Path, printing: str, timeout_s: float = 60.0, **changes: Any) -> tuple[HoldRig, RunContext]:
    """A run in which a program is the judge, until its verdict is there."""
    rig = HoldRig(folder, 1)
    context = rig.context()
    context.clock = clock = WallClock()  # type: ignore[assignment]
    context.folder = folder
    verdicts = EarlyVerdicts(early(**changes), context, [sys.executable, "-c", printing], timeout_s)
    verdicts._next_ns = 0  # due now
    for _ in range(2000):
        verdicts.poll()
        if rig.events("verdict"):
            break
        clock.sleep(0.02)
    verdicts.close()
    return rig, context


@pytest.mark.parametrize(
    ("verdict", "on_fail", "held", "code"),
    [
        (BAD, "warn", False, None),
        (BAD, "hold", True, None),
        (BAD, "abort", False, "B-RUN-072"),
        (GOOD, "abort", False, None),  # an event and no more
    ],
)
def test_a_failed_verdict_does_what_the_sequence_declares(
    tmp_path: Path, verdict: dict[str, Any], on_fail: str, held: bool, code: str | None
) -> None:
    rig, context = judged(tmp_path, f"print({json.dumps(json.dumps(verdict))})", on_fail=on_fail)
    assert rig.events("verdict") == [verdict]
    assert bool(context.stop.holds.reasons) == held
    assert (context.stop.fault.code if context.stop.fault else None) == code
    said = any("frames lost 0.5, limit 0.001 (half of them)" in text for text in rig.listener.messages)
    assert said == (verdict is BAD)


@pytest.mark.parametrize(
    ("printing", "words"),
    [
        ("raise SystemExit(7)", "exit status 7"),
        ("import os; os.kill(os.getpid(), 9)", "exit status -9"),
        ("print('{')", "exit status 0"),
        ("print('[1]')", "exit status 0"),
        ("import time; time.sleep(100)", "no verdict in time"),
        ("print('x' * 5_000_000)", "exit status 0"),
    ],
)
def test_a_judge_that_crashes_hangs_or_talks_nonsense_never_touches_the_run(
    tmp_path: Path, printing: str, words: str
) -> None:
    rig, context = judged(tmp_path, printing, 1.0 if "sleep" in printing else 60.0, on_fail="abort")
    assert rig.events("verdict") == [{"ok": None, "error": words}]
    assert context.stop.holds.reasons == {}
    assert context.stop.fault is None


def test_a_judge_that_does_not_start_is_an_event(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = HoldRig(tmp_path, 1)
    verdicts = EarlyVerdicts(early(), rig.context(), ["/nowhere/at/all"])
    rig.clock.sleep(0.9)
    verdicts.poll()
    assert rig.events("verdict") == []  # not due yet
    rig.clock.sleep(0.2)
    verdicts.poll()
    verdicts.poll()
    (event,) = rig.events("verdict")
    assert "does not start" in event["error"]

    def full() -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("tempfile.TemporaryFile", full)
    rig.clock.sleep(2.0)
    verdicts.poll()
    _, event = rig.events("verdict")
    assert "No space left" in event["error"]


def test_the_judge_is_not_imported_by_the_run() -> None:
    words = judge_command(Path("a"), early())
    assert words[1:4] == ["-P", "-m", "bench.session.early"]
    assert json.loads(words[5]) == {"max_lost": 0.001, "max_bad": 0.001, "max_dispersion": 5.0, "max_residual": 6.0}


CAMPAIGN = Campaign.model_validate({
    "analysis": "scale_factor", "af_clock_Hz": 256e3, "master_Hz": 1e7, "uut": {},
    "channels": [{
        "number": 1, "kind": "gyro", "k0_C": 1e-6, "full_scale_A": 0.3, "stability_limit_ppm": 100.0,
        "sensor_full_scale": 80.0, "sensor_unit": "deg/s",
        "noise": {"white_A_rtHz": 1e-6, "walk_A_rth": 0.0},
    }],
})  # fmt: skip


def row(number: int, counts: int, seconds: float = 100.0, **conditions: Any) -> Any:
    frames = round(100 * seconds)
    start_ns = round(number * seconds * 1e9)
    window = SimpleNamespace(
        number=number, conditions={"channel": 1, "current_A": 0.0, **conditions}, first_counter=number * frames,
        frames=frames, t_start_ns=start_ns, t_end_ns=start_ns + round(seconds * 1e9),
    )  # fmt: skip
    sums = {"npp": np.array([counts]), "ppp": np.array([0])}
    return SimpleNamespace(window=window, frames=frames, sums=sums)


def test_links_are_judged_by_their_shares() -> None:
    counts = {"frames": 9_000, "frames_lost": 1_000, "frames_bad": 5}
    lost, bad = link_checks(counts, 0.09, 5e-4)
    assert (lost.ok, lost.value) == (False, 0.1)
    assert (bad.ok, bad.value) == (True, 5e-4)
    assert [check.ok for check in link_checks(dict.fromkeys(counts, 0), 0.1, 0.1)] == [None, None]


def test_a_repeated_point_is_judged_by_noise_pulses_and_stability() -> None:
    """One-sided, 1 uA in 1 Hz over 100 s is 70.7 nA; a pulse of 1 uC over 100 s is 4.1 nA; so 0.1002 uA for two."""
    sigma_counts = 0.10017 * 100.0
    for change, ok in ((4.9, True), (5.1, False)):
        rows = [row(1, 1000), row(2, 1000 + round(change * sigma_counts * 1.0))]
        found = repeat_check(rows, CAMPAIGN, 5.0)
        assert found.ok is ok, found
        assert found.value == pytest.approx(change, rel=0.01)
    assert repeat_check([row(1, 1000), row(2, 9000, current_A=1.0)], CAMPAIGN, 5.0).ok is None
    level = [row(1, 10_000_000, current_A=0.1), row(2, 10_000_000 + 2_000, current_A=0.1)]  # 200 ppm of 100 mA
    assert repeat_check(level, CAMPAIGN, 5.0).value == pytest.approx(200.0 / (100.0 / 1.96), rel=0.01)


def test_neighbours_without_a_gap_are_judged_by_their_scatter() -> None:
    rng = np.random.default_rng(4)
    print("seed 4")
    for factor, ok in ((1.0, True), (10.0, False)):
        counts = 1000 + rng.normal(0.0, 7.07 * factor, 200)
        rows = [row(n, round(count), route="open") for n, count in enumerate(counts, 1)]
        found = scatter_check(rows, CAMPAIGN, 5.0)
        assert found.ok is ok
        assert found.value == pytest.approx(factor, rel=0.2)
    assert scatter_check(rows[:5], CAMPAIGN, 5.0).ok is None
    assert scatter_check(rows[::2], CAMPAIGN, 5.0).ok is None  # they do not follow each other


def test_residuals_and_drift_of_a_partial_fit() -> None:
    one = {"number": 3, "channel": 1, "temperature_degC": 20.0, "residual_ppm": -30.0, "std_ppm": 10.0}
    zero = {**one, "residual_ppm": float("nan"), "std_ppm": float("nan")}
    drift = Estimate.model_construct(quantity="dsf_n_drift", value=80.0, std_uncertainty=10.0, unit="ppm")
    analysis = Analysis("scale_factor", "gls", {}, [drift], residuals=[one, zero])
    assert residual_check(analysis, 2.9).ok is False
    assert residual_check(analysis, 3.0).ok is True
    assert drift_check(analysis, 5.0).value == 8.0
    assert drift_check(analysis, 5.0).ok is False
    empty = Analysis("scale_factor", "gls", {}, [])
    assert [residual_check(empty, 1.0).ok, drift_check(empty, 1.0).ok] == [None, None]
