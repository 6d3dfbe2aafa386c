"""What is known of a run that is watched, and ``bench top``, which shows it."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from record_sample import write_sample
from top_sample import NOW_S, FakeFeed, Gone, SetClock, document

from bench.commands import top as command
from bench.model.errors import ExitStatus, InputError
from bench.record.writer import OPEN_MARKER
from bench.run.feed.client import FeedGone
from bench.tui import watch
from bench.tui.look import Look, catalogue
from bench.tui.page import page_of
from bench.tui.watch import OLD_S, Seen, Watch, ending

GOOD = {"outcome": {"error": None, "text": ""}}


class Rig:
    """A watch over a feed that can be silenced, and a session that can be over."""

    def __init__(self, **changes: Any) -> None:
        self.feed, self.clock = FakeFeed(document(**changes)), SetClock()
        self.end: dict[str, Any] | None = None
        self.watch = Watch(Path("/s"), self.feed, self.clock, lambda: self.end, Gone)


def test_points_are_asked_for_once() -> None:
    rig = Rig()
    rig.watch.look()
    assert rig.feed.asked == [0, 360]
    assert rig.watch.seen.last["bench.unit"] == pytest.approx(48.144, abs=1e-3)
    assert rig.watch.seen.trend.span_s == 3600.0


def test_a_short_silence_is_none_a_long_one_is_lost_and_an_answer_ends_it() -> None:
    rig = Rig()
    rig.feed.silent = True
    rig.clock.s = OLD_S - 0.1
    assert not rig.watch.look().lost
    rig.clock.s = OLD_S + 0.1
    assert rig.watch.look().lost
    assert rig.watch.seen.age_s == pytest.approx(OLD_S + 0.1)
    assert rig.watch.seen.document["state"] == "running"  # the last that was said; the page says LOST
    rig.feed.silent = False
    assert not rig.watch.look().lost
    assert rig.watch.seen.age_s == 0.0


def test_nobody_answers_the_first_time() -> None:
    feed = FakeFeed(document(), silent=True)
    with pytest.raises(Gone):
        Watch(Path("/s"), feed, SetClock(), lambda: None, Gone)


ACT = '{"what":"act","reason":"silent","text":"no heartbeat for 2.05 s, the limit is 2 s"}\n'


@pytest.mark.parametrize(
    ("diary", "words"),
    [
        (
            '{"what":"ready"}\n' + ACT,
            "The guard is switching the outputs off: no heartbeat for 2.05 s, the limit is 2 s.",
        ),
        (
            ACT + '{"what":"safe","instruments":[]}\n',
            "The guard has switched the outputs off, and confirmed it: no heartbeat for 2.05 s,",
        ),
        (ACT + '{"what":"unsafe","instruments":["supply"]}\n', "could NOT confirm that these are off: supply."),
        (ACT + '{"what":"safe"}\n{"what":"ready"}\n', ""),  # of the part before the run was gone on with
        ("", ""),
    ],
)
def test_what_the_guard_of_a_lost_run_did(tmp_path: Path, diary: str, words: str) -> None:
    (tmp_path / "guard.jsonl").write_text(diary)
    feed, clock = FakeFeed(document()), SetClock()
    watch = Watch(tmp_path, feed, clock, lambda: None, Gone)
    feed.silent, clock.s = True, 60.0
    head = " ".join(" ".join(line.plain for line in page_of(watch.look(), Look(catalogue())).head).split())
    assert words in head
    assert ("guard" in head) == bool(words)
    feed.silent = False
    assert watch.look().guard is None


def test_another_process_answers() -> None:
    rig = Rig()
    rig.feed.document = document(boot_id="ffff", t_utc_s=NOW_S + 60.0)
    assert rig.watch.look().document["t_utc_s"] == NOW_S + 60.0
    assert rig.watch.look().document["boot_id"] == "ffff"


def test_a_session_that_is_closed_has_ended_and_is_not_asked_again() -> None:
    rig = Rig(holds={"kim": "door"})
    rig.feed.silent, rig.end, rig.clock.s = True, GOOD, 100.0
    found = rig.watch.look()
    assert (found.document["state"], found.lost) == ("ended", False)
    assert found.document["outcome"] == GOOD["outcome"]
    assert found.document["holds"] == {}
    asked = len(rig.feed.asked)
    assert rig.watch.look().document["state"] == "ended"
    assert len(rig.feed.asked) == asked


def test_what_was_not_confirmed_at_the_end_is_not_off_whatever_was_heard_before() -> None:
    bench = {"state": "off", "confirmed_utc_s": NOW_S, "parts": [], "remains": [], "unconfirmed": {}}
    rig = Rig(bench=bench)
    rig.feed.silent, rig.end = True, {**GOOD, "unconfirmed": ["calibrator"]}
    head = " ".join(line.plain for line in page_of(rig.watch.look(), Look(catalogue())).head)
    assert "UNKNOWN what is on  NOT confirmed off: calibrator" in head
    assert "OUTPUTS OFF" not in head


def test_what_is_drawn_does_not_change_under_the_drawing() -> None:
    rig = Rig()
    before = rig.watch.look()
    kept = dict(before.trend.buckets)
    rig.watch.look().trend.add(NOW_S + 30.0, 1.0, 2.0)
    rig.clock.s = 9.0
    rig.feed.silent = True
    assert rig.watch.look().lost
    assert before.trend.buckets == kept
    assert not before.lost


def test_how_a_session_ended(tmp_path: Path) -> None:
    write_sample(tmp_path / "s", seconds=2)
    assert ending(tmp_path / "s") == {"outcome": None, "unconfirmed": ()}  # closed, but it does not say how
    (tmp_path / "s" / OPEN_MARKER).touch()
    assert ending(tmp_path / "s") is None
    assert ending(tmp_path / "none") is None


def test_a_golden_session_ended_well(tmp_path: Path) -> None:
    golden = Path(__file__).resolve().parents[2] / "golden" / "sessions"
    folder = next(golden.glob("*/*_golden_GOLDEN/session.0001.mcap")).parent
    shutil.copytree(folder, tmp_path / "s")
    assert ending(tmp_path / "s") == {**GOOD, "unconfirmed": []}


class Runs:
    """Feeds by name of the folder; the others are gone."""

    def __init__(self) -> None:
        self.answering: dict[str, FakeFeed] = {}

    def client(self, folder: Path) -> Any:
        return SimpleNamespace(poll=lambda since, state=True: self._poll(folder, since))

    def _poll(self, folder: Path, since: int) -> Any:
        if folder.name not in self.answering:
            raise FeedGone("B-RUN-100", "no run of this session answers", where=str(folder))
        return self.answering[folder.name].poll(since)


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> Runs:
    found = Runs()
    monkeypatch.setattr(command, "FeedClient", found.client)
    monkeypatch.setattr(command, "WallClock", SetClock)
    return found


def folder(out: Path, name: str, age_s: int, pointer: str = "live.sock") -> Path:
    place = out / name
    place.mkdir()
    (place / pointer).touch()
    os.utime(place, (1_700_000_000 - age_s, 1_700_000_000 - age_s))
    return place


def test_the_newest_run_that_answers_is_shown_in_plain_text(
    runs: Runs, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, age_s in (("old", 300), ("older", 900), ("dead", 10)):
        folder(tmp_path, name, age_s, "live.path" if name == "old" else "live.sock")
    (tmp_path / "a_file").touch()
    runs.answering = {"old": FakeFeed(document(sequence="this_one")), "older": FakeFeed(document(sequence="not_this"))}
    assert command.top(None, tmp_path) == ExitStatus.PASS
    said = capsys.readouterr().out
    assert "RUNNING  this_one NGU 17" in said
    assert "48.2 degC, +0.4 degC/min" in said
    assert "switch ERROR" in said
    assert "\x1b" not in said


def test_a_session_that_is_named(runs: Runs, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place = folder(tmp_path, "one", 5)
    folder(tmp_path, "two", 1)
    runs.answering = {"one": FakeFeed(document(sequence="one")), "two": FakeFeed(document(sequence="two"))}
    assert command.top(place, Path("nowhere")) == ExitStatus.PASS
    assert "RUNNING  one" in capsys.readouterr().out


@pytest.mark.parametrize("named", [True, False])
def test_no_run_answers(runs: Runs, tmp_path: Path, named: bool) -> None:
    place = folder(tmp_path, "dead", 1)
    with pytest.raises(InputError) as caught:
        command.top(place if named else None, tmp_path)
    assert caught.value.code == "B-TUI-001"
    assert caught.value.exit_status == ExitStatus.BAD_INPUT
    assert str(place if named else tmp_path) in str(caught.value)


def test_a_run_that_its_guard_ended_says_so(runs: Runs, tmp_path: Path) -> None:
    (folder(tmp_path, "dead", 1) / "guard.jsonl").write_text(ACT + '{"what":"unsafe","instruments":["supply"]}\n')
    for named in (tmp_path / "dead", None):
        with pytest.raises(InputError, match=r"dead has acted .* NOT confirmed: supply;"):
            command.top(named, tmp_path)


def test_on_a_terminal_it_waits_for_a_run_to_appear(
    runs: Runs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shown: list[str] = []
    slept: list[float] = []

    def sleep(self: object, seconds: float) -> None:
        slept.append(seconds)
        if len(slept) == 3:
            folder(tmp_path, "late", 1)
            runs.answering = {"late": FakeFeed(document(sequence="late"))}

    monkeypatch.setattr(command.WallClock, "sleep", sleep, raising=False)
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    app = SimpleNamespace(run=lambda mouse: None)
    monkeypatch.setattr(command, "TopApp", lambda seen, *_: shown.append(seen.document["sequence"]) or app)
    assert command.top(None, tmp_path) == ExitStatus.PASS
    assert (shown, slept) == (["late"], [1.0] * 3)
    assert "waiting for one to begin" in capsys.readouterr().out
    with pytest.raises(InputError, match="B-TUI-001"):
        command.top(tmp_path / "named", tmp_path)


def test_no_folder_at_all(runs: Runs, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        command.top(None, tmp_path / "none")
    assert caught.value.code == "B-TUI-001"


@pytest.mark.parametrize(("term", "app"), [("xterm", True), ("dumb", False)])
def test_a_terminal_gets_the_view(
    runs: Runs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, term: str, app: bool
) -> None:
    shown: list[dict[str, Any]] = []
    monkeypatch.setattr(command, "TopApp", lambda *_: SimpleNamespace(run=lambda **how: shown.append(how)))
    monkeypatch.setattr(command, "_print", lambda *_: None)
    monkeypatch.setenv("TERM", term)
    for name in ("stdin", "stdout"):
        monkeypatch.setattr(sys, name, SimpleNamespace(isatty=lambda: True, encoding="utf-8", write=len, flush=len))
    folder(tmp_path, "one", 5)
    runs.answering = {"one": FakeFeed(document())}
    assert command.top(None, tmp_path) == ExitStatus.PASS
    assert shown == ([{"mouse": False}] if app else [])


def test_the_hour_before_comes_from_the_trend(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Reader:
        def __init__(self, folder: Path) -> None:
            assert folder == tmp_path

        def window(self, names: list[str], t0_utc_s: float, t1_utc_s: float, n: int) -> Any:
            assert (names, t0_utc_s, t1_utc_s) == (["bench.unit"], NOW_S - 3600, NOW_S)
            times = np.array([NOW_S - 1800, NOW_S - 900])
            return SimpleNamespace(t_utc_s=times, low=np.array([[20.0], [np.nan]]), high=np.array([[21.0], [np.nan]]))

    monkeypatch.setattr(watch, "TrendReader", Reader)
    seen = Seen(document(), "")
    watch.remember_earlier(seen, tmp_path)
    assert list(seen.trend.buckets.values()) == [(20.0, 21.0)]


def test_a_session_without_a_trend_begins_now(tmp_path: Path) -> None:
    seen = Seen(document(), "")
    watch.remember_earlier(seen, tmp_path)
    watch.remember_earlier(Seen(document(t_utc_s=None), ""), tmp_path)
    assert seen.trend.buckets == {}
