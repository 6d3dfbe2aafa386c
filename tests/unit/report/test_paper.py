"""The report as PDF: complete, inside the page, fonts and tables inside, the same bytes for the same numbers."""

from __future__ import annotations

import io
import json
import re
import sys
import zlib
from collections.abc import Iterator

import numpy as np
import pytest
from fontTools.ttLib import TTFont
from matplotlib.image import imread
from report_sample import sample_model, sample_results

from bench import analysis
from bench.model.errors import InputError
from bench.report import Report
from bench.report.document import document_files, png_pages
from bench.report.fonts import folders
from bench.report.model import ReportModel
from bench.report.sheet import ROOM_pt, SIZES_pt, legible, missing, sheets, width_pt
from bench.report.tables import Table, words_of

MM_PER_INCH = 25.4
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


def test_the_pictures_are_the_pages_of_the_file(marked_pages: list[bytes], pdf: bytes) -> None:
    assert f"/Count {len(marked_pages)}".encode() in opened(pdf)
    assert len(marked_pages) >= 8


@pytest.mark.slow
def test_nothing_reaches_into_the_margins(real_pages: list[bytes]) -> None:
    """Header, footer, figures and tables end inside 18 mm from the left and right edge of the sheet."""
    for number, page in enumerate(real_pages, 1):
        grey = imread(io.BytesIO(page))[..., :3].mean(axis=2)
        assert grey.shape[1] == pytest.approx(210.0 / MM_PER_INCH * DPI, abs=1.0)
        edge = int(17.0 / MM_PER_INCH * DPI)
        ends = int(8.0 / MM_PER_INCH * DPI)
        for strip in (grey[:, :edge], grey[:, -edge:], grey[:ends], grey[-ends:]):
            assert np.ptp(strip) < 0.02, f"page {number}"
        assert np.ptp(grey) > 0.5, f"page {number} is empty"


def test_a_simulated_run_is_marked_on_every_page_and_a_real_one_on_none(
    marked_pages: list[bytes], real_pages: list[bytes]
) -> None:
    pale_red = np.array((248.0, 232.0, 235.0)) / 255.0  # 9 % of the red of the mark on white
    for pages, marked in ((marked_pages, True), (real_pages, False)):
        for page in pages:
            away = np.abs(imread(io.BytesIO(page))[..., :3] - pale_red).max(axis=2)
            count = int((away < 3.0 / 255.0).sum())
            assert count > 1000 if marked else count < 100


def _heads(title: str) -> list[bytes]:
    """What stands above the rows of a table over pages, on pages behind its first; ink as bytes."""
    rows = [[number, 0] for number in range(400)]
    table = analysis.Table(title, "", ["n", "value"], rows)
    results = {"session": "s", "campaign": "c", "uut": {}, "estimates": [], "quality": {}, "provenance": {}}
    pages = Report(ReportModel(title="Long", results=results, tables=(table,))).pages(DPI)
    heads = [imread(io.BytesIO(page))[int(19.0 / MM_PER_INCH * DPI) : int(26.0 / MM_PER_INCH * DPI)] for page in pages]
    return [(head[..., :3].mean(axis=2) < 0.7).tobytes() for head in heads[3:6]]


def test_a_caption_is_repeated_with_the_headings_of_a_table_that_goes_on() -> None:
    continued, shorter = _heads("Readings of the long one"), _heads("Short")
    assert len(set(continued)) == len(set(shorter)) == 1  # the same on every page
    assert continued[0] != shorter[0]  # and it is the caption
    assert any(continued[0])


def test_every_text_has_its_glyphs(report: Report) -> None:
    words = words_of("en")
    assert missing("".join(words.all.values())) == set()
    files = document_files(sample_model(), report.sections, words)
    assert {name: missing(raw.decode()) for name, raw in files.items() if name != "main"} == {
        name: set() for name in files if name != "main"
    }


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


def test_widths_and_glyphs_are_those_of_another_reader_of_the_font() -> None:
    for bold, file in ((False, "DejaVuSans.ttf"), (True, "DejaVuSans-Bold.ttf")):
        with TTFont(folders()[0] / file) as font:
            charmap, advances, units = font.getBestCmap(), font["hmtx"], font["head"].unitsPerEm
        for text in ("Scale-factor error / ppm", "−12\u202f345.678 ± 0.012", "µΩ°C²∞√·…–—"):
            expected = 10.0 * sum(advances[charmap[ord(one)]][0] for one in text) / units
            assert width_pt(text, 10.0, bold) == pytest.approx(expected, rel=1e-6)
        assert ord("한") not in charmap


def test_a_character_without_a_glyph_is_written_as_its_code(no_korean_font: None) -> None:
    assert missing("−°µ±∞²³√·…–—\u202f\u2060\u200b\n") == set()
    assert missing("A한") == {"한"}
    assert legible("한 A") == "[U+D55C] A"


def test_a_narrow_table_keeps_its_size_and_its_words() -> None:
    table = Table("c", ("channel", "N / ppm"), (("1", "−240 ± 20"), ("2", "1 ± 20")))
    (one,) = sheets(table, ROOM_pt)
    assert one.size_pt == SIZES_pt[0]
    assert sum(one.widths_pt) < 0.5 * ROOM_pt
    assert one.table.rows[0][1] == "−240\u00a0±\u00a020"  # a value is never broken
    assert width_pt("−240 ± 20", one.size_pt) < one.widths_pt[1]


def test_words_are_broken_over_lines_before_the_type_gets_smaller() -> None:
    table = Table("c", ("item", "in words"), (("a", "word " * 80),), prose=True)
    (one,) = sheets(table, ROOM_pt)
    assert one.size_pt == SIZES_pt[0]
    assert sum(one.widths_pt) == pytest.approx(ROOM_pt)


def test_a_word_longer_than_the_page_can_be_broken() -> None:
    (one,) = sheets(Table("c", ("hash",), (("f" * 400,),)), ROOM_pt)
    assert sum(one.widths_pt) <= ROOM_pt
    assert one.table.rows[0][0].replace("\u200b", "") == "f" * 400


def test_a_table_too_wide_goes_in_parts_that_name_their_rows() -> None:
    headers = ("channel", *(f"quantity{column:02d} / nA" for column in range(30)))
    rows = tuple((str(row), *(f"{row}{column:02d}.5 ± 0.1" for column in range(30))) for row in range(3))
    parts = sheets(Table("c", headers, rows), ROOM_pt)
    assert len(parts) > 1
    assert all(sum(one.widths_pt) <= ROOM_pt and one.size_pt == SIZES_pt[-1] for one in parts)
    assert all(one.table.headers[0] == "channel" for one in parts)
    shown = [cell.replace("\u00a0", " ") for one in parts for cell in one.table.rows[2][1:]]
    assert shown == list(rows[2][1:])


def test_a_table_to_fill_in_takes_the_whole_width() -> None:
    table = Table("c", ("", "name", "signature"), (("prepared", "", ""),), to_fill=True)
    (one,) = sheets(table, ROOM_pt)
    assert sum(one.widths_pt) == pytest.approx(ROOM_pt)
    assert one.widths_pt[1] == one.widths_pt[2] > 100.0
