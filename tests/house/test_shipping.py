"""The repository as somebody else gets it: complete packages, clean locks, no trace of one machine."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from tree import PRODUCT, TOP, name_of, python_files, text_files

PROJECT = tomllib.loads((TOP / "pyproject.toml").read_text(encoding="utf-8"))
LOCKS = sorted((TOP / "requirements").glob("*.txt"))
SHIPPED = ("frames", "sequences", "stations")
TRACES = re.compile(
    r"(?<![\w.])/(?:root|work|opt|home/[a-z]+|Users/[A-Za-z]+)/[\w.]"
    r"|(?:pypi|index|artifact\w*)\.[a-z]+(?:\.[a-z]+)*/simple"
    r"|--(?:extra-)?index-url[ =]\S"
)


def test_every_package_is_in_the_wheel() -> None:
    found = {".".join(path.parent.relative_to(TOP).parts) for path in python_files(*PRODUCT) if path.parent != TOP}
    named = set(PROJECT["tool"]["setuptools"]["packages"])
    assert named == found | {f"bench.shipped.{kind}" for kind in SHIPPED}


@pytest.mark.parametrize("kind", SHIPPED)
def test_shipped_folders_go_into_the_package(kind: str) -> None:
    setuptools = PROJECT["tool"]["setuptools"]
    assert setuptools["package-dir"][f"bench.shipped.{kind}"] == kind
    assert setuptools["package-data"][f"bench.shipped.{kind}"] == ["*.yaml"]
    assert list((TOP / kind).glob("*.yaml"))


def test_files_beside_the_code_go_into_the_wheel() -> None:
    patterns = PROJECT["tool"]["setuptools"]["package-data"]
    for path in (TOP / "bench").rglob("*"):
        if path.is_file() and path.suffix not in {".py", ".pyc"}:
            owners = [name for name in patterns if (TOP / name.replace(".", "/")) in path.parents]
            matched = [path.match(f"{owner.replace('.', '/')}/{glob}") for owner in owners for glob in patterns[owner]]
            assert any(matched), name_of(path)


@pytest.mark.parametrize("path", LOCKS, ids=name_of)
def test_lock_is_hashed_and_names_no_index(path: Path) -> None:
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    text = "".join(line for line in lines if not line.lstrip().startswith("#"))
    assert not re.search(r"index-url|find-links|trusted-host|file:|https?:", text)
    pins = re.findall(r"^[a-z0-9][a-z0-9._-]*==\S+ \\\n    --hash=sha256:[0-9a-f]{64}", text, re.MULTILINE)
    assert len(pins) == len(re.findall(r"^[^#\s-]", text, re.MULTILINE)) > 0


def test_locks_agree() -> None:
    pins = {path.stem: dict(re.findall(r"^(\S+)==(\S+)", path.read_text("utf-8"), re.MULTILINE)) for path in LOCKS}
    assert set(pins) == {"benchmark", "broker", "build", "dev", "docs", "mutation", "run"}
    for other in ("dev", "docs", "benchmark", "mutation"):
        assert pins["run"].items() <= pins[other].items()


def test_no_trace_of_one_machine() -> None:
    own = Path(__file__)
    found = [
        f"{name_of(path)}: {match[0]}"
        for path in text_files()
        if path != own
        for match in TRACES.finditer(path.read_text(encoding="utf-8", errors="replace"))
    ]
    assert found == []
