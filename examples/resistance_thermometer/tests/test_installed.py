"""The distribution beside the wheel of the bench, in an environment of its own: what a stranger has.

No index is asked: what both depend on is taken from the environment that runs the test.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy
import pytest
from block import ROOT, SEQUENCE

BENCH = ROOT.parents[1]
NAME = "20000101T000000Z_resistance_thermometer_BATCH-1"
pytestmark = pytest.mark.sweep


def run(*words: object, cwd: Path, status: int = 0) -> str:
    clean = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(
        [str(word) for word in words], cwd=cwd, env=clean, capture_output=True, text=True, check=False
    )
    assert done.returncode == status, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the environment ``venv``; the bench and this distribution are its only packages of its own."""
    folder = tmp_path_factory.mktemp("stranger")
    run("git", "clone", "--quiet", "--depth", "1", f"file://{BENCH}", "source", cwd=folder)
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check")
    offline = ("--quiet", "--no-index", "--no-deps")
    sources = (folder / "source", folder / "source" / ROOT.relative_to(BENCH))
    run(*pip, "wheel", *offline, "--no-build-isolation", "--wheel-dir", "wheels", *sources, cwd=folder)
    run(sys.executable, "-m", "venv", "--without-pip", folder / "venv", cwd=folder)
    python = folder / "venv" / "bin" / "python"
    run(*pip, "--python", python, "install", *offline, *(folder / "wheels").iterdir(), cwd=folder)
    packages = run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=folder).strip()
    (Path(packages) / "dependencies.pth").write_text(f"{Path(numpy.__file__).parents[1]}\n")
    return folder


def test_the_whole_way_from_two_wheels(place: Path) -> None:
    bench = place / "venv" / "bin" / "bench"
    session = place / "out" / NAME
    assert "no mistake found" in run(bench, "check", SEQUENCE, cwd=place)
    run(bench, "run", SEQUENCE, "--clock", "virtual", "--seed", "3", "--out", "out", cwd=place)
    quality = json.loads((session / "results.json").read_text())["quality"]
    assert (quality["records"], quality["frames"]) == (8, 0)
    run(bench, "fit", session, cwd=place)
    assert "identical" in run(bench, "report", session, "--verify", cwd=place)
    assert "every number is identical" in run(bench, "replay", session, cwd=place)
    assert "P-101" in run(bench, "history", "list", "--history", "sqlite:///out/history.sqlite", cwd=place)
    run(bench, "certificate", session, "--specimen", cwd=place)


def test_without_the_distribution_the_bench_says_what_is_not_known(place: Path) -> None:
    python, bench = place / "venv" / "bin" / "python", place / "venv" / "bin" / "bench"
    run(sys.executable, "-m", "pip", "--python", python, "uninstall", "--yes", "resistance-thermometer", cwd=place)
    said = run(bench, "check", SEQUENCE, cwd=place, status=2)
    assert "resistance_thermometer" in said or "thermometer_block" in said
    assert "Traceback" not in said
