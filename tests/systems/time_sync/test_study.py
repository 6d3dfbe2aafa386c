"""``bench study`` as a person starts it: files, exit status, and the same bytes from any number of workers."""

import json
import os
import pickle
import signal
from pathlib import Path
from typing import Any

import distributed
import pytest

from bench.analysis import estimate
from bench.commands import study as study_command
from bench.commands.cluster import run_on_cluster
from bench.commands.requests import StudyRequest
from bench.commands.study import study
from bench.model.errors import InputError
from bench.systems.time_sync import study as published
from bench.systems.time_sync.study.study import BASE, NAME, TIGHT, Group, StudyOptions, Task
from bench.systems.time_sync.study.tasks import run_task

GROUPS = (Group(10.0, augmented=True, noise=BASE), Group(0.0, augmented=False, noise=TIGHT))
TASKS = [Task("flight", one, 2.0, GROUPS, 2, 4) for one in ("turn", "linear", "acceleration", "stationary")]


class Listener:
    """Ends a worker when the first task is done."""

    def __init__(self, victim: int | None = None) -> None:
        self._victim, self.done_tasks = victim, list[str]()

    def done(self, name: str) -> None:
        if self._victim is not None and not self.done_tasks:
            os.kill(self._victim, signal.SIGKILL)
        self.done_tasks.append(name)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_workers_give_the_same_bytes_even_if_one_dies() -> None:
    """On this machine, and by the address of a cluster that runs; there one of two workers is killed on the way."""
    alone = [pickle.dumps(run_task(task)) for task in TASKS]
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=":0", memory_limit=0
    ) as cluster:
        victim = cluster.workers[0].pid
        listener = Listener(victim)
        together = run_on_cluster(cluster.scheduler_address, TASKS, run_task, listener.done)
    assert [pickle.dumps(one) for one in together] == alone
    assert sorted(listener.done_tasks) == sorted(task.name for task in TASKS)


def request(out: Path, **other: Any) -> StudyRequest:
    """A study of two runs; ``other`` fields."""
    asked = {"runs": 2, "seed": 1, "offsets": "0,20", "quick": True, "dask": None, "json": False, **other}
    return StudyRequest(name=asked.pop("name", NAME), out=out, **asked)


def test_an_unknown_study(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f"B-STUDY-001.*{NAME}"):
        study(request(tmp_path, name="time_travel"))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("spoilt", [False, True])
def test_files_and_exit_status(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], spoilt: bool
) -> None:
    """The tasks are stood in for by results made by formula: what is written, said and returned is looked at here."""
    document = {"runs": 2, "estimates": [_judged("pass"), _judged("fail" if spoilt else "pass")]}
    monkeypatch.setattr(published, "run_task", lambda task: task.name)
    monkeypatch.setattr(published, "study_document", lambda *_: document)
    monkeypatch.setattr(published, "study_chapters", lambda *_: [])
    monkeypatch.setattr(study_command, "study_html", lambda *_: "<html>")
    assert study(request(tmp_path / "out", json=True)) == (1 if spoilt else 0)
    said = capsys.readouterr()
    assert json.loads(said.out) == document == json.loads((tmp_path / "out" / "study.json").read_text("utf-8"))
    assert (tmp_path / "out" / "report.html").read_text("utf-8") == "<html>"
    assert "1/9  sar" in said.err
    assert study(request(tmp_path / "out")) == (1 if spoilt else 0)
    assert ("1 tolerances kept, 1 not" in capsys.readouterr().out) == spoilt


def _judged(verdict: str) -> dict[str, Any]:
    entry = estimate("shift", "m", 2.0, 0.1, {"offset_ms": 20.0}, n=2)
    return entry.document | {"verdict": verdict}


@pytest.mark.sweep
@pytest.mark.parametrize("seed", [1, 2, 3, 4, 5])
def test_every_tolerance_is_kept(tmp_path: Path, seed: int) -> None:
    """The whole study, 50 runs: no verdict fails, whatever the seed."""
    assert study(request(tmp_path, runs=50, seed=seed, offsets="0,10,20,30", quick=False)) == 0
    document = json.loads((tmp_path / "study.json").read_text("utf-8"))
    assert sum(one["verdict"] == "pass" for one in document["estimates"]) >= 110
    assert StudyOptions(seed=seed).judged
