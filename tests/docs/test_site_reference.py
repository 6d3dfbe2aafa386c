"""What the site writes from the software itself names everything there is, and its menu has every page once."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from doc_blocks import ROOT

from bench.cli import app

SITE = ROOT / "docs" / "site"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return what Sphinx would read: pages, generated pages, the files they lead to."""
    source = tmp_path_factory.mktemp("site") / "source"
    program = f"import pathlib, build; build.gather(pathlib.Path({str(source)!r}))"
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=SITE, env={"PYTHONPATH": f"{SITE}:{ROOT}"}, check=False,
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return source


def commands(command: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Yield every command below one, with its full name."""
    for word, other in getattr(command, "commands", {}).items():
        yield f"{name} {word}", other
        yield from commands(other, f"{name} {word}")


def test_every_command_and_option_has_a_line(site: Path) -> None:
    page = (site / "docs" / "reference" / "commands.md").read_text(encoding="utf-8")
    sections = {part.partition("\n")[0]: part for part in page.split("\n### ")[1:]}
    found = dict(commands(typer.main.get_command(app), "bench"))
    assert sections.keys() == found.keys()
    for name, command in found.items():
        options = [word for param in command.params for word in param.opts if word.startswith("--")]
        assert [word for word in options if word != "--help" and word not in sections[name]] == [], name


def test_the_menu_has_every_page_once(site: Path) -> None:
    front = (site / "index.md").read_text(encoding="utf-8")
    entries = [line for line in front.splitlines() if line.startswith("docs/")]
    pages = {f"docs/{path.stem}" for path in (site / "docs").glob("*.md")}
    assert sorted(entries) == sorted(set(entries))
    assert pages <= set(entries)
