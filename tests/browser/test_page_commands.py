"""What an operator does on the page, and what a viewer cannot."""

from __future__ import annotations

from browser_rig import PageServer, Visitor, until, visiting
from playwright.sync_api import Browser, Page
from shown_run import ShownRun, now_utc_s


def taken(visitor: Visitor, run: str) -> Page:
    """The page of an operator who has taken the command."""
    page = visitor.open_run(run)
    page.click("#take")
    page.wait_for_selector("#abort:enabled")
    return page


def commands(shown: ShownRun) -> list[str]:
    return [request["command"] for request in shown.asked]


def test_abort_needs_two_steps_and_a_reason(browser: Browser, server: PageServer, shown: ShownRun) -> None:
    with visiting(browser, server, "operator") as visitor:
        page = taken(visitor, shown.name)
        page.click("#abort")
        assert "not an emergency stop" in page.inner_text("#reason-text")
        page.evaluate("() => document.getElementById('reason-form').requestSubmit()")  # without a reason
        page.keyboard.press("Escape")
        page.click("#abort")
        page.fill("#reason-value", "smoke")
        page.keyboard.press("Enter")
        assert "step 2 of 2" in page.inner_text("#reason-title")
        page.keyboard.press("Enter")  # once too often: the focus is on Cancel
        assert page.is_hidden("#reason")
        assert commands(shown) == []
        page.click("#abort")
        page.fill("#reason-value", "smoke")
        page.keyboard.press("Enter")
        page.click("#reason-go")
        until(page, lambda: commands(shown) == ["abort"], "abort")
        assert shown.asked[0]["reason"] == "smoke"
        assert shown.asked[0]["by"].startswith("kim, operator, 127.0.0.1")
        until(page, lambda: page.inner_text("#command-reply") == "abort heard", "the answer of the run")


def test_an_alarm_is_announced_once_and_acknowledged(browser: Browser, server: PageServer, shown: ShownRun) -> None:
    with visiting(browser, server, "operator") as visitor:
        page = taken(visitor, shown.name)
        shown.state["alarms"] = [{"id": "a1", "severity": "warning", "code": None, "t_utc_s": now_utc_s(),
                                  "active": True, "acknowledged": None, "text": "GPIB 14 timeout"}]  # fmt: skip
        page.wait_for_selector("#alarms li")
        assert page.inner_text("#announce").strip() == "WARNING: GPIB 14 timeout"
        page.evaluate("() => { document.getElementById('announce').textContent = ''; }")
        shown.state["progress"] = 0.39
        until(page, lambda: page.inner_text("#percent") == "39.0 %", "another delta")
        assert page.inner_text("#announce") == ""
        page.click("#alarms button")
        until(page, lambda: "acknowledged by kim" in page.inner_text("#alarms"), "who has seen it")
        assert shown.asked[-1]["alarm"] == "a1"


def test_closing_a_prompt_answers_nothing(browser: Browser, server: PageServer, shown: ShownRun) -> None:
    with visiting(browser, server, "operator") as visitor:
        page = taken(visitor, shown.name)
        shown.state["prompt"] = {"id": "p1", "text": "Resistance between LO and ground", "confirm": False,
                                 "unit": "ohm", "low": 1e6, "high": None, "since_utc_s": now_utc_s()}  # fmt: skip
        page.wait_for_selector("#prompt[open]")
        page.click("#theme")  # the page behind can still be used
        page.click("#prompt-close")
        assert page.is_hidden("#prompt")
        page.wait_for_timeout(1500)
        assert page.is_hidden("#prompt"), "it came back by itself"
        assert commands(shown) == []
        page.click("#show-prompt")
        page.fill("#prompt-value", "5")
        page.keyboard.press("Enter")
        assert "at least 1000000 ohm" in page.inner_text("#prompt-trouble")
        page.fill("#prompt-value", "2e6")
        page.keyboard.press("Enter")
        until(page, lambda: commands(shown) == ["answer"], "the answer")
        assert shown.asked[0]["value"] == 2e6
        until(page, lambda: page.is_hidden("#show-prompt"), "the question to be gone")


def test_a_viewer_has_no_command(browser: Browser, server: PageServer, shown: ShownRun) -> None:
    with visiting(browser, server, "viewer") as visitor:
        page = visitor.open_run(shown.name)
        page.wait_for_selector("#commands", state="visible")
        page.wait_for_selector("#operator:not(:empty)")
        assert all(page.is_hidden(f"#{name}") for name in ("pause", "resume", "abort", "take"))
