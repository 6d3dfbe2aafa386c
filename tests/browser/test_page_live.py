"""The live page in a real browser: what is shown, how it looks, and that it never claims what it does not know."""

from __future__ import annotations

import shutil
import signal
from pathlib import Path

import pytest
from browser_rig import PageServer, until, visiting
from playwright.sync_api import Browser, Page, expect
from shown_run import GYROS, ShownRun

pytestmark = pytest.mark.waits

FIRST_POINTS_S = 2.0
RESUMED_MS = 10_000
ATTEMPTS = 3  # another process of the machine may be in the way once
SMALL = {"width": 700, "height": 500}  # only what is seen is drawn, by the processors of this machine
SLOW_MS = 60_000  # a fit of the lowest priority on a machine that has something else to do

LOOKS = "() => [document.documentElement.dataset.theme, document.getElementById('time-form').value].join()"
SAMPLE = """() => {
  window.sameDocument = true;
  window.samples = [];
  setInterval(() => window.samples.push(
    [document.getElementById("badge-word").textContent, document.title, Date.now()]), 50);
}"""


def word(page: Page) -> str:
    return page.inner_text("#badge-word")


def test_three_viewers_see_the_run(browser: Browser, server: PageServer, shown: ShownRun) -> None:
    with visiting(browser, server, "viewer") as visitor:
        page = visitor.open_run(shown.name)
        with visiting(browser, server, "viewer", viewport=SMALL) as second:
            with visiting(browser, server, "operator", viewport=SMALL) as third:
                for one in (page, second.open_run(shown.name), third.open_run(shown.name)):
                    moves(one)
            moves(page)
        expect(page.locator("header.bar")).to_contain_text("SIMULATED")
        expect(page.locator("#watermark")).to_be_visible()
        expect(page.locator("#replay-band")).to_be_hidden()
        expect(page.locator("#wait")).to_contain_text("soak 55 \u00b0C")
        expect(page.locator("#step")).to_contain_text("7 of 18")
        expect(page.locator("#operator")).not_to_be_empty()
        for name in ("pause", "resume", "abort", "take"):  # a viewer has no commands
            expect(page.locator(f"#{name}")).to_be_hidden()
        keys_can_be_turned_off(page)


def moves(page: Page) -> None:
    """All curves are there, and their values go on."""
    expect(page.locator("#badge-word")).to_have_text("RUNNING")
    labels = page.locator("figure.graph").first.locator(".ends button")
    expect(labels).to_have_count(len(GYROS))
    before = labels.first.inner_text()
    until(page, lambda: labels.first.inner_text() != before, "another value")


def keys_can_be_turned_off(page: Page) -> None:
    before = page.evaluate(LOOKS)
    for key in ("d", "u"):
        page.keyboard.press(key)
        until(page, lambda: page.evaluate(LOOKS) != before, "another look")
        page.keyboard.press(key)
        until(page, lambda: page.evaluate(LOOKS) == before, "the look of before")
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
        expect(page.locator("#age")).to_contain_text("OLD")
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


def test_uncertainties_so_far_at_the_end_and_predicted(
    browser: Browser, server: PageServer, shown: ShownRun, golden: Path
) -> None:
    shutil.copy(golden / "session.0001.mcap", server.out / shown.name)
    with visiting(browser, server, "viewer") as visitor:
        page = visitor.page
        page.goto(f"{server.origin}/runs/{shown.name}")
        page.wait_for_selector("#estimates button.quantity", timeout=SLOW_MS)
        expect(page.locator("#estimates-foreseen")).to_be_visible()
        known = page.locator("#estimates thead th").all_inner_texts().index("U so far")
        row = page.locator("#estimates tbody tr").first.locator("td").all_inner_texts()
        assert all(float(row[place]) > 0.0 for place in (known, known + 1, known + 2))  # at the end, and predicted
        assert row[known + 1] == row[known], "all of its records are there"


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
