"""Nothing comes alone: a driver has its simulator and protocol test, a frame its golden, a mutant its tests."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from runpy import run_path

import pytest
from tree import TOP, files_that_say, name_of, nodes_of, python_files, text_of

FRAMES = sorted((TOP / "frames").glob("*.yaml"))


def is_driver(path: Path) -> bool:
    """Return whether a module names its driver class."""
    return re.search(r"^DRIVER = ", text_of(path), re.MULTILINE) is not None


DRIVERS = [path for path in python_files("instruments") if path.parent.name == "instruments" and is_driver(path)]


def test_driver_has_simulator_and_protocol_test() -> None:
    assert [path.name for path in DRIVERS if not (TOP / "sim_instruments" / path.name).is_file()] == []
    rows = "".join(text_of(path) for path in (TOP / "tests" / "protocol").glob("test_*.py"))
    assert [path.stem for path in DRIVERS if f'NAME = "{path.stem}"' not in rows] == []


def test_frame_has_a_golden() -> None:
    without = [path for path in FRAMES for word in ("golden", "expect") if not re.search(rf"\b{word}:", text_of(path))]
    assert without == []


@pytest.mark.parametrize("room", ["maths", "replay", "report", "analysis", "session", "systems", "record", "store"])
def test_simulated_truth_is_out_of_reach(room: str) -> None:
    for path in files_that_say("truth", f"bench/{room}"):
        strings = {node.value for node in nodes_of(path) if isinstance(node, ast.Constant)}
        assert not any(isinstance(text, str) and "truth.json" in text for text in strings), name_of(path)


def test_every_mutant_finds_its_text_and_its_tests() -> None:
    wrong = []
    for mutant in run_path(str(TOP / "tests" / "mutants" / "catalogue.py"))["MUTANTS"]:
        wrong += [mutant.name] if text_of(TOP / mutant.file).count(mutant.old) != 1 else []
        named = (test.partition("[")[0].split("::") for test in mutant.tests)
        wrong += [f"{file}::{name}" for file, *_, name in named if f"def {name}(" not in text_of(TOP / file)]
    assert wrong == []
