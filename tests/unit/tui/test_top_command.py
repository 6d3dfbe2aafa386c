"""bench top from the command line: which run it finds, plain where there is no terminal, nothing if no run answers."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from top_sample import NOW_S, FakeFeed, SetClock, document

from bench.commands import top as command
from bench.model.errors import ExitStatus, InputError
from bench.run.feed.client import FeedGone
from bench.tui import watch
from bench.tui.watch import Seen


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
