"""Reports of both campaigns, short forms: on page and on paper, nothing on top of anything, everything named."""

from __future__ import annotations

from pathlib import Path

import pytest
import report_boxes
from rehearsal import NAME, SEED, bench

from bench.report import Report
from bench.session.service import read_view
from bench.session.view import analyse_view, report_of

FIGURES = {"scale_factor": 7, "bias_ramp": 8}


@pytest.fixture(scope="module", params=["scale_factor", "bias_ramp"])
def campaign(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    """Name and session folder of a campaign in its short form."""
    if request.param == "scale_factor":
        folder, _ = request.getfixturevalue("short")
        return request.param, folder
    out = tmp_path_factory.mktemp("ramp")
    bench("run", "bias_ramp_short", "--seed", str(SEED), "--out", str(out))
    return request.param, next(path.parent for path in out.glob("*/results.json"))


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
def test_page_and_paper_are_written_and_name_what_counts(campaign: tuple[str, Path]) -> None:
    _, folder = campaign
    before = (folder / "report.html").read_bytes()
    done = bench("report", str(folder), "--pdf")
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
