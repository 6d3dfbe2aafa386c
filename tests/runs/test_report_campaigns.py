"""Reports of both campaigns, short forms: on page and on paper, nothing on top of anything, everything named."""

from __future__ import annotations

from pathlib import Path
from subprocess import CompletedProcess

import pytest
import report_sample
from report_sample import code_names

from bench.session.service import read_view
from bench.session.view import analyse_view, report_of

FIGURES = {"scale_factor": 7, "bias_ramp": 8}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["scale_factor", "bias_ramp"])
def test_page_and_paper_are_legible_and_name_what_counts(
    name: str, short: tuple[Path, CompletedProcess[str]], ramp: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = short[0] if name == "scale_factor" else ramp
    figures = report_sample.recorded_figures(monkeypatch)
    view = read_view(folder)
    report = report_of(view, *analyse_view(view))
    assert len(figures) == FIGURES[name] == sum(len(section.pictures) for section in report.sections)
    assert [report_sample.flaws(figure) for figure in figures] == [[]] * len(figures)
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
