"""The report as PDF: complete, inside the page, fonts and tables inside, the same bytes for the same numbers."""

from __future__ import annotations

import io
import json
import re
import sys
import zlib
from collections.abc import Iterator
from contextlib import suppress

import numpy as np
import pytest
from fontTools.ttLib import TTFont
from matplotlib.image import imread
from report_sample import sample_model, sample_results

from bench.analysis import Figure, series
from bench.analysis import Table as Shown
from bench.model.errors import InputError
from bench.report import Report
from bench.report.document import document_files, png_pages
from bench.report.fonts import folders
from bench.report.model import ReportModel
from bench.report.sheet import missing, width_pt
from bench.report.tables import words_of

DPI = 60.0
STREAM = re.compile(rb"stream\r?\n(.*?)\r?\nendstream", re.DOTALL)


@pytest.fixture(scope="module")
def report() -> Report:
    return Report(sample_model())


@pytest.fixture(scope="module")
def marked_pages(report: Report) -> list[bytes]:
    return report.pages(DPI)


@pytest.fixture(scope="module")
def real_pages(report: Report) -> list[bytes]:
    """Pages of the same sections: only the mark on them tells a simulated run."""
    return png_pages(sample_model(simulated=False), report.sections, words_of("en"), DPI)


@pytest.fixture(scope="module")
def pdf(report: Report) -> bytes:
    return report.pdf()


def unpacked(pdf: bytes) -> Iterator[bytes]:
    """Every stream of the file that is packed."""
    for found in STREAM.finditer(pdf):
        with suppress(zlib.error):
            yield zlib.decompress(found[1])


def opened(pdf: bytes) -> bytes:
    """The file with every stream that is packed laid open behind it."""
    return pdf + b"\n".join(unpacked(pdf))


def test_same_numbers_same_bytes_and_no_date(report: Report, pdf: bytes) -> None:
    assert pdf.startswith(b"%PDF-")
    assert report.pdf() == pdf
    inside = opened(pdf)
    assert b"CreationDate" not in inside
    assert b"CreateDate" not in inside


def test_every_font_and_page_is_inside(pdf: bytes, marked_pages: list[bytes]) -> None:
    inside = opened(pdf)
    names = set(re.findall(rb"/FontName\s*/[A-Z]{6}\+([A-Za-z-]+)", inside))
    assert names == {b"DejaVuSans", b"DejaVuSans-Bold"}
    assert len(re.findall(rb"/FontFile[23]?\b", inside)) >= len(names)
    assert f"/Count {len(marked_pages)}".encode() in inside
    assert len(marked_pages) >= 8


def test_a_simulated_run_is_marked_on_every_page_and_a_real_one_on_none(
    marked_pages: list[bytes], real_pages: list[bytes]
) -> None:
    pale_red = np.array((248.0, 232.0, 235.0)) / 255.0  # 9 % of the red of the mark on white
    for pages, marked in ((marked_pages, True), (real_pages, False)):
        for page in pages:
            away = np.abs(imread(io.BytesIO(page))[..., :3] - pale_red).max(axis=2)
            count = int((away < 3.0 / 255.0).sum())
            assert count > 1000 if marked else count < 100


@pytest.mark.parametrize("language", ["en", "ko"])
def test_every_text_has_its_glyphs(language: str) -> None:
    words = words_of(language)
    assert missing("".join(words.all.values())) == set()
    files = document_files(sample_model(), Report(sample_model(), language).sections, words)
    assert {name for name, raw in files.items() if name != "main" and missing(raw.decode())} == set()


def test_what_a_person_wrote_is_no_markup_and_loses_no_character(no_korean_font: None) -> None:
    results = sample_results() | {"estimates": [], "session": "20000101T000000Z_#panic_한"}
    model = ReportModel(title='*x* $y$ #import "no" \\', results=results, notes=("= not a heading @ref <tag>",))
    report = Report(model)
    frame = json.loads(document_files(model, report.sections, words_of("en"))["report.json"])
    assert frame["title"] == model.title
    assert frame["first"]["number"].endswith("#panic_[U+D55C]")
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


@pytest.mark.parametrize(
    ("place", "file", "bold", "text"),
    [
        (0, "DejaVuSans.ttf", False, "−12\u202f345.678 ± 0.012"),
        (0, "DejaVuSans-Bold.ttf", True, "µΩ°C²∞√·…–—"),
        (1, "NanumGothic.ttf", False, "한"),
        (1, "NanumGothicBold.ttf", True, "한"),
    ],
)
def test_widths_are_those_of_another_reader_of_the_font(place: int, file: str, bold: bool, text: str) -> None:
    with TTFont(folders()[place] / file) as font:
        charmap, advances, units = font.getBestCmap(), font["hmtx"], font["head"].unitsPerEm
    expected = 10.0 * sum(advances[charmap[ord(one)]][0] for one in text) / units
    assert width_pt(text, 10.0, bold) == pytest.approx(expected, rel=1e-6)


def test_without_the_font_paper_is_refused_and_the_page_is_written(no_korean_font: None) -> None:
    model = ReportModel(
        title="T", results={"session": "s", "estimates": []},
        figures=(Figure("한글", "", "x", "y", [series("한", [0.0, 1.0], [0.0, 1.0])]),),
        tables=(Shown("표", "", ["가"], [["나"]]),),
    )  # fmt: skip
    report = Report(model, "ko")
    assert "한글" in report.html()
    with pytest.raises(InputError, match=r"font that is not installed") as caught:
        report.pdf()
    assert caught.value.code == "B-TXT-002"
    assert "inertial-bench[ko]" in caught.value.next_step
