"""The end of a run whose records determine no result: the session is named, and what is left to do."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from bench.commands import resume, run
from bench.commands.requests import RunRequest
from bench.model.errors import ExitStatus, FitError

FOLDER = Path("sessions/S")


def no_result(*_: object) -> None:
    raise FitError("B-FIT-005", "K_N is not determined", where="channel 1 at 23 degC", next_step="take them again")


def test_after_a_run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(run, "finish", no_result)
    view: Any = SimpleNamespace(events=[], events_of=lambda model: [])
    done: Any = SimpleNamespace(folder=FOLDER)
    request = RunRequest("s")
    assert run._results(view, done, request, run.console()) == ExitStatus.VERDICT_FAIL
    said = capsys.readouterr()
    assert "B-FIT-005" in said.err
    assert "'bench recover sessions/S'" in said.out


def test_after_a_run_that_was_gone_on_with(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(resume, "finish", no_result)
    view = SimpleNamespace(events=[], events_of=lambda model: [], has_analysis=True)
    monkeypatch.setattr(resume, "read_view", lambda folder: view)
    assert resume._results(FOLDER, "", as_json=False) == ExitStatus.VERDICT_FAIL
    assert "'bench recover sessions/S'" in capsys.readouterr().out
