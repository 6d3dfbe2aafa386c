"""The catalogue of the report: no text is missing, none is left over, none stands in the code."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import bench.report
from bench.model.texts import Texts, languages
from bench.report import Report
from bench.report.model import ReportModel
from bench.report.words import FOLDER, words_of

SOURCES = sorted(path for path in Path(bench.report.__file__).parent.rglob("*.py") if path.parent.name != "dcc")
KEYS = words_of("en").all


def called(tree: ast.AST) -> Iterator[ast.expr]:
    """First arguments of ``words(...)`` and ``words.all.get(...)``."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and node.args and ast.unparse(node.func) in ("words", "words.all.get"):
            yield node.args[0]


def patterns(expression: ast.expr) -> list[str]:
    """Regular expressions of the keys an expression can give; none for a plain variable."""
    if isinstance(expression, ast.IfExp):
        return patterns(expression.body) + patterns(expression.orelse)
    if isinstance(expression, ast.Constant):
        return [re.escape(str(expression.value))]
    if isinstance(expression, ast.JoinedStr):
        parts = [re.escape(part.value) if isinstance(part, ast.Constant) else r"[\w.-]*" for part in expression.values]
        return ["".join(parts)]
    return []


TREES = [ast.parse(path.read_text(encoding="utf-8")) for path in SOURCES]
WANTED = {pattern for tree in TREES for one in called(tree) for pattern in patterns(one)}
LITERAL = {node.value for tree in TREES for node in ast.walk(tree) if isinstance(node, ast.Constant)}
TEMPLATE = (FOLDER / "templates" / "report.html.j2").read_text(encoding="utf-8")


def test_there_are_texts() -> None:
    assert len(KEYS) > 100
    assert len(WANTED) > 50
    assert languages(FOLDER)[0] == "en"


def test_no_text_is_missing() -> None:
    assert [one for one in sorted(WANTED) if not any(re.fullmatch(one, key) for key in KEYS)] == []
    assert [key for key in re.findall(r"words\('([^']+)'\)", TEMPLATE) if key not in KEYS] == []


def test_no_text_is_left_over() -> None:
    used = "|".join(sorted(WANTED))
    left = [key for key in KEYS if not re.fullmatch(used, key) and key not in LITERAL and f"'{key}'" not in TEMPLATE]
    assert left == []


def test_language_of_the_page() -> None:
    model = ReportModel(title="T", results={"session": "s", "estimates": []})
    assert '<html lang="en">' in Report(model).html()


def test_another_language_needs_no_code(tmp_path: Path) -> None:
    (tmp_path / "texts").mkdir()
    (tmp_path / "texts" / "en.json").write_text((FOLDER / "texts" / "en.json").read_text())
    (tmp_path / "texts" / "ko.json").write_text('{"section.summary": "요약"}')
    words = Texts(tmp_path, "ko")
    assert words("section.summary") == "요약"
    assert words("section.quality") == KEYS["section.quality"]
