"""The command line as people read it: every command in a group, 80 columns, -h, --version, completion."""

from __future__ import annotations

from typing import Any

import pytest
import typer.main
from rehearsal import Inside

import bench
from bench.cli import app
from bench.commands.usage import GROUPS, completing

COMMAND = typer.main.get_command(app)


def every_command(command: Any = COMMAND, words: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """Return the words of every command, of the groups too."""
    inner = getattr(command, "commands", {})
    return [words, *(found for name, one in inner.items() for found in every_command(one, (*words, name)))]


@pytest.mark.parametrize("words", every_command(), ids=" ".join)
def test_help_is_readable_at_80_columns(
    words: tuple[str, ...], inside: Inside, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    done, long = inside(*words, "-h"), inside(*words, "--help")
    assert done.returncode == 0
    assert done.stdout == long.stdout
    lines = done.stdout.splitlines()
    assert lines[0].startswith(" ".join(("Usage: bench", *words, "[OPTIONS]")))
    assert max(map(len, lines)) <= 80
    assert not any(sign in done.stdout for sign in ("<bool>", "<str>", "<path>", "{", "│"))
    assert "-h, --help" in done.stdout
    if words:
        assert "Example" in done.stdout or "Commands:" in done.stdout or words == ("version",)


def test_every_command_stands_in_one_group() -> None:
    listed = [name for lines in GROUPS.values() for name in lines]
    assert sorted(listed) == sorted(COMMAND.commands)  # type: ignore[attr-defined]
    assert max(len(line) for lines in GROUPS.values() for line in lines.values()) <= 60


def test_usage_lines_name_what_is_due(inside: Inside) -> None:
    firsts = {words: inside(*words.split(), "-h").stdout.splitlines()[0] for words in ("", "run", "talk", "batch")}
    assert firsts == {
        "": "Usage: bench [OPTIONS] COMMAND",
        "run": "Usage: bench run [OPTIONS] SEQUENCE",
        "talk": "Usage: bench talk [OPTIONS] INSTRUMENT [COMMAND]",
        "batch": "Usage: bench batch [OPTIONS] SESSION...",
    }
    said = inside("run", "-h").stdout
    assert "  --station STATION " in said
    assert "  --seed N " in said
    assert "  --truth  " in said


def test_no_command_is_the_help(inside: Inside) -> None:
    assert inside().stdout == inside("--help").stdout
    assert inside("history").returncode in (0, 2)


def test_the_version_is_an_option_too(inside: Inside) -> None:
    assert inside("--version").stdout == inside("version").stdout == f"{bench.__version__}\n"
    assert inside("--version").returncode == 0


def test_a_mistyped_command_is_guessed(inside: Inside) -> None:
    done = inside("rnu")
    assert done.returncode == 2
    assert done.stderr == (
        "error B-CLI-011: No such command 'rnu'. Did you mean 'run'? Next: add --help to see how the command is used\n"
    )


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
