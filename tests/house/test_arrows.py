"""No file imports itself by way of others; simulated models stand alone. Imports in functions and for types count."""

from __future__ import annotations

import ast
import re

import pytest
from structure import arrows, circles
from tree import PRODUCT, TOP, python_files, tree_of

FILES = {
    ".".join(path.relative_to(TOP).with_suffix("").parts).removesuffix(".__init__"): path
    for path in python_files(*PRODUCT)
}
BESIDE = ("sim_instruments", "sim_instruments.seeds")  # no models, in the folder of the models
MODELS = {name for name, path in FILES.items() if path.parent == TOP / "sim_instruments"}.difference(BESIDE)
SHARED = tuple(f"sim_instruments.{room}" for room in ("bus", "faults", "seeds", "worlds.common"))
OF_A_SYSTEM = re.compile(r"sim_instruments\.worlds\.(?!common\b|kinds\b|simulation\b)")
ARROWS = arrows({name: tree_of(path) for name, path in FILES.items()})


def test_there_is_no_circle() -> None:
    assert circles(ARROWS) == []


def test_a_planted_circle_is_found() -> None:
    planted = {
        "a": "from b import thing",
        "b": "def late():\n    import c.d",
        "c.d": "if TYPE_CHECKING:\n    from a import other",
        "e": "import a",
    }
    assert circles(arrows({name: ast.parse(text) for name, text in planted.items()})) == [{"a", "b", "c.d"}]


@pytest.mark.parametrize("name", sorted(MODELS))
def test_a_simulated_model_knows_what_instruments_share_only(name: str) -> None:
    others = {target for target in ARROWS[name] - MODELS if target.startswith("sim_instruments")}
    assert {target for target in others if not target.startswith(SHARED)} == set()


def test_only_worlds_of_a_system_know_models() -> None:
    knowing = {name for name, targets in ARROWS.items() if targets & MODELS} - MODELS
    assert {name for name in knowing if not OF_A_SYSTEM.match(name)} == set()
