"""The report in Korean: its page and its paper, with the letters inside, and what happens without a font for them."""

from __future__ import annotations

import re
import zlib

import pytest
from fontTools.ttLib import TTFont
from report_sample import sample_model

from bench.analysis import Figure, Table, series
from bench.model.errors import InputError
from bench.report import Report
from bench.report.document import document_files
from bench.report.fonts import families, folders
from bench.report.model import ReportModel
from bench.report.sheet import legible, missing, width_pt
from bench.report.tables import words_of

KOREAN = words_of("ko")
STREAM = re.compile(rb"stream\r?\n(.*?)\r?\nendstream", re.DOTALL)
HANGUL = re.compile("[가-힣]")


@pytest.fixture(scope="module")
def report() -> Report:
    return Report(sample_model(), "ko")


def letters(pdf: bytes) -> set[str]:
    """Return the characters that the tables of a PDF name, by which a reader copies and searches its text."""
    found = set()
    for stream in STREAM.finditer(pdf):
        try:
            inside = zlib.decompress(stream[1]).decode("latin-1")
        except zlib.error:
            continue
        for part in re.findall(r"beginbfchar(.*?)endbfchar", inside, re.DOTALL):
            for code in re.findall(r"<[0-9A-Fa-f]+>\s*<([0-9A-Fa-f]+)>", part):
                found |= set(bytes.fromhex(code).decode("utf-16-be"))
    return found


def test_the_page_is_korean_and_says_so(report: Report) -> None:
    page = report.html()
    assert '<html lang="ko">' in page
    titles = re.findall(r"<h2>([^<]*)</h2>", page)
    assert len(titles) > 8
    assert [title for title in titles if not HANGUL.search(title)] == []
    assert KOREAN("dsf.caption") in page
    assert "확장불확도" in page


def test_paper_has_the_letters_and_the_font(report: Report) -> None:
    pdf = report.pdf()
    assert b"NanumGothic" in pdf
    wanted = set("".join(section.title for section in report.sections))
    assert wanted & set(map(chr, range(0xAC00, 0xD7A4))) <= letters(pdf)


def test_every_korean_text_has_its_glyphs(report: Report) -> None:
    assert missing("".join(KOREAN.all.values())) == set()
    files = document_files(sample_model(), report.sections, KOREAN)
    assert {name for name, raw in files.items() if name != "main" and missing(raw.decode())} == set()


def test_a_letter_is_as_wide_as_another_reader_of_the_font_finds_it() -> None:
    for bold, file in ((False, "NanumGothic.ttf"), (True, "NanumGothicBold.ttf")):
        with TTFont(folders()[1] / file) as font:
            advance, units = font["hmtx"][font.getBestCmap()[ord("한")]][0], font["head"].unitsPerEm
        assert width_pt("한", 10.0, bold) == pytest.approx(10.0 * advance / units, rel=1e-6)
    assert families() == ["DejaVu Sans", "NanumGothic"]


def test_a_character_that_neither_font_has_is_written_as_its_code() -> None:
    assert legible("한 \U00020000") == "한 [U+20000]"


def test_numbers_and_dates_are_the_same_in_both_languages(report: Report) -> None:
    """Behind the first page, which shows as much as it has room for."""
    behind = [page.partition('id="summary"')[2] for page in (Report(sample_model()).html(), report.html())]
    numbers = [set(re.findall(r"<td[^>]*>([−0-9.\u202f± ]+)</td>", page)) for page in behind]
    assert len(numbers[0]) > 50
    assert numbers[0] == numbers[1]  # how often one stands there depends on the parts of a wide table


def test_without_the_font_paper_is_refused_and_the_page_is_written(no_korean_font: None) -> None:
    model = ReportModel(
        title="T", results={"session": "s", "estimates": []},
        figures=(Figure("한글", "", "x", "y", [series("한", [0.0, 1.0], [0.0, 1.0])]),),
        tables=(Table("표", "", ["가"], [["나"]]),),
    )  # fmt: skip
    report = Report(model, "ko")
    assert "한글" in report.html()
    with pytest.raises(InputError, match=r"font that is not installed") as caught:
        report.pdf()
    assert caught.value.code == "B-TXT-002"
    assert "inertial-bench[ko]" in caught.value.next_step
