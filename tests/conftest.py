"""Campaigns for all system tests, recorded once per test run, and a way to run a plan and reach the simulated world."""

import functools
import gc
import json
import os
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from probe_bench import installed
from rehearsal import (
    NAME,
    SAID,
    Crashes,
    Inside,
    Rehearsal,
    crashed_everywhere,
    crashes_in,
    main_of,
    record_golden,
    record_ramp,
    record_short,
    recorded,
    rehearsed,
    writable_copy,
)
from two_ends import TwoEnds, arrange

from bench.model.lab import cache_folder

pytest_plugins = ["stalls"]

settings.register_profile("any machine", suppress_health_check=[HealthCheck.too_slow], deadline=None)
settings.load_profile("any machine")  # how fast inputs are drawn says something of the machine only


def pytest_configure(config: pytest.Config) -> None:
    """Share no cache with the user."""
    os.environ.pop("SSH_CONNECTION", None)  # who develops through ssh is at the bench here
    if not hasattr(config, "workerinput"):
        config.add_cleanup(_own_cache().cleanup)


def _own_cache() -> tempfile.TemporaryDirectory[str]:
    """Make a cache for all tests, in which no results are kept: one test must not see those of another."""
    folder = tempfile.TemporaryDirectory(prefix="bench-tests-")
    os.environ["XDG_CACHE_HOME"] = folder.name
    cache_folder().mkdir()
    (cache_folder() / "results").write_text("not a folder, so nothing can be kept in it")
    return folder


def pytest_collection(session: pytest.Session) -> None:
    """Look for no garbage while thousands of tests are collected: there is none."""
    gc.disable()


def pytest_collection_finish(session: pytest.Session) -> None:
    """Look for garbage again, but never among what was collected: it stays to the end."""
    gc.freeze()
    gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the files with tests that wait in front."""
    arrange(items)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> TwoEnds | None:
    """Share out whole files from both ends where they are shared out as wholes."""
    return TwoEnds(config, log) if config.option.dist == "loadfile" else None


@pytest.fixture(scope="module")
def probes() -> Iterator[None]:
    """Have the world and the analysis of probe_bench installed while the tests of a module run."""
    with installed():
        yield


@pytest.fixture(scope="module")
def without_pictures() -> Iterator[None]:
    """Leave the pictures of reports empty, of which drawing is most of the work, where no test looks at them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bench.report.plots.style.svg_text", lambda *_: "<svg></svg>")
        yield


@pytest.fixture(scope="session")
def short(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, subprocess.CompletedProcess[str]]:
    """Return the folder of the short campaign and what the command said; for reading only."""
    folder = recorded(tmp_path_factory, "short", record_short)
    return folder / NAME, subprocess.CompletedProcess(**json.loads((folder / SAID).read_text()))


@pytest.fixture(scope="session")
def golden(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the smallest campaign with an analysis, with results and report; for reading only."""
    out = recorded(tmp_path_factory, "golden", record_golden)
    return next(path.parent for path in out.glob("*/results.json"))


@pytest.fixture
def session(golden: Path, tmp_path: Path) -> Path:
    """Return a copy of the smallest campaign with an analysis, for writing."""
    return writable_copy(golden, tmp_path / golden.name)


@pytest.fixture(scope="session")
def ramp(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the short bias campaign; for reading only."""
    out = recorded(tmp_path_factory, "ramp", record_ramp)
    return next(path.parent for path in out.glob("*/results.json"))


@pytest.fixture(scope="session")
def crashes(tmp_path_factory: pytest.TempPathFactory) -> Crashes:
    """Return the tiny campaign, copied at every place where it is killed; for reading only."""
    return crashes_in(recorded(tmp_path_factory, "crashes", crashed_everywhere))


@pytest.fixture
def inside(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Inside:
    """Run ``bench`` in this process, which saves the start of an interpreter."""

    def run(*words: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
        if cwd is not None:
            monkeypatch.chdir(cwd)
        status = main_of(monkeypatch, *words)
        said = capsys.readouterr()
        return subprocess.CompletedProcess(words, status, said.out, said.err)

    return run


@pytest.fixture
def rehearse(tmp_path: Path) -> Callable[..., Rehearsal]:
    """Run a plan; ``arrange`` changes the world before anything is opened, ``act`` at each step."""
    return functools.partial(rehearsed, tmp_path / "out")
