"""What the terminal of a run says: waits with their readings, holds, losses, the end; a sign of life in logs."""

from __future__ import annotations

import io
from types import SimpleNamespace
from typing import Any

import pytest
from planned_step import planned
from rich.console import Console
from top_sample import NOW_S, FakeFeed, SetClock, document

from bench.commands import following
from bench.commands.console import console
from bench.commands.following import Follower, doing, ends, losses
from bench.commands.progress import PlainLines, ProgressBar
from bench.run.feed.client import FeedGone

PLAN: Any = SimpleNamespace(steps=(None,) * 9, record_count=100, prepare_s=10.0, duration_s=90.0, finally_s=0.0)
STEP = planned("record", 3, conditions={"temperature_degC": 23.0, "channel": 1})


class Told:
    """A follower that has its answer ready."""

    def __init__(self, **changes: Any) -> None:
        self.document: Any = document(**changes)

    def look(self) -> Any:
        return self.document


def on(kind: str, what: str, **wait: Any) -> dict[str, Any]:
    step = {**document()["step"], "kind": kind, "what": what}
    return document(step=step, wait={"reason": what, "since_utc_s": NOW_S - 40, "until_utc_s": NOW_S + 60, **wait})


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (document(), "step 4123/9170  soak 50 degC: 48.2 degC, +0.4 degC/min, 0:12:40 of 0:30:00"),
        (document(wait=None), "step 4123/9170  soak 50 degC"),
        (on("record", "record 50 degC channel 3 +10 mA", last="x"),
         "step 4123/9170  record 50 degC channel 3 +10 mA, 0:00:40 of 0:01:40"),
        (on("call", "calibrator.warm_up", last="*OPC? -> ", until_utc_s=None),
         "step 4123/9170  calibrator.warm_up: *OPC? -> , 0:00:40"),
        (document(holds={"kim": "door opened", "interlock hot": "70 degC"}, wait={"since_utc_s": NOW_S - 5}),
         "HOLDING, 0:00:05: door opened (kim); 70 degC (interlock hot)"),
    ],
)  # fmt: skip
def test_what_is_going_on(found: dict[str, Any], words: str) -> None:
    assert doing(found) == words


def test_losses_and_the_end() -> None:
    assert losses(document()) == "7 lost, 3 bad"
    assert losses(document(links=None)) == "0 lost"
    assert ends(document()) == "ends 11-19 11:26Z, latest 12:00Z"
    assert ends(document(clock="virtual")) == ""
    assert ends(document(eta=None)) == ""


@pytest.mark.parametrize("columns", [80, 140])
def test_two_lines_on_a_terminal(columns: int) -> None:
    out = io.StringIO()
    with ProgressBar(PLAN, Console(file=out, width=columns, force_terminal=True, color_system=None)) as bar:
        bar.show(Told())  # type: ignore[arg-type]
    figures, what = out.getvalue().rpartition("\x1b[2K")[2].split("\n")[:2]
    assert "1:00:00" in figures
    assert " 38 %" in figures
    assert "0/100 records, 7 lost, 3 bad" in figures
    assert "ends 11-19 11:26Z, latest 12:00Z" in figures
    assert what.strip().startswith("step 4123/9170  soak 50 degC: 48.2 degC, +0.4 degC/min")
    assert ("\u2501" in figures) == (columns == 140)


def test_a_question_stands_below_what_was_drawn_and_is_not_drawn_over() -> None:
    out = io.StringIO()
    with ProgressBar(PLAN, Console(file=out, width=80, force_terminal=True, color_system=None)) as bar:
        bar.show(Told())  # type: ignore[arg-type]
        with bar.aside():
            before = len(out.getvalue())
            bar.show(Told())  # type: ignore[arg-type]
            bar._progress.refresh()
            out.write("door closed?\nyes or stop:\n")
            while_asked = out.getvalue()[before:]
        after = out.getvalue()[before + len(while_asked) :]
        bar.show(Told(progress=0.5))  # type: ignore[arg-type]
    assert while_asked == "door closed?\nyes or stop:\n"
    assert "1:00:00" in after  # at once what stood there before
    assert "\x1b[1A" not in after.split("1:00:00")[0]  # and below the question
    assert " 50 %" in out.getvalue()


def test_a_rehearsal_shows_how_long_it_still_takes() -> None:
    out = io.StringIO()
    with ProgressBar(PLAN, Console(file=out, width=80, force_terminal=True, color_system=None)) as bar:
        bar.show(Told(clock="virtual"))  # type: ignore[arg-type]
    assert "ends" not in out.getvalue()
    assert ":--" in out.getvalue()


def test_steps_are_shown_until_the_run_says_more_itself() -> None:
    out = io.StringIO()
    with ProgressBar(PLAN, Console(file=out, width=80, force_terminal=True, color_system=None)) as bar:
        bar.step(STEP, 50.0)
        bar.show(SimpleNamespace(look=lambda: None))  # type: ignore[arg-type]
        bar._progress.refresh()
        first = out.getvalue()
        bar.show(Told())  # type: ignore[arg-type]
        bar.step(STEP, 60.0)
    assert "0:00:50" in first
    assert "record 23 degC channel 1" in first
    assert "0:01:00" not in out.getvalue()


def test_a_quiet_log_shows_that_the_run_lives(capsys: pytest.CaptureFixture[str]) -> None:
    clock: Any = SetClock()
    lines = PlainLines(PLAN, console(), clock)
    told: Any = Told()
    said = []
    for minute in range(61):
        clock.s = 60.0 * minute
        lines.sign_of_life(told)
        said += [minute] * len(capsys.readouterr().out.splitlines())
    assert said
    assert max(later - before for before, later in zip([0, *said], [*said, 60], strict=True)) < 10
    clock.s += 600.0
    lines.sign_of_life(told)
    words = "1:00:00  38 %  step 4123/9170  soak 50 degC: 48.2 degC, +0.4 degC/min, 0:12:40 of 0:30:00; "
    assert capsys.readouterr().out == f"{words}0/100 records, 7 lost, 3 bad; ends 11-19 11:26Z, latest 12:00Z\n"


def test_a_log_that_is_not_quiet_needs_no_sign(capsys: pytest.CaptureFixture[str]) -> None:
    clock: Any = SetClock()
    lines = PlainLines(PLAN, console(), clock)
    for minute in range(60):
        clock.s = 60.0 * minute
        if minute % 5 == 0:
            lines.message("x")
        lines.sign_of_life(Told())  # type: ignore[arg-type]
    assert set(capsys.readouterr().out.split()) == {"x"}


def test_nobody_answers_is_no_trouble(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    feed = FakeFeed(document())

    def poll(since: int, state: bool = True) -> Any:
        if feed.silent:
            raise FeedGone("B-RUN-100", "gone")
        return feed.poll(since, state)

    monkeypatch.setattr(following, "FeedClient", lambda folder: SimpleNamespace(poll=poll, close=lambda: None))
    follower = Follower(None)  # type: ignore[arg-type]
    assert follower.look() is not None
    feed.document["step"] = None  # the run has not begun yet
    assert follower.look() is None
    feed.silent = True
    assert follower.look() is None
    clock: Any = SetClock()
    lines = PlainLines(PLAN, console(), clock)
    clock.s = 6000.0
    lines.sign_of_life(follower)
    assert capsys.readouterr().out == ""
    assert feed.asked == [0, 360]
    follower.close()
