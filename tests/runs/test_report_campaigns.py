"""Reports of both campaigns, short forms: on page and on paper, nothing on top of anything, everything named."""

from __future__ import annotations

import re
from pathlib import Path
from subprocess import CompletedProcess

import pytest
import report_boxes

from bench.session.service import read_view
from bench.session.view import analyse_view, report_of

GOLDEN = Path(__file__).resolve().parents[1] / "golden" / "sessions"
CODE_NAME = re.compile(r"(?<![\w/.])[a-z][a-z0-9]*(?:_[a-z0-9]+)+(?![\w/.])")
FIGURES = {"scale_factor": 7, "bias_ramp": 8}


def code_names(page: str) -> set[str]:
    """Words with underscores that a reader sees, but for what names files: the sequence, and software and hashes."""
    seen = re.sub(r"<(style|section id=\"provenance\").*?</(style|section)>", "", page, flags=re.DOTALL)
    return set(CODE_NAME.findall(re.sub(r"<[^>]*>|Sequence \w+,", " ", seen)))


@pytest.mark.slow
@pytest.mark.parametrize(
    "folder", sorted(path.parent for path in GOLDEN.glob("*/*/session.0001.mcap")), ids=lambda path: path.name
)
def test_no_report_shows_the_name_of_a_quantity_in_the_code(folder: Path) -> None:
    view = read_view(folder)
    assert code_names(report_of(view, *analyse_view(view)).html()) == set()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["scale_factor", "bias_ramp"])
def test_page_and_paper_are_legible_and_name_what_counts(
    name: str, short: tuple[Path, CompletedProcess[str]], ramp: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = short[0] if name == "scale_factor" else ramp
    figures = report_boxes.recorded_figures(monkeypatch)
    view = read_view(folder)
    report = report_of(view, *analyse_view(view))
    assert len(figures) == FIGURES[name] == sum(len(section.pictures) for section in report.sections)
    assert [report_boxes.flaws(figure) for figure in figures] == [[]] * len(figures)
    assert report.pdf().startswith(b"%PDF-")
    page = report.html()
    assert (folder / "report.html").read_text(encoding="utf-8") == page  # the run and the session say the same
    for text in (
        "days left",
        "answered by",
        "No command of a person is recorded.",
        "air of the laboratory",
        "approved",
    ):
        assert text in page
    assert "2000-01-01 00:00:00 UTC" in page
    assert code_names(page) == set()
