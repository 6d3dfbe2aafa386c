"""A laboratory's own folder: made, found from inside, its files before installed ones; where a study is computed."""

import json
import logging
import os
import socket
import sys
from collections.abc import Mapping
from concurrent.futures import Future
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from typer.testing import CliRunner

from bench.cli import app
from bench.commands import cluster as study_cluster
from bench.commands.cluster import failed, outcome_of, run_on_cluster, run_there, software_here
from bench.model.drivers import driver_class
from bench.model.errors import BenchError, InputError
from bench.model.lab import CODE, find_beside, find_shipped, lab_here, replaced_by_lab, shipped_folder
from bench.report import load_laboratory
from bench.systems.time_sync.study.study import BASE, Group, Task

FLAGS = ("--name", "Our laboratory", "--model", "NGU-2", "--serial", "17")


def bench(*words: str) -> str:
    done = CliRunner().invoke(app, words)
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    assert done.exit_code == 0, done.output
    return done.stdout


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    bench("init", "our_lab", *FLAGS)
    monkeypatch.chdir(tmp_path / "our_lab" / "frames")
    return tmp_path / "our_lab"


def test_a_new_folder_can_be_used_at_once(lab: Path) -> None:
    found = lab_here()
    assert (found.folder, found.name) == (lab.resolve(), "Our laboratory")
    assert "First check of NGU-2" in bench("check", "first_check")
    assert "golden frames are right" in bench("frame", "check", "my_unit")
    (lab / "frames/my_unit.yaml").rename(lab / "frames/ours.yaml")
    assert "calls itself my_unit" in bench("frame", "check", "ours")
    (lab / "sequences/first_check.yaml").rename(lab / "sequences/mine.yaml")
    assert "mine.yaml calls itself first_check" in bench("check", "mine")
    assert load_laboratory(lab / "laboratory.yaml").item.name == "NGU-2"  # as bench certificate reads it
    assert {path.name for path in (lab / "schemas").iterdir()} >= {"sequence.schema.json", "frame.schema.json"}
    for path in lab.rglob("*.yaml"):
        assert "@" not in path.read_text().replace('"@bench"', "").replace("@example.org", "")


def test_a_new_folder_takes_code_whatever_the_umask_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    before = os.umask(0o002)
    try:
        bench("init", "our_lab", *FLAGS)
    finally:
        os.umask(before)
    for kind in CODE:
        assert (tmp_path / "our_lab" / kind).stat().st_mode & 0o777 == 0o755
        assert (tmp_path / "our_lab" / kind / "README.md").read_text().count("\n") == 1
    monkeypatch.chdir(tmp_path / "our_lab")
    own = tmp_path / "our_lab" / "instruments" / "our_meter.py"
    own.write_text("class Meter: ...\n\n\nDRIVER = Meter\n")
    own.chmod(0o644)
    assert driver_class("our_meter").__name__ == "Meter"
    assert "Our laboratory, instruments/our_meter.py" in bench("list", "instruments")


def test_everything_is_listed_with_its_origin(lab: Path) -> None:
    entries = json.loads(bench("list", "--json"))
    origins = {(entry["kind"], entry["name"]): entry["origin"] for entry in entries}
    assert origins["frames", "my_unit"] == "Our laboratory, frames/my_unit.yaml"
    assert origins["sequences", "scale_factor_38h"] == "installed"
    assert origins["instruments", "hp_3458a"].startswith("inertial-bench ")
    assert origins["analyses", "scale_factor"].startswith("inertial-bench ")
    assert "first_check" in bench("list", "sequences")
    actions = {entry["name"]: entry["title"] for entry in json.loads(bench("list", "actions", "--json"))}
    said = "current 0 A to 2.2 A, [range lowest_that_holds|locked]; stimulus_set"
    assert actions["fluke_5720a.output"] == said
    assert actions["agilent_34401a.measure_voltage"] == "returns V"
    with pytest.raises(InputError, match=r"B-CLI-011: .*no kind"):
        bench("list", "drivers")


def test_an_own_file_stands_in_for_an_installed_one_and_it_is_said(lab: Path) -> None:
    name = "af_bench_sim"
    shipped = shipped_folder("stations") / f"{name}.yaml"
    sequence = shipped_folder("sequences") / "scale_factor_short.yaml"
    assert find_beside(sequence, "stations", name) == shipped
    own = lab / "stations" / f"{name}.yaml"
    own.write_text(shipped.read_text())
    assert find_shipped("stations", name).resolve() == own.resolve()
    assert find_beside(sequence, "stations", name).resolve() == own.resolve()
    assert find_shipped("stations", shipped) == shipped
    done = CliRunner().invoke(app, ["check", "scale_factor_short"])
    assert f"{own.resolve()} of Our laboratory, not the installed one" in done.stderr
    assert replaced_by_lab("stations", shipped) == ""
    assert "replaced by the lab's" in bench("list", "stations")


@pytest.mark.parametrize(
    ("text", "words"),
    [("[lab", "cannot be read as TOML"), ("[lab]\nname = 3", "does not name"), ("", "does not name"),
     ("lab = 3", "does not name"), ("[lab]\nname = 'x'\nowner = 1", "unknown key 'owner'"),
     ("[lab]\nname = 'x'\n[more]", "unknown key 'more'")],
)  # fmt: skip
def test_a_wrong_bench_toml_is_one_error(
    text: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "bench.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=words) as caught:
        find_shipped("frames", "no_such_frame")
    assert caught.value.code == "B-LAB-001"
    assert str(tmp_path) in caught.value.where


def test_nothing_is_written_over_and_names_stay_names(
    lab: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(lab)
    before = (lab / "bench.toml").read_text()
    for words, code in (
        (("init", str(lab), *FLAGS), "B-LAB-002"),
        (("init", str(lab / "bench.toml"), *FLAGS), "B-LAB-002"),
        (("init", str(tmp_path / "new"), "--name", 'a"b'), "B-LAB-003"),
        (("init", str(tmp_path / "new"), "--serial", "a{b}"), "B-LAB-003"),
        (("init", str(tmp_path / "new"), "--station", "nosuch"), "B-SHIP-001"),
        (("copy", "af_bnch_sim"), "B-SHIP-001"),
        (("copy", "ngu_a"), ""),
        (("copy", "ngu_a", "--as", "../bench"), ""),
        (("copy", "ngu_a"), "B-LAB-002"),
    ):
        with pytest.raises(InputError) if code else nullcontext() as caught:
            bench(*words)
        assert caught is None or caught.value.code == code
    assert (lab / "frames" / "bench.yaml").read_text().startswith("frame: bench\n")
    assert (lab / "bench.toml").read_text() == before
    assert not (tmp_path / "new").exists()


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
