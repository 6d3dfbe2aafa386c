"""The tutorial is executed by a shell, block by block, and shows what it prints."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from doc_blocks import ROOT, Block, blocks_of

INSTALL = "pip install "  # needs a package index; .ci/wheel installs the wheel and uses it from an empty folder


def shell_with_bench(folder: Path) -> dict[str, str]:
    """Return an environment in which ``bench`` is this source and ``python`` this interpreter."""
    programs = folder / "programs"
    programs.mkdir()
    for name, words in (("bench", f"{sys.executable} -m bench"), ("python", sys.executable)):
        (programs / name).write_text(f'#!/bin/sh\nexec {words} "$@"\n')
        (programs / name).chmod(0o755)
    return {**os.environ, "PATH": f"{programs}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT), "COLUMNS": "160"}


def plain(text: str) -> str:
    """Return a text with single spaces: how wide a table is drawn does not matter."""
    return " ".join(text.split())


def run(block: Block, place: Path, environment: dict[str, str]) -> tuple[str, Path]:
    """Return what a block of commands says, and the folder in which it leaves the shell."""
    leave = place / ".left"
    done = subprocess.run(
        ["sh", "-euc", f"{block.text}\npwd > {leave}"], cwd=place, env=environment, check=False,
        capture_output=True, text=True, stdin=subprocess.DEVNULL,
    )  # fmt: skip
    said = done.stdout + done.stderr
    assert done.returncode == 0, f"{block.place}: {said}"
    return said, Path(leave.read_text().strip())


@pytest.mark.slow
def test_the_tutorial_runs_and_prints_what_it_shows(tmp_path: Path) -> None:
    (tmp_path / "inertial-bench").symlink_to(ROOT)
    environment, place, said, compared = shell_with_bench(tmp_path), tmp_path, "", 0
    for block in blocks_of(ROOT / "docs" / "tutorial.md"):
        if block.file:
            (place / block.file).write_text(block.text)
        elif block.language == "sh" and INSTALL not in block.text:
            said, place = run(block, place, environment)
        elif block.language == "text":
            lines = block.text.splitlines()
            assert [line for line in lines if plain(line) not in plain(said)] == [], f"{block.place}: {said}"
            compared += len(lines)
    assert compared >= 10
