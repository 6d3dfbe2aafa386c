"""Reports of both campaigns, short forms: on page and on paper, nothing on top of anything, everything named."""

from __future__ import annotations

from pathlib import Path
from subprocess import CompletedProcess

import pytest
import report_boxes
from recorded import writable_copy
from rehearsal import NAME, Inside

from bench.report import Report
from bench.session.service import read_view
from bench.session.view import analyse_view, report_of

FIGURES = {"scale_factor": 7, "bias_ramp": 8}


@pytest.fixture(scope="module", params=["scale_factor", "bias_ramp"])
def campaign(
    request: pytest.FixtureRequest,
    tmp_path_factory: pytest.TempPathFactory,
    short: tuple[Path, CompletedProcess[str]],
    ramp: Path,
) -> tuple[str, Path]:
    """Name and a copy of the session folder of a campaign in its short form."""
    folder = short[0] if request.param == "scale_factor" else ramp
    return request.param, writable_copy(folder, tmp_path_factory.mktemp(request.param) / folder.name)


def drawn(folder: Path) -> Report:
    view = read_view(folder)
    return report_of(view, *analyse_view(view))


@pytest.mark.slow
def test_figures_are_legible_on_page_and_paper(campaign: tuple[str, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    name, folder = campaign
    figures = report_boxes.recorded_figures(monkeypatch)
    report = drawn(folder)
    assert len(figures) == FIGURES[name] == sum(len(section.pictures) for section in report.sections)
    assert [report_boxes.flaws(figure) for figure in figures] == [[]] * len(figures)


@pytest.mark.slow
def test_page_and_paper_are_written_and_name_what_counts(campaign: tuple[str, Path], inside: Inside) -> None:
    _, folder = campaign
    before = (folder / "report.html").read_bytes()
    done = inside("report", str(folder), "--pdf")
    assert done.returncode == 0, done.stderr
    assert (folder / "report.pdf").read_bytes().startswith(b"%PDF-")
    assert (folder / "report.html").read_bytes() == before  # the run and the session say the same
    page = before.decode()
    for text in (
        "days left",
        "answered by",
        "No command of a person is recorded.",
        "air of the laboratory",
        "approved",
    ):
        assert text in page
    assert NAME.startswith("20000101T000000Z")
    assert "2000-01-01 00:00:00 UTC" in page
