"""A report in a browser: no table is cut off on a screen of 1280 px, and a phone says that there is more."""

from __future__ import annotations

import pytest
from playwright.sync_api import Browser

from bench import analysis
from bench.report import Report, ReportModel

CUT = "[...document.querySelectorAll('.scroll')].filter(box => box.scrollWidth > box.clientWidth + 1).length"


@pytest.fixture(scope="module")
def report() -> str:
    headers = ["axis", *(f"coupling from {number}, 1e-3" for number in range(14))]
    rows = [[axis, *("−12.2207 ± 0.0058" for _ in headers[1:])] for axis in "xyz"]
    table = analysis.Table("Couplings", "Of each axis.", headers, rows, lead=True)
    results = {"session": "s", "campaign": "c", "uut": {}, "estimates": [], "quality": {}, "provenance": {}}
    return Report(ReportModel(title="Wide", results=results, tables=(table,))).html()


def test_a_wide_table_goes_in_parts_that_repeat_caption_and_axis(browser: Browser, report: str) -> None:
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.set_content(report)
    assert page.evaluate(CUT) == 0
    captions = page.locator("#results caption").all_inner_texts()
    assert captions == ["Couplings. Of each axis."] + ["Couplings. Of each axis. (continued)"] * (len(captions) - 1)
    assert len(captions) > 1
    first = page.locator("#results thead th:first-child").all_inner_texts()
    assert first == ["axis"] * len(captions)
    page.close()


def test_on_a_phone_the_page_stays_and_the_tables_scroll(browser: Browser, report: str) -> None:
    page = browser.new_page(viewport={"width": 390, "height": 844})
    page.set_content(report)
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    assert page.evaluate(CUT) > 0
    assert "gradient" in page.evaluate("getComputedStyle(document.querySelector('.scroll')).backgroundImage")
    page.close()


def test_on_paper_the_caption_is_part_of_the_headings_that_repeat(browser: Browser, report: str) -> None:
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.set_content(report)
    page.emulate_media(media="print")
    assert not page.locator("#results caption").first.is_visible()
    assert page.locator("#results thead .again").first.is_visible()
    page.close()


def test_on_a_phone_names_wrap_beside_their_values(browser: Browser, report: str) -> None:
    page = browser.new_page(viewport={"width": 390, "height": 844})
    page.set_content(report)
    pairs = page.evaluate("[...document.querySelectorAll('.pairs')].map(table => table.getBoundingClientRect().right)")
    assert pairs
    assert max(pairs) <= 390
    page.close()
