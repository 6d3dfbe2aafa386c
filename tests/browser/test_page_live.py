"""The live page in a real browser: what is shown, how it looks, and that it never claims what it does not know."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
from browser_rig import PageServer, until, visiting
from playwright.sync_api import Browser, Page
from shown_run import GYROS, ShownRun, now_utc_s

FIRST_POINTS_S = 2.0
PHONE = {"width": 390, "height": 844}
ATTEMPTS = 3  # another process of the machine may be in the way once

TARGETS = """() => [...document.querySelectorAll("button, select, input")]
  .filter((one) => one.offsetParent && one.type !== "checkbox").map((one) => {
    const { width, height } = one.getBoundingClientRect();
    return [one.id || one.textContent, width, height];
  })"""
TOPS = "() => ['badge', 'abort', 'graphs'].map((id) => document.getElementById(id).getBoundingClientRect().top)"
FOCUS = "() => [document.activeElement].map((one) => one.id || one.className || one.tagName)[0]"


def word(page: Page) -> str:
    return page.inner_text("#badge-word")


@pytest.mark.sweep
def test_points_are_drawn_within_two_seconds(browser: Browser, server: PageServer, shown: ShownRun) -> None:
    took_s = []
    with visiting(browser, server, "viewer") as visitor:
        for _ in range(ATTEMPTS):
            visitor.open_run(shown.name)
            visitor.page.wait_for_selector("html[data-first-points]", state="attached")
            took_s.append(float(visitor.page.get_attribute("html", "data-first-points") or "inf") / 1000)
            if took_s[-1] < FIRST_POINTS_S:
                break
    assert min(took_s) < FIRST_POINTS_S, took_s


def test_live_values_move_and_gaps_stay_open(browser: Browser, server: PageServer, shown: ShownRun) -> None:
    with visiting(browser, server, "viewer") as visitor:
        page = visitor.open_run(shown.name)
        assert word(page) == "RUNNING"
        assert "SIMULATED" in page.inner_text("header.bar")
        assert page.is_visible("#watermark")
        labels = page.locator("figure.graph").first.locator(".ends button")
        assert labels.count() == len(GYROS)
        before = labels.first.inner_text()
        until(page, lambda: labels.first.inner_text() != before, "another value")
        assert page.inner_text("#wait").startswith("Waiting: soak 55 degC")
        assert "Step 7 of 18" in page.inner_text("#step")
        assert "between" in page.inner_text("#eta")


def test_a_killed_server_is_never_shown_as_running(browser: Browser, server: PageServer, shown: ShownRun) -> None:
    with visiting(browser, server, "viewer", may_fail=True) as visitor:
        page = visitor.open_run(shown.name)
        page.evaluate("() => { window.sameDocument = true; }")
        server.end(signal.SIGKILL)
        try:
            until(page, lambda: word(page) == "NOT CONNECTED", "NOT CONNECTED")
            for _ in range(20):
                assert word(page) == "NOT CONNECTED"
                assert "RUNNING" not in page.title()
                page.wait_for_timeout(100)
            assert page.inner_text("#age").startswith("OLD")
        finally:
            server.start()
        until(page, lambda: word(page) == "RUNNING", "RUNNING again")
        assert page.evaluate("() => window.sameDocument"), "the page was loaded again"
        assert all("CSP" not in text and "Content Security" not in text for text in visitor.wrong)


def test_a_run_that_does_not_answer_is_old(browser: Browser, server: PageServer, shown: ShownRun) -> None:
    with visiting(browser, server, "viewer") as visitor:
        page = visitor.open_run(shown.name)
        shown.close()
        until(
            page, lambda: page.get_attribute("body", "data-fresh") != "fresh" or word(page) != "RUNNING", "not RUNNING"
        )
        assert "RUNNING" not in word(page)


def test_pictures(browser: Browser, server: PageServer, shown: ShownRun, screenshots: Path) -> None:
    alarm = {"id": "a1", "severity": "alarm", "code": "B-RUN-031", "t_utc_s": now_utc_s() - 60, "active": True,
             "acknowledged": None,
             "text": "chamber: 55.0 degC not reached in 5400 s (last 54.8 degC)"}  # fmt: skip
    shown.state["alarms"] = [alarm]
    for scheme, width in (("dark", 1600), ("light", 1600), ("dark", 390), ("light", 390)):
        with visiting(
            browser, server, "operator", viewport={"width": width, "height": 900}, color_scheme=scheme
        ) as visitor:  # type: ignore[arg-type]
            page = visitor.open_run(shown.name)
            page.wait_for_selector("#alarms li")
            page.wait_for_timeout(1500)
            page.screenshot(path=screenshots / f"run-{scheme}-{width}.png", full_page=True)
            assert page.evaluate("() => document.documentElement.dataset.theme") == scheme
            page.goto(f"{server.origin}/")
            page.wait_for_selector("#sessions tbody tr")
            page.screenshot(path=screenshots / f"start-{scheme}-{width}.png", full_page=True)


def test_a_phone_needs_no_sideways_scrolling_and_has_large_buttons(
    browser: Browser, server: PageServer, shown: ShownRun
) -> None:
    with visiting(browser, server, "operator", viewport=PHONE, has_touch=True) as visitor:
        page = visitor.open_run(shown.name)
        until(page, lambda: page.locator("#abort").is_visible(), "the commands")
        assert page.evaluate("() => document.documentElement.scrollWidth") <= 390
        sizes = page.evaluate(TARGETS)
        assert [one for one in sizes if one[1] < 44 or one[2] < 44] == []
        places = page.evaluate(TOPS)
        assert places == sorted(places)
        assert places[1] < 844, "Abort is below the fold"


@pytest.mark.parametrize("key", ["d", "u"])
def test_keys_can_be_turned_off(browser: Browser, server: PageServer, shown: ShownRun, key: str) -> None:
    look = "() => [document.documentElement.dataset.theme, document.getElementById('time-form').value].join()"
    with visiting(browser, server, "viewer") as visitor:
        page = visitor.open_run(shown.name)
        before = page.evaluate(look)
        page.keyboard.press(key)
        assert page.evaluate(look) != before
        page.keyboard.press(key)
        assert page.evaluate(look) == before
        page.uncheck("#shortcuts")
        page.locator("#main").focus()
        page.keyboard.press(key)
        assert page.evaluate(look) == before


def test_everything_is_reached_by_keyboard(browser: Browser, server: PageServer, shown: ShownRun) -> None:
    with visiting(browser, server, "operator") as visitor:
        page = visitor.open_run(shown.name)
        page.keyboard.press("Tab")
        assert page.evaluate("() => document.activeElement.className") == "skip"
        reached = set()
        for _ in range(150):
            page.keyboard.press("Tab")
            reached.add(page.evaluate(FOCUS))
        assert {"time-form", "theme", "shortcuts", "take", "plot", "log-filter", "logout"} <= reached
