"""The report as PDF: complete, inside the page, fonts inside the file, the same bytes for the same numbers."""

from __future__ import annotations

import io
import json
import re
import sys
import zlib
from collections.abc import Iterator

import numpy as np
import pytest
from matplotlib.image import imread
from report_sample import sample_model, sample_results

from bench.model.errors import InputError
from bench.report import Report
from bench.report.fonts import missing
from bench.report.model import ReportModel
from bench.report.pdf import document_files
from bench.report.words import words_of

MM_PER_INCH = 25.4
DPI = 60.0
STREAM = re.compile(rb"stream\r?\n(.*?)\r?\nendstream", re.DOTALL)


@pytest.fixture(scope="module")
def report() -> Report:
    return Report(sample_model())


@pytest.fixture(scope="module")
def real() -> Report:
    return Report(sample_model(simulated=False))


@pytest.fixture(scope="module")
def pdf(report: Report) -> bytes:
    return report.pdf()


def opened(pdf: bytes) -> bytes:
    """The file with every stream that is packed laid open behind it."""

    def unpacked() -> Iterator[bytes]:
        for found in STREAM.finditer(pdf):
            try:
                yield zlib.decompress(found[1])
            except zlib.error:
                continue

    return pdf + b"\n".join(unpacked())


def test_same_numbers_same_bytes_and_no_date(report: Report, pdf: bytes) -> None:
    assert pdf.startswith(b"%PDF-")
    assert report.pdf() == pdf
    inside = opened(pdf)
    assert b"CreationDate" not in inside
    assert b"CreateDate" not in inside


def test_every_font_is_inside(pdf: bytes) -> None:
    inside = opened(pdf)
    names = set(re.findall(rb"/FontName\s*/[A-Z]{6}\+([A-Za-z-]+)", inside))
    assert names == {b"DejaVuSans", b"DejaVuSans-Bold"}
    assert len(re.findall(rb"/FontFile[23]?\b", inside)) >= len(names)


def test_the_pictures_are_the_pages_of_the_file(report: Report, pdf: bytes) -> None:
    pages = report.pages(30.0)
    assert f"/Count {len(pages)}".encode() in opened(pdf)
    assert len(pages) >= 8


def test_nothing_reaches_into_the_margins(real: Report) -> None:
    """Header, footer, figures and tables end inside 18 mm from the left and right edge of the sheet."""
    for number, page in enumerate(real.pages(DPI), 1):
        grey = imread(io.BytesIO(page))[..., :3].mean(axis=2)
        assert grey.shape[1] == pytest.approx(210.0 / MM_PER_INCH * DPI, abs=1.0)
        edge = int(17.0 / MM_PER_INCH * DPI)
        ends = int(8.0 / MM_PER_INCH * DPI)
        for strip in (grey[:, :edge], grey[:, -edge:], grey[:ends], grey[-ends:]):
            assert np.ptp(strip) < 0.02, f"page {number}"
        assert np.ptp(grey) > 0.5, f"page {number} is empty"


def test_a_simulated_run_is_marked_on_every_page_and_a_real_one_on_none(report: Report, real: Report) -> None:
    pale_red = np.array((248.0, 232.0, 235.0)) / 255.0  # 9 % of the red of the mark on white
    for pages, marked in ((report.pages(50.0), True), (real.pages(50.0), False)):
        for page in pages:
            away = np.abs(imread(io.BytesIO(page))[..., :3] - pale_red).max(axis=2)
            count = int((away < 3.0 / 255.0).sum())
            assert count > 1000 if marked else count < 100


def test_every_text_has_its_glyphs(report: Report) -> None:
    words = words_of("en")
    assert missing("".join(words.all.values())) == set()
    files = document_files(sample_model(), report.sections, words)
    assert {name: missing(raw.decode()) for name, raw in files.items() if name != "main"} == {
        name: set() for name in files if name != "main"
    }


def test_what_a_person_wrote_is_no_markup_and_loses_no_character() -> None:
    results = sample_results() | {"estimates": [], "session": "20000101T000000Z_#panic_한"}
    model = ReportModel(title='*x* $y$ #import "no" \\', results=results, notes=("= not a heading @ref <tag>",))
    report = Report(model)
    frame = json.loads(document_files(model, report.sections, words_of("en"))["report.json"])
    assert frame["title"] == model.title
    assert frame["session"].endswith("#panic_[U+D55C]")
    assert report.pdf().startswith(b"%PDF-")


def test_without_typst_the_error_names_the_extra(report: Report, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "typst", None)
    with pytest.raises(InputError, match=r"inertial-bench\[pdf\]") as caught:
        report.pdf()
    assert caught.value.code == "B-REP-001"


def test_page_and_paper_have_the_same_sections(report: Report) -> None:
    page = report.html()
    frame = json.loads(document_files(sample_model(), report.sections, words_of("en"))["report.json"])
    titles = [chapter["title"] for chapter in frame["chapters"]]
    assert re.findall(r"<h2>([^<]*)</h2>", page) == titles
    pictures = [picture["file"] for chapter in frame["chapters"] for picture in chapter["pictures"]]
    assert len(pictures) == len(set(pictures)) == page.count("<svg ")
