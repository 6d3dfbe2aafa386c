"""YAML of the pages holds the schema of what it is; Python runs; the rest is read by what it is written for."""

from __future__ import annotations

import json
import textwrap
import tomllib
from pathlib import Path
from typing import Any

import pytest
from doc_blocks import PAGES, ROOT, Block, blocks, blocks_of
from jsonschema import Draft202012Validator
from pydantic import RootModel

from bench.model.manual import Manual
from bench.model.yamlio import parse_yaml
from bench.plan import json_schemas, mapping_schema
from bench.web.fleet.fleet_file import FleetFile

SCHEMAS = {
    **json_schemas(),
    "mapping": mapping_schema(),
    "manual of an instrument": Manual.model_json_schema(),
    "fleet": FleetFile.model_json_schema(),
}
NAMES = {  # what a piece of a module stands in
    "docs/adding-a-system.md": """
from types import SimpleNamespace
from bench.analysis import Analysis, Material
from sim_instruments.worlds.common.terminals import Source, Terminals
self = SimpleNamespace(terminals=Terminals())
""",
    "docs/adding-an-analysis.md": """
from collections.abc import Callable
import pytest
from bench.analysis import Analysis, Material
""",
    "docs/adding-an-instrument.md": """
from bench.model.ports import Effect, Parameter, action
from instruments.values import exponent_form
""",
    "docs/lab-folder.md": """
from bench.model.declaration import AnalysisDeclaration
METHODS = ("mean",)
""",
}
RUN_ELSEWHERE = {
    "docs/python.md": "tests/runs/test_python_api.py",
    "docs/session-format.md": "tests/support/stranger_page.py",
    "docs/tutorial.md": "tests/docs/test_tutorial.py",
}

NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


class AnyDocument(RootModel[Any]):
    """A YAML document of any form, as the loader of the bench reads it."""


def document_of(block: Block) -> dict[str, Any]:
    """Return the document that a block is a part of: a list of steps is one of a sequence."""
    content = parse_yaml(block.text, block.place, AnyDocument).model.root
    return {"steps": content} if isinstance(content, list) else content


@pytest.mark.parametrize("block", blocks("yaml"), ids=lambda block: block.place)
def test_yaml_holds_its_schema(block: Block) -> None:
    """Find the kind of file that has all its keys, and hold each value against the schema of its key."""
    document = document_of(block)
    kinds = [kind for kind, schema in SCHEMAS.items() if document.keys() <= schema["properties"].keys()]
    assert kinds, f"{block.place}: no kind of file has the keys {', '.join(document)}"
    problems = {}
    for kind in kinds:
        part = {**SCHEMAS[kind], "required": []}
        problems[kind] = [error.message for error in Draft202012Validator(part).iter_errors(document)]
    assert [] in problems.values(), f"{block.place}: {problems}"


@pytest.mark.parametrize("block", blocks("python"), ids=lambda block: block.place)
def test_python_runs(block: Block) -> None:
    if block.page in RUN_ELSEWHERE:
        assert Path(block.page).name in (ROOT / RUN_ELSEWHERE[block.page]).read_text(encoding="utf-8")
        return
    exec(compile(NAMES.get(block.page, "") + textwrap.dedent(block.text), block.place, "exec"), {"__name__": "page"})


@pytest.mark.parametrize("block", blocks("toml"), ids=lambda block: block.place)
def test_toml_is_that_of_the_example(block: Block) -> None:
    shown = tomllib.loads(block.text)["project"]["entry-points"]
    example = ROOT / "examples" / "resistance_thermometer" / "pyproject.toml"
    assert shown.items() <= tomllib.loads(example.read_text(encoding="utf-8"))["project"]["entry-points"].items()


def test_every_block_with_a_language_is_looked_at() -> None:
    """JSON is the manifests of the session format, from which tests/unit/record writes sessions; what is written for
    Prometheus is read by tests/unit/web/telemetry."""
    known = {"sh", "yaml", "python", "toml", "text", "nginx", "prometheus"}
    found = [block for page in PAGES for block in blocks_of(page) if block.language not in known]
    assert {(block.language, block.page) for block in found} == {("json", "docs/session-format.md")}


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_a_notebook_was_executed_in_order_without_an_error(path: Path) -> None:
    """``make site`` executes them anew and fails with any cell."""
    cells = [cell for cell in json.loads(path.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    assert "error" not in {output["output_type"] for cell in cells for output in cell["outputs"]}
