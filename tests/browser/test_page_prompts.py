"""Where a question is answered: on the phone what needs no hands, on a page of the bench what does."""

from __future__ import annotations

from typing import Any

import pytest
from browser_rig import PageServer, until, visiting
from playwright.sync_api import Browser, Page, expect
from shown_run import ShownRun, now_utc_s

pytestmark = pytest.mark.waits

PHONE = {"width": 390, "height": 844}
DESK = {"width": 1280, "height": 800}
ARM = "Waits to be armed at the bench; energised or moved again: switch, calibrator"


def question(number: int, text: str, **more: Any) -> dict[str, Any]:
    asked = {"text": text, "confirm": "operator", "unit": "", "low": None, "high": None, "arms": False}
    return {"id": f"q{number}", **asked, "presence": "bench", "since_utc_s": now_utc_s(), **more}


def ask(page: Page, shown: ShownRun, asked: dict[str, Any]) -> None:
    shown.state |= {"prompt": asked, "state": "waiting"}
    page.wait_for_selector("#prompt[open]")
    expect(page.locator("#prompt-text")).to_have_text(asked["text"])


def inside(page: Page, selector: str) -> bool:
    """Whether an element stands inside the window, where a thumb reaches it."""
    box, size = page.locator(selector).bounding_box(), page.viewport_size
    if box is None or size is None:
        return False
    right, bottom = box["x"] + box["width"], box["y"] + box["height"]
    return box["x"] >= 0 and right <= size["width"] and box["y"] >= 0 and bottom <= size["height"]


def test_on_the_phone_hands_are_for_the_bench_and_all_else_is_taken_and_answered(
    browser: Browser, server: PageServer, shown: ShownRun
) -> None:
    with visiting(browser, server, "operator", viewport=PHONE, has_touch=True) as visitor:
        page = visitor.open_run(shown.name)
        ask(page, shown, question(1, "Is the cover of the relays closed?"))
        expect(page.locator("#prompt-cannot")).to_be_visible()
        for part in ("go", "take", "field"):
            expect(page.locator(f"#prompt-{part}")).to_be_hidden()
        page.tap("#prompt-close")
        ask(page, shown, question(2, "May the run go on over night?", presence="anywhere"))
        expect(page.locator("#prompt-go")).to_be_hidden()
        until(page, lambda: inside(page, "#prompt-take"), "a button under the thumb")
        page.tap("#prompt-take")
        page.wait_for_selector("#prompt-go:enabled")
        for part in ("cannot", "take"):
            expect(page.locator(f"#prompt-{part}")).to_be_hidden()
        until(page, lambda: inside(page, "#prompt-go"), "a button under the thumb")
        page.tap("#prompt-go")
        until(page, lambda: bool(shown.asked), "the answer")
        (answer,) = shown.asked
        assert (answer["command"], answer["prompt"], answer["value"], answer["place"]) == ("answer", "q2", True, "afar")


def test_a_page_of_the_bench_arms_it(browser: Browser, server: PageServer, shown: ShownRun) -> None:
    with visiting(browser, server, "bench", viewport=DESK) as visitor:
        page = visitor.open_run(shown.name)
        ask(page, shown, question(1, ARM, arms=True))
        page.click("#prompt-take")
        page.wait_for_selector("#prompt-go:enabled")
        expect(page.locator("#prompt-go")).to_have_text("Arm")
        page.click("#prompt-go")
        until(page, lambda: bool(shown.asked), "the answer")
        (answer,) = shown.asked
        assert (answer["command"], answer["place"]) == ("answer", "bench")
        assert answer["by"].startswith("kim, bench, 127.0.0.1")
