"""The command line as people use it: every command in a group, -h, --version, guesses, completion."""

from __future__ import annotations

from typing import Any

import pytest
import typer.main
from rehearsal import Inside

import bench
from bench.cli import app
from bench.commands.usage import GROUPS, completing

COMMAND = typer.main.get_command(app)


def test_every_command_stands_in_one_group() -> None:
    listed = [name for lines in GROUPS.values() for name in lines]
    assert sorted(listed) == sorted(COMMAND.commands)  # type: ignore[attr-defined]


def test_help_and_version_are_options_too(inside: Inside) -> None:
    """tests/runs/test_cli_status.py asks each command for its help."""
    assert inside().stdout == inside("--help").stdout == inside("-h").stdout
    assert inside("--version").stdout == inside("version").stdout == f"{bench.__version__}\n"


def test_a_mistyped_command_is_guessed(inside: Inside) -> None:
    done = inside("rnu")
    assert done.returncode == 2
    assert "error B-CLI-011: " in done.stderr
    assert "'run'" in done.stderr


def test_commands_names_and_paths_are_completed(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "benches").mkdir()
    (tmp_path / "bench.yaml").touch()
    (tmp_path / "notes.txt").touch()
    monkeypatch.chdir(tmp_path)
    assert completing("stations")("af_bench") == ["af_bench_sim"]
    assert completing("sequences")("bench") == ["bench.yaml", "benches/"]
    assert completing("frames")(f"{tmp_path}/b") == [f"{tmp_path}/bench.yaml", f"{tmp_path}/benches/"]
    assert completing("frames")("nowhere/") == []


def test_the_shell_is_told_how_to_complete(inside: Inside, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"_BENCH_COMPLETE": "complete_bash", "COMP_WORDS": "bench re", "COMP_CWORD": "1"}.items():
        monkeypatch.setenv(name, value)
    assert inside().stdout.split() == ["resume", "replay", "report", "recover"]
    monkeypatch.setenv("COMP_WORDS", "bench run timeline_")
    monkeypatch.setenv("COMP_CWORD", "2")
    assert inside().stdout.split() == ["timeline_example"]
