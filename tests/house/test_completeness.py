"""Nothing comes alone: a driver has its simulator and protocol test, a frame its golden, a fit its source."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest
from tree import TOP, imported, name_of, python_files, tree_of

FRAMES = sorted((TOP / "frames").glob("*.yaml"))
FITS = [
    path
    for path in python_files("bench/maths", "bench/systems")
    if path.name != "__init__.py" and {"maths", "estimators"} & set(path.parts)
]
ALLOWED = ("bench.model", "bench.frame")


def is_driver(path: Path) -> bool:
    """A module that names its driver class."""
    targets = [ast.unparse(node.targets[0]) for node in tree_of(path).body if isinstance(node, ast.Assign)]
    return "DRIVER" in targets


DRIVERS = [path for path in python_files("instruments") if path.parent.name == "instruments" and is_driver(path)]


def test_there_is_something_to_check() -> None:
    assert len(DRIVERS) >= 10
    assert len(FRAMES) >= 4
    assert FITS


@pytest.mark.parametrize("path", DRIVERS, ids=name_of)
def test_driver_has_simulator_and_protocol_test(path: Path) -> None:
    assert (TOP / "sim_instruments" / path.name).is_file(), "write the simulator of the same model"
    assert (TOP / "tests" / "protocol" / f"test_{path.name}").is_file(), "write the protocol test"


@pytest.mark.parametrize("path", FRAMES, ids=name_of)
def test_frame_has_a_golden(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert re.search(r"\bgolden:", text)
    assert re.search(r"\bexpect:", text)


@pytest.mark.parametrize("path", FITS, ids=name_of)
def test_fit_names_its_source(path: Path) -> None:
    assert re.search(r"^\s*Sources?:", path.read_text(encoding="utf-8"), re.MULTILINE)


def test_instruments_know_floor_0_and_frames_only() -> None:
    wrong = {}
    for path in python_files("instruments", "sim_instruments"):
        rooms = {name for name in imported(tree_of(path)) if name.split(".")[0] == "bench"}
        if found := {name for name in rooms if not name.startswith(ALLOWED)}:
            wrong[name_of(path)] = found
    assert wrong == {}


@pytest.mark.parametrize("room", ["maths", "replay", "report", "analysis", "session", "systems", "record", "store"])
def test_simulated_truth_is_out_of_reach(room: str) -> None:
    for path in python_files(f"bench/{room}"):
        strings = {node.value for node in ast.walk(tree_of(path)) if isinstance(node, ast.Constant)}
        assert not any(isinstance(text, str) and "truth.json" in text for text in strings), name_of(path)
