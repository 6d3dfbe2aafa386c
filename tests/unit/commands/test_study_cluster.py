"""Where a study is computed: every way that a cluster cannot be used says what and what next."""

from __future__ import annotations

import logging
import socket
import sys
from collections.abc import Mapping
from concurrent.futures import Future
from types import SimpleNamespace
from typing import Any

import pytest

from bench.commands import cluster as study_cluster
from bench.commands.cluster import failed, outcome_of, run_on_cluster, run_there, software_here
from bench.model.errors import BenchError, InputError
from bench.systems.time_sync.study.study import BASE, Group, Task

TASK = Task("flight", "turn", 1.0, (Group(0.0, augmented=False, noise=BASE),), 2, 1)


class FakeClient:
    """Workers that answer with these versions."""

    def __init__(self, answers: Mapping[str, Mapping[str, str]] | Exception) -> None:
        self._answers = answers

    def run(self, _: Any) -> Any:
        if isinstance(self._answers, Exception):
            raise self._answers
        return self._answers


def fails_with(code: str, where: str) -> BenchError:
    with pytest.raises(BenchError) as caught:
        run_on_cluster(where, [TASK], str, lambda _: None)
    assert caught.value.code == code
    assert caught.value.next_step
    return caught.value


@pytest.mark.parametrize(
    "where", ["", "4", "local", "local:x", "local:-1", "http://host:1", "tcp://", "tcp://a b:1", "local:0", "local:257"]
)
def test_a_place_that_is_none(where: str) -> None:
    fails_with("B-STUDY-003", where)


def test_without_dask(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert "inertial-bench[cluster]" in fails_with("B-STUDY-004", "local:2").next_step


def test_local_workers_keep_their_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """What stands in the environment counts before Dask's own setting, which doubles the time of a study."""
    monkeypatch.setattr(study_cluster.os, "environ", {"MALLOC_TRIM_THRESHOLD_": "1"})
    seen: dict[str, str] = {}
    study_cluster._local_cluster(SimpleNamespace(LocalCluster=lambda **_: seen.update(study_cluster.os.environ)), 2)
    assert (seen["MALLOC_MMAP_THRESHOLD_"], seen["MALLOC_TRIM_THRESHOLD_"]) == (str(1 << 30), "1")
    assert seen["OMP_NUM_THREADS"] == "1"


def test_nobody_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study_cluster, "CONNECT_s", 0.3)
    with socket.socket() as taken:  # bound and not listening: every connection is refused
        taken.bind(("127.0.0.1", 0))
        where = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        error = fails_with("B-STUDY-005", where)
    assert error.where == where
    assert "dask scheduler" in error.next_step
    assert logging.getLogger("distributed.client").level == logging.CRITICAL  # nobody is shown a traceback


def test_another_version_is_told() -> None:
    same = {**software_here(), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    study_cluster._check("tcp://a:1", FakeClient({"tcp://b:2": same}))
    for name, wrong in (("numpy", "1.0"), ("inertial-bench", "0.0"), ("OMP_NUM_THREADS", "8")):
        with pytest.raises(InputError) as caught:
            study_cluster._check("tcp://a:1", FakeClient({"tcp://b:2": same, "tcp://c:3": {**same, name: wrong}}))
        assert caught.value.code == "B-STUDY-006"
        assert "tcp://c:3" in caught.value.message
        assert f"{name} {wrong}" in caught.value.message
    with pytest.raises(InputError) as caught:
        study_cluster._check("tcp://a:1", FakeClient(ModuleNotFoundError("No module named 'bench'")))
    assert caught.value.code == "B-STUDY-006"


def test_a_task_that_fails_is_named() -> None:
    future: Future[Any] = Future()
    future.set_exception(MemoryError("too large"))
    result, wrong = outcome_of(future)
    assert result is None
    error = failed(TASK, wrong)
    assert error.code == "B-STUDY-007"
    assert "turn, unaugmented, offsets 0 ms" in error.message
    assert "MemoryError: too large" in error.message


def test_an_error_of_the_bench_travels_as_words() -> None:
    def refuse(_: Task) -> None:
        raise InputError("B-STUDY-002", "impossible", next_step="correct it")

    result, wrong = run_there(refuse, TASK)
    assert result is None
    assert wrong.startswith("error B-STUDY-002: impossible")
    future: Future[Any] = Future()
    future.set_result((result, wrong))
    assert outcome_of(future) == (None, wrong)
