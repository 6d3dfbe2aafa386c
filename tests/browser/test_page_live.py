"""The live page in a real browser: what is shown, how it looks, and that it never claims what it does not know."""

from __future__ import annotations

import signal
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser_rig import PageServer, until, visiting
from matplotlib.image import imread
from playwright.sync_api import Browser, Page
from shown_run import GYROS, ShownRun, now_utc_s

pytestmark = pytest.mark.waits

FIRST_POINTS_S = 2.0
RESUMED_MS = 10_000
ATTEMPTS = 3  # another process of the machine may be in the way once
PHONE = {"width": 390, "height": 844}
SMALL = {
    "width": 700,
    "height": 500,
}  # only what is seen is drawn ten times a second, by the processors of this machine
LEAST_CONTRAST = 3.0  # WCAG 2.2, success criterion 1.4.11

TARGETS = """() => [...document.querySelectorAll("button, select, input")]
  .filter((one) => one.offsetParent && one.type !== "checkbox").map((one) => {
    const { width, height } = one.getBoundingClientRect();
    return [one.id || one.textContent, width, height];
  })"""
TOPS = "() => ['badge', 'abort', 'graphs'].map((id) => document.getElementById(id).getBoundingClientRect().top)"
LOOKS = "() => [document.documentElement.dataset.theme, document.getElementById('time-form').value].join()"
SAMPLE = """() => {
  window.sameDocument = true;
  window.samples = [];
  setInterval(() => window.samples.push(
    [document.getElementById("badge-word").textContent, document.title, Date.now()]), 50);
}"""


def word(page: Page) -> str:
    return page.inner_text("#badge-word")


def luminance(colour: Any) -> float:
    """Relative luminance of red, green, blue in 0 to 1. Source: WCAG 2.2."""
    linear = [share / 12.92 if share <= 0.04045 else ((share + 0.055) / 1.055) ** 2.4 for share in colour]
    return float(np.dot((0.2126, 0.7152, 0.0722), linear))


def drawn_contrasts(page: Page) -> dict[str, float]:
    """Contrast of each hue of the first graph with its card, both as they are in a picture of the page."""
    graph = page.locator("figure.graph").first
    strokes = graph.locator(".ends line").evaluate_all("(lines) => lines.map((one) => one.getAttribute('stroke'))")
    page.wait_for_timeout(500)  # drawn in the colours of this theme
    picture = imread(BytesIO(graph.locator(".plot").screenshot()))[..., :3].reshape(-1, 3)
    pixels, counts = np.unique(np.round(picture * 255).astype(int), axis=0, return_counts=True)
    ground = luminance(pixels[np.argmax(counts)] / 255)
    found = {}
    for stroke in set(strokes):
        wanted = [int(stroke[place : place + 2], 16) for place in (1, 3, 5)]
        near = counts[np.abs(pixels - wanted).max(axis=1) <= 3].sum()
        assert near >= 10, f"{stroke} is not in the picture"
        bright, dark = sorted((luminance(np.array(wanted) / 255), ground), reverse=True)
        found[stroke] = (bright + 0.05) / (dark + 0.05)
    return found


def test_three_viewers_see_the_run(browser: Browser, server: PageServer, shown: ShownRun) -> None:
    with visiting(browser, server, "viewer") as visitor:
        page = visitor.open_run(shown.name)
        with visiting(browser, server, "viewer", viewport=SMALL) as second:
            with visiting(browser, server, "operator", viewport=SMALL) as third:
                for one in (page, second.open_run(shown.name), third.open_run(shown.name)):
                    moves(one)
            moves(page)
        assert "SIMULATED" in page.inner_text("header.bar")
        assert page.is_visible("#watermark")
        assert page.is_hidden("#replay-band")
        assert page.inner_text("#wait").startswith("Waiting: soak 55 \u00b0C")
        assert "Step 7 of 18" in page.inner_text("#step")
        assert "between" in page.inner_text("#eta")
        page.wait_for_selector("#operator:not(:empty)")
        assert all(page.is_hidden(f"#{name}") for name in ("pause", "resume", "abort", "take")), "a viewer has commands"
        dark = drawn_contrasts(page)
        page.keyboard.press("d")
        contrasts = {**dark, **drawn_contrasts(page)}
        print("contrasts", {hue: round(ratio, 2) for hue, ratio in contrasts.items()})
        assert len(contrasts) == 10
        assert min(contrasts.values()) >= LEAST_CONTRAST
        page.keyboard.press("d")
        keys_can_be_turned_off(page)


def moves(page: Page) -> None:
    """All curves are there, and their values go on."""
    assert word(page) == "RUNNING"
    labels = page.locator("figure.graph").first.locator(".ends button")
    assert labels.count() == len(GYROS)
    before = labels.first.inner_text()
    until(page, lambda: labels.first.inner_text() != before, "another value")


def keys_can_be_turned_off(page: Page) -> None:
    before = page.evaluate(LOOKS)
    for key in ("d", "u"):
        page.keyboard.press(key)
        assert page.evaluate(LOOKS) != before
        page.keyboard.press(key)
        assert page.evaluate(LOOKS) == before
    page.uncheck("#shortcuts")
    page.locator("#main").focus()
    page.keyboard.press("d")
    page.keyboard.press("u")
    assert page.evaluate(LOOKS) == before


def resume_after_kill(page: Page, server: PageServer) -> float:
    """Kill the server, start it again; the time from then to RUNNING, ms, by the clock of the page."""
    page.evaluate(SAMPLE)
    server.end(signal.SIGKILL)
    try:
        until(page, lambda: word(page) == "NOT CONNECTED", "NOT CONNECTED")
        assert page.inner_text("#age").startswith("OLD")
        page.evaluate("() => { window.dead = window.samples.length; }")
        page.wait_for_timeout(1500)
        gone = page.evaluate("() => window.samples.slice(window.dead)")
    finally:
        server.start()
    assert len(gone) >= 10
    assert {badge for badge, _, _ in gone} == {"NOT CONNECTED"}
    assert all("RUNNING" not in title for _, title, _ in gone)
    started_ms = page.evaluate("() => Date.now()")
    until(page, lambda: page.evaluate("() => window.samples.at(-1)[0]") == "RUNNING", "RUNNING again")
    assert page.evaluate("() => window.sameDocument"), "the page was loaded again"
    words = page.evaluate("() => window.samples.map((one) => one[0])")
    first = words.index("NOT CONNECTED")
    assert set(words[:first]) <= {"RUNNING"}
    back = words.index("RUNNING", first)
    assert set(words[first:back]) == {"NOT CONNECTED"}, "it claimed something while nobody answered"
    return float(page.evaluate("(index) => window.samples[index][2]", back) - started_ms)


def test_what_does_not_answer_is_never_shown_as_running(browser: Browser, server: PageServer, shown: ShownRun) -> None:
    with visiting(browser, server, "viewer", may_fail=True, viewport=SMALL) as visitor:
        page = visitor.open_run(shown.name)
        print(f"resumed {resume_after_kill(page, server):.0f} ms after the server was there")
        assert all("CSP" not in text and "Content Security" not in text for text in visitor.wrong)
        shown.close()  # the run itself is gone now
        until(page, lambda: "RUNNING" not in word(page), "not RUNNING")
        assert page.evaluate("() => document.body.dataset.fresh") == "old"
        page.wait_for_timeout(1000)
        assert "RUNNING" not in word(page) + page.title()


def test_a_phone_has_it_all_and_pictures_are_kept(
    browser: Browser, server: PageServer, shown: ShownRun, screenshots: Path
) -> None:
    shown.state["alarms"] = [{"id": "a1", "severity": "alarm", "code": "B-RUN-031", "t_utc_s": now_utc_s() - 60,
                              "active": True, "acknowledged": None,
                              "text": "chamber: 55.0 degC not reached in 5400 s (last 54.8 degC)"}]  # fmt: skip
    with visiting(browser, server, "operator", viewport=PHONE, has_touch=True, color_scheme="light") as visitor:
        page = visitor.open_run(shown.name)
        page.wait_for_selector("#alarms li")
        until(page, lambda: page.locator("#abort").is_visible(), "the commands")
        assert page.evaluate("() => document.documentElement.scrollWidth") <= 390
        assert [one for one in page.evaluate(TARGETS) if one[1] < 44 or one[2] < 44] == []
        places = page.evaluate(TOPS)
        assert places == sorted(places)
        assert places[1] < 844, "Abort is below the fold"
        for width in (390, 1600):
            page.set_viewport_size({"width": width, "height": 900})
            for theme in ("light", "dark"):
                if page.evaluate("() => document.documentElement.dataset.theme") != theme:
                    page.click("#theme")
                page.wait_for_timeout(700)
                page.screenshot(path=screenshots / f"run-{theme}-{width}.png", full_page=True)
            page.click("#theme")
        page.goto(f"{server.origin}/")
        page.wait_for_selector("#sessions tbody tr")
        page.screenshot(path=screenshots / "start-1600.png", full_page=True)
        page.set_viewport_size(PHONE)
        assert page.evaluate("() => document.documentElement.scrollWidth") <= 390
        page.screenshot(path=screenshots / "start-390.png", full_page=True)


@pytest.mark.sweep
def test_points_are_drawn_within_two_seconds(browser: Browser, server: PageServer, shown: ShownRun) -> None:
    took_s = []
    with visiting(browser, server, "viewer") as visitor:
        for _ in range(ATTEMPTS):
            visitor.open_run(shown.name)
            visitor.page.wait_for_selector("html[data-first-points]", state="attached")
            took_s.append(float(visitor.page.get_attribute("html", "data-first-points") or "inf") / 1000)
    print("first points drawn after", took_s, "s")
    assert min(took_s) < FIRST_POINTS_S, took_s


@pytest.mark.sweep
def test_it_resumes_within_ten_seconds(browser: Browser, server: PageServer, shown: ShownRun) -> None:
    took_ms = []
    with visiting(browser, server, "viewer", may_fail=True) as visitor:
        took_ms.extend(resume_after_kill(visitor.open_run(shown.name), server) for _ in range(ATTEMPTS))
    print("resumed after", took_ms, "ms")
    assert max(took_ms) < RESUMED_MS
