"""A session names the git revision it was made by, and never that of somebody else's repository."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from mcap.stream_reader import StreamReader

ROOT = Path(__file__).resolve().parents[2]
SEALED = 20  # bytes in front of the payload: CRC, running number, time
MAPPING = """
mapping: bath
uut: {model: DMM, serial: A-12}
columns: {time: {role: time, format: unix, unit: s}, U: {role: reading, quantity: voltage, unit: V}}
"""


def git(root: Path, *words: str) -> str:
    command = ["git", "-C", str(root), "-c", "user.name=nobody", "-c", "user.email=nobody@example.org", *words]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def revision_in_session(root: Path, place: Path) -> str:
    """Import a log with the bench that lies below ``root``; return the revision its session names."""
    (place / "bath.yaml").write_text(MAPPING)
    (place / "log.csv").write_text("time,U\n0,1.0\n1,1.1\n")
    command = [sys.executable, "-m", "bench", "import", "bath.yaml", "log.csv", "--out", "out"]
    environment = os.environ | {"PYTHONPATH": str(root)}
    done = subprocess.run(command, cwd=place, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (segment,) = place.glob("out/*/session.0001.mcap")
    with segment.open("rb") as stream:
        manifest = next(record for record in StreamReader(stream).records if type(record).__name__ == "Message")
    return str(json.loads(manifest.data[SEALED:])["software"]["git"])


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="not a checkout")
def test_a_session_names_the_revision_of_the_checkout(tmp_path: Path) -> None:
    revision = git(ROOT, "rev-parse", "HEAD")
    assert revision_in_session(ROOT, tmp_path) in (revision, f"{revision} with local modifications")


@pytest.mark.parametrize("pyproject", [None, '[project]\nname = "theirs"\n'])
def test_the_repository_of_somebody_else_is_not_named(tmp_path: Path, pyproject: str | None) -> None:
    root = tmp_path / "theirs"
    shutil.copytree(ROOT / "bench", root / "bench")
    if pyproject is not None:
        (root / "pyproject.toml").write_text(pyproject)
    git(tmp_path, "init", "-q", str(root))
    git(root, "commit", "-q", "--allow-empty", "-m", "theirs")
    assert revision_in_session(root, tmp_path) == "not a checkout"
