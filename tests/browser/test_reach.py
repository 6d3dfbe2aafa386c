"""Who has no mouse reaches everything, and sees where the focus is."""

from __future__ import annotations

import pytest
from browser_rig import PATIENCE_MS, PageServer, visiting
from playwright.sync_api import Browser, Page, expect
from shown_run import ShownRun

pytestmark = pytest.mark.waits

MOST_TABS = 150
POLL_ms = 100
SMALL = {"width": 1000, "height": 700}
# Controls that can be seen and used, each with a mark of its own.
CONTROLS = """() => {
  const all = [...document.querySelectorAll("a[href], button:enabled, select, input, summary, [tabindex='0']")];
  const seen = all.filter((one) => one.checkVisibility({ checkVisibilityCSS: true }));
  seen.forEach((one, number) => { one.dataset.control = number; });
  return seen.length;
}"""
STILL_THERE = "() => [...document.querySelectorAll('[data-control]')].map((one) => one.dataset.control)"
# The control that has the focus: its mark, its outline in px, and whether something lies upon it.
FOCUSED = """() => {
  const one = document.activeElement;
  const { outlineStyle, outlineWidth } = getComputedStyle(one);
  const { left, top, width, height } = one.getBoundingClientRect();
  const middle = left + Math.min(width, innerWidth - left) / 2;
  const above = document.elementFromPoint(middle, top + Math.min(height, 20) / 2);
  return { control: one.dataset.control ?? null, name: one.id || one.className || one.tagName,
    outline: outlineStyle === "none" ? 0 : parseFloat(outlineWidth), hidden: !one.contains(above) };
}"""


def walk(page: Page) -> list[dict[str, object]]:
    """Where Tab leads from the top of the page until it has been everywhere."""
    assert page.evaluate(CONTROLS) > 0
    met: dict[object, dict[str, object]] = {}
    for _ in range(MOST_TABS):
        page.keyboard.press("Tab")
        stop = page.evaluate(FOCUSED)
        for _ in range(PATIENCE_MS // POLL_ms):
            if not stop["hidden"]:
                break
            page.wait_for_timeout(POLL_ms)  # it is not scrolled to yet, or its row was drawn anew at this moment
            stop = page.evaluate(FOCUSED)
        if stop["control"] in met:
            break
        if stop["control"] is not None:
            met[stop["control"]] = stop
    missed = set(page.evaluate(STILL_THERE)) - set(met)  # what has come or gone meanwhile is none
    assert missed == set()
    return list(met.values())


def well_led(page: Page) -> None:
    """Tab leads to every control; whoever has the focus shows it, and nothing lies upon it."""
    stops = walk(page)
    assert stops[0]["name"] == "skip"
    assert [stop for stop in stops if stop["outline"] < 2 or stop["hidden"]] == []  # type: ignore[operator]


def test_tab_leads_everywhere_on_the_first_page(
    browser: Browser, server: PageServer, living: dict[str, ShownRun], over: dict[str, str]
) -> None:
    del living, over
    with visiting(browser, server, "viewer", viewport=SMALL) as visitor:
        page = visitor.page
        page.goto(f"{server.origin}/")
        page.wait_for_selector("#sessions tbody tr a")
        page.wait_for_selector(".run-card")
        well_led(page)


def test_tab_leads_everywhere_on_the_page_of_a_run_and_comes_back_from_a_dialog(
    browser: Browser, server: PageServer, living: dict[str, ShownRun]
) -> None:
    with visiting(browser, server, "operator", viewport=SMALL) as visitor:
        page = visitor.open_run(living["door"].name)
        page.wait_for_selector("#operator:not(:empty)")
        page.click("#take")
        page.wait_for_selector("#abort:enabled")
        page.reload()  # Tab begins at the top again; who has the command keeps it
        page.wait_for_selector("#graphs figure .ends button")
        page.wait_for_selector("#abort:enabled")
        well_led(page)
        page.focus("a.skip")
        page.keyboard.press("Enter")
        expect(page.locator("#main")).to_be_focused()
        page.focus("#abort")
        page.keyboard.press("Enter")
        page.wait_for_selector("#reason[open]")
        for _ in range(8):
            page.keyboard.press("Tab")
            assert page.evaluate("() => document.activeElement.matches('#reason *, body')"), (
                "Tab leads out of the dialog"
            )
        page.keyboard.press("Escape")
        expect(page.locator("#abort")).to_be_focused()
