"""The engine runs any bench: below the systems no identifier and no string says the name or a word of one."""

from __future__ import annotations

import ast
import re
import tokenize
from pathlib import Path

import pytest
from tree import TOP, files_that_say, name_of, nodes_of

from bench.model.systems import analyses

ROOMS = sorted(
    f"bench/{path.name}"
    for path in (TOP / "bench").iterdir()
    if (path / "__init__.py").exists() and path.name != "systems"
)
WORDS = "af_converter|ngu|gnc|gnc_module|imu|fog|fog_north|north_finder|rlg|lock_in|ring_laser|time_sync|egi|sar"
NAMED = re.compile(rf"(?<![A-Za-z0-9])(?:{WORDS})(?![A-Za-z0-9])", re.IGNORECASE)


def words_of(path: Path) -> list[str]:
    """Return identifiers and strings of a file that say a word of a system, with their lines; comments do not count."""
    with path.open("rb") as stream:
        tokens = [
            token for token in tokenize.tokenize(stream.readline) if token.type in (tokenize.NAME, tokenize.STRING)
        ]
    hits = [(token.start[0], NAMED.search(token.string)) for token in tokens]
    return [f"{name_of(path)}:{line} {hit[0]}" for line, hit in hits if hit is not None]


def test_no_room_of_the_engine_names_a_system() -> None:
    assert len(ROOMS) > 10
    assert [word for path in files_that_say(NAMED.pattern, *ROOMS) for word in words_of(path)] == []


WORDS_OF_THE_LANGUAGE = {"readings"}  # of a record; an analysis of all readings has the same name


def test_no_room_of_the_engine_asks_for_an_analysis_by_its_name() -> None:
    known = analyses().keys() - WORDS_OF_THE_LANGUAGE
    strings = [
        (name_of(path), node.value)
        for path in files_that_say("|".join(map(re.escape, known)), *ROOMS)
        for node in nodes_of(path)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]
    assert [place for place in strings if place[1] in known] == []


def test_a_word_in_a_name_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("test_no_system_is_named.name_of", lambda path: path.name)
    path = tmp_path / "sample.py"
    path.write_text("limits_of_gnc = {'fog_north': 1}\nsarcasm = 'longitude'\n")
    assert words_of(path) == ["sample.py:1 gnc", "sample.py:1 fog"]
