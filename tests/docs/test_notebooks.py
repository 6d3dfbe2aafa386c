"""The notebooks are kept as they were executed, and small; ``make site`` executes them anew and fails with any cell."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from doc_blocks import ROOT

NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


def code_of(path: Path) -> list[dict[str, Any]]:
    """Return the cells of code of a notebook."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    return [cell for cell in cells if cell["cell_type"] == "code"]


def test_there_are_notebooks() -> None:
    assert len(NOTEBOOKS) >= 3


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_it_was_executed_in_order_without_an_error(path: Path) -> None:
    cells = code_of(path)
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    assert {output["output_type"] for cell in cells for output in cell["outputs"]} <= {
        "display_data", "execute_result", "stream",
    }  # fmt: skip
    assert path.stat().st_size < 100_000


def test_the_site_executes_them_and_takes_no_warning() -> None:
    configuration = (ROOT / "docs" / "site" / "conf.py").read_text(encoding="utf-8")
    assert 'nb_execution_mode = "force"' in configuration
    assert "nb_execution_raise_on_error = True" in configuration
    assert "--fail-on-warning" in (ROOT / "docs" / "site" / "build.py").read_text(encoding="utf-8")
