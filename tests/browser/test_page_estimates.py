"""Results of a run that goes on, as the page shows them: what they are known to, and what they are expected to be."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from browser_rig import PageServer, until, visiting
from playwright.sync_api import Browser
from shown_run import ShownRun

pytestmark = pytest.mark.waits

SLOW_MS = 60_000  # a fit of the lowest priority on a machine that has something else to do


@pytest.mark.parametrize("locale", ["en-GB", "ko-KR"])
def test_uncertainties_so_far_at_the_end_and_predicted(
    browser: Browser, server: PageServer, shown: ShownRun, golden: Path, screenshots: Path, locale: str
) -> None:
    shutil.copy(golden / "session.0001.mcap", server.out / shown.name)
    with visiting(browser, server, "viewer", locale=locale) as visitor:
        page = visitor.page
        page.goto(f"{server.origin}/runs/{shown.name}")
        page.wait_for_selector("#estimates button.quantity", timeout=SLOW_MS)
        until(page, lambda: page.is_visible("#estimates-foreseen"), "what the uncertainties are")
        heads = page.locator("#estimates thead th").all_inner_texts()
        named = page.locator("#estimates button.quantity").first.inner_text()
        assert named == ("Scale-factor error N" if locale == "en-GB" else "환산계수 오차 N")
        known = heads.index("U so far" if locale == "en-GB" else "현재 U")
        at_end, predicted = known + 1, known + 2
        row = page.locator("#estimates tbody tr").first.locator("td").all_inner_texts()
        assert all(float(row[place]) > 0.0 for place in (known, at_end, predicted))
        assert row[at_end] == row[known], "all of its records are there"
        page.locator("#estimates-card").screenshot(path=screenshots / f"estimates_{locale}.png")
