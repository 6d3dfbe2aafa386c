"""``bench history charts``, ``freeze`` and ``adjusted`` from the command line: texts, statuses, pictures, JSON."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import store_sample
from store_sample import Documents, new_history

from bench import cli
from bench.model.errors import ExitStatus

SEED = 23
Say = Callable[..., tuple[int, str, str]]


@pytest.fixture
def say(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Say:
    """Run ``bench history`` in this process: exit status, standard output, standard error."""
    monkeypatch.setenv("COLUMNS", "200")

    def run(*words: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["bench", "history", *words])
        with pytest.raises(SystemExit) as caught:
            cli.main()
        said = capsys.readouterr()
        assert "Traceback" not in said.err
        return int(caught.value.code or 0), said.out, said.err

    return run


@pytest.fixture
def url(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    found = new_history("sqlite", tmp_path)
    monkeypatch.setenv("BENCH_HISTORY", found)
    return found


def unit(step_ppm: float, simulated: bool = False) -> Documents:
    steps = np.where(np.arange(18) >= 15, step_ppm, 0.0)
    return store_sample.unit("A1", 30.0 * np.arange(18), SEED, np.zeros(2), steps, simulated=simulated)


def test_a_signal_is_exit_status_1_and_says_when_since_and_how_much(say: Say, url: str, tmp_path: Path) -> None:
    ordered = store_sample.written(url, unit(90.0))
    status, text, _ = say("charts", "--uut", "A1", "--plot", str(tmp_path / "charts.svg"))
    assert status == ExitStatus.VERDICT_FAIL
    assert "NGU A1: 9 charts, one false signal in 200 points of all together" in text
    assert ordered[15][0]["session"] in text
    assert "shewhart" in text
    assert (tmp_path / "charts.svg").read_text(encoding="utf-8").count("Statistic / limit") == 3
    document = json.loads(say("charts", "--json", "--quantity", "dsf_n", "--run-length", "400")[1])
    assert (document["run_length"], document["charts_together"]) == (400.0, 9)
    (series,) = document["series"]
    assert series["points"][5]["ewma"] is None
    assert series["signals"][0]["since"] == ordered[15][0]["session"]


def test_no_signal_and_simulated_ones_are_exit_status_0(say: Say, url: str) -> None:
    store_sample.written(url, unit(90.0, simulated=True))
    status, text, _ = say("charts")
    assert status == 0
    assert "(SIMULATED)" in text
    assert "signals" in text


def test_freeze_and_adjusted(say: Say, url: str) -> None:
    ordered = store_sample.written(url, unit(90.0))
    status, text, _ = say("freeze", "--until", "2015-01-31", "--by", "A. Meyer", "--reason", "first months")
    assert (status, text) == (0, "NGU A1: 9 calibrations until 2015-01-31, by A. Meyer\n")
    status, text, _ = say("charts")
    assert status == ExitStatus.VERDICT_FAIL
    assert "stated by A. Meyer: first months" in text
    session = ordered[15][0]["session"]
    words = ("adjusted", session, "as_left", "--what", "gain", "--by", "A. Meyer")
    assert say(*words)[:2] == (0, f"{session}: as left, gain\n")
    assert say("charts")[0] == 0
    assert "(as left)" in say("list")[1]
    assert "as left: gain (A. Meyer)" in say("show", session)[1]
    assert "adjusted 1 times" in say("compare", "--uut", "A1")[1]
    assert json.loads(say(*words, "--json")[1])["state"] == "as_left"
    assert (
        json.loads(say("freeze", "--until", "2015-01-31", "--by", "B", "--reason", "r", "--json")[1])["calibrations"]
        == 9
    )


def test_what_is_refused(say: Say, url: str, tmp_path: Path) -> None:
    store_sample.written(url, unit(0.0))
    refused = (
        (("charts", "--certificates", "--uut", "A1"), "B-CLI-011"),
        (("charts", "--bench", "bench_9"), "B-STORE-009"),
        (("charts", "--plot", str(tmp_path / "charts.doc")), "B-CLI-007"),
        (("freeze", "--until", "yesterday", "--by", "A", "--reason", "r"), "B-CLI-011"),
        (("freeze", "--until", "2014-06-01", "--by", "A", "--reason", "r"), "B-STORE-041"),
        (("adjusted", "nothing", "as_left", "--what", "x", "--by", "A"), "B-STORE-009"),
        (("adjusted", "nothing", "as_sold", "--what", "x", "--by", "A"), "B-STORE-040"),
    )
    for words, code in refused:
        status, text, complaint = say(*words)
        assert (status, text) == (2, ""), words
        assert f"error {code}: " in complaint
