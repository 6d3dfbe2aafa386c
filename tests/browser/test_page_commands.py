"""What an operator does on the page, with the keyboard alone from the login on, and where a question is answered."""

from typing import Any

import pytest
from browser_rig import PageServer, until, visiting
from playwright.sync_api import Browser, Page, expect
from shown_run import ShownRun, now_utc_s

pytestmark = pytest.mark.waits

FOCUS = "() => [document.activeElement].map((one) => one.id || one.className || one.tagName)[0]"
MOST_TABS = 200
SMALL = {"width": 800, "height": 600}  # only what is seen is drawn ten times a second
ALARM = {"id": "a1", "severity": "warning", "code": None, "active": True, "acknowledged": None,
         "text": "GPIB 14 timeout"}  # fmt: skip


def commands(shown: ShownRun) -> list[str]:
    return [request["command"] for request in shown.asked]


def tab_to(page: Page, selector: str) -> None:
    """Walk with Tab until something that fits has the focus."""
    for _ in range(MOST_TABS):
        if page.evaluate("(selector) => document.activeElement.matches(selector)", selector):
            return
        page.keyboard.press("Tab")
    raise AssertionError(f"Tab does not lead to {selector}; it stands at {page.evaluate(FOCUS)}")


def press(page: Page, selector: str) -> None:
    tab_to(page, selector)
    page.keyboard.press("Enter")


def test_everything_is_done_by_keyboard(browser: Browser, server: PageServer, shown: ShownRun) -> None:
    with visiting(browser, server, None, may_fail=True, viewport=SMALL) as visitor:  # 401 at first
        page = visitor.page
        page.goto(f"{server.origin}/")
        page.wait_for_selector("input:focus")  # the first field has it, without a click
        page.keyboard.type("kim")
        page.keyboard.press("Tab")
        page.keyboard.type(server.tokens["operator"])
        page.keyboard.press("Enter")
        page.wait_for_selector("#living a")
        press(page, f"a[href='/runs/{shown.name}']")
        page.wait_for_selector("#graphs figure .ends button")
        del visitor.wrong[:]
        page.keyboard.press("Tab")
        expect(page.locator("a.skip")).to_be_focused()
        press(page, "#take")
        page.wait_for_selector("#pause:enabled")
        pause_and_resume(page, shown)
        acknowledge(page, shown)
        answer(page, shown)
        zoom(page)
        press(page, "figure.graph details.numbers summary")
        page.wait_for_selector("figure.graph details[open] tbody tr")
        press(page, "#log-filter")
        press(page, "#abort")
        page.keyboard.type("smoke")
        page.keyboard.press("Enter")
        press(page, "#reason-go")
        until(page, lambda: commands(shown)[-1] == "abort", "abort")
        assert shown.asked[-1]["reason"] == "smoke"
        assert visitor.wrong == []


def pause_and_resume(page: Page, shown: ShownRun) -> None:
    press(page, "#pause")
    page.keyboard.type("a look at the relay")
    page.keyboard.press("Enter")
    until(page, lambda: commands(shown) == ["pause"], "pause")
    assert shown.asked[0]["reason"] == "a look at the relay"
    shown.state["state"] = "holding"
    page.wait_for_selector("#resume:enabled")
    press(page, "#resume")
    until(page, lambda: commands(shown) == ["pause", "resume"], "resume")
    shown.state["state"] = "running"


def acknowledge(page: Page, shown: ShownRun) -> None:
    shown.state["alarms"] = [{**ALARM, "t_utc_s": now_utc_s()}]
    page.wait_for_selector("#alarms li")
    press(page, "#alarms button")
    expect(page.locator("#alarms")).to_contain_text("acknowledged by kim")
    assert shown.asked[-1]["alarm"] == "a1"


def answer(page: Page, shown: ShownRun) -> None:
    shown.state["prompt"] = {"id": "p1", "text": "Resistance between LO and ground", "confirm": "operator",
                             "unit": "ohm", "low": 1e6, "high": None, "since_utc_s": now_utc_s()}  # fmt: skip
    page.wait_for_selector("#prompt[open]")
    tab_to(page, "#prompt-value")
    page.keyboard.type("2e6")
    page.keyboard.press("Enter")
    until(page, lambda: commands(shown)[-1] == "answer", "the answer")
    assert shown.asked[-1]["value"] == 2e6
    for number, (unit, typed, value) in enumerate((("ohm", "2 Mohm", "2 Mohm"), ("1", "45", "45 %"), ("", "", True))):
        expect(page.locator("#prompt")).to_be_hidden()
        shown.state["prompt"] = {"id": f"q{number}", "text": "And now?", "confirm": "operator",
                                 "unit": unit, "low": None, "high": None, "since_utc_s": now_utc_s()}  # fmt: skip
        page.wait_for_selector("#prompt[open]")
        expect(page.locator("#prompt-value")).to_be_visible(visible=bool(unit))  # without a unit nothing is typed
        if typed:
            page.fill("#prompt-value", typed)
        press(page, "#prompt-form .main")
        until(page, lambda wanted=value: shown.asked[-1].get("value") == wanted, "the answer")


def zoom(page: Page) -> None:
    """+ and - zoom the history, 0 shows the whole run, arrows move the cursor."""
    at = page.locator("figure.graph").last.locator("p.bucket")
    until(page, lambda: "of each" in at.inner_text(), "the history of the whole run")
    whole = at.inner_text()
    tab_to(page, "figure.graph.wide .plot")
    for _ in range(3):
        page.keyboard.press("+")
    until(page, lambda: at.inner_text() != whole, "a closer look")
    page.keyboard.press("0")
    until(page, lambda: at.inner_text().partition("Z")[0] == whole.partition("Z")[0], "the whole run again")
    page.keyboard.press("ArrowLeft")


def test_a_mistake_does_nothing(browser: Browser, server: PageServer, shown: ShownRun) -> None:
    with visiting(browser, server, "operator", viewport=SMALL) as visitor:
        page = visitor.open_run(shown.name)
        page.click("#take")
        page.wait_for_selector("#abort:enabled")
        abort_needs_two_steps_and_a_reason(page, shown)
        an_alarm_is_announced_once(page, shown)
        closing_a_prompt_answers_nothing(page, shown)
        page.click("#abort")
        page.fill("#reason-value", "smoke")
        page.keyboard.press("Enter")
        page.click("#reason-go")
        until(page, lambda: commands(shown) == ["answer", "abort"], "abort")
        assert shown.asked[1]["by"].startswith("kim, operator, 127.0.0.1")
        expect(page.locator("#command-reply")).to_have_text("abort heard")


def abort_needs_two_steps_and_a_reason(page: Page, shown: ShownRun) -> None:
    page.click("#abort")
    expect(page.locator("#reason-text")).to_contain_text("not an emergency stop")
    page.evaluate("() => document.getElementById('reason-form').requestSubmit()")  # without a reason
    page.keyboard.press("Escape")
    page.click("#abort")
    page.fill("#reason-value", "smoke")
    page.keyboard.press("Enter")
    expect(page.locator("#reason-title")).to_contain_text("step 2 of 2")
    page.keyboard.press("Enter")  # once too often: the focus is on Cancel
    expect(page.locator("#reason")).to_be_hidden()
    assert commands(shown) == []


def an_alarm_is_announced_once(page: Page, shown: ShownRun) -> None:
    shown.state["alarms"] = [{**ALARM, "t_utc_s": now_utc_s()}]
    expect(page.locator("#announce")).to_have_text("WARNING: GPIB 14 timeout")
    page.evaluate("() => { document.getElementById('announce').textContent = ''; }")
    shown.state["progress"] = 0.39
    expect(page.locator("#percent")).to_have_text("39.0 %")  # another delta
    expect(page.locator("#announce")).to_be_empty()


def closing_a_prompt_answers_nothing(page: Page, shown: ShownRun) -> None:
    shown.state["prompt"] = {"id": "p1", "text": "Resistance between LO and ground", "confirm": "operator",
                             "unit": "ohm", "low": 1e6, "high": None, "since_utc_s": now_utc_s()}  # fmt: skip
    page.wait_for_selector("#prompt[open]")
    page.click("#theme")  # the page behind can still be used
    page.click("#prompt-close")
    expect(page.locator("#prompt")).to_be_hidden()
    page.wait_for_timeout(1500)
    assert page.is_hidden("#prompt"), "it came back by itself"
    assert commands(shown) == []
    page.click("#show-prompt")
    page.fill("#prompt-value", "5")
    page.keyboard.press("Enter")
    expect(page.locator("#prompt-trouble")).to_contain_text("1000000 ohm")
    page.fill("#prompt-value", "2e6")
    page.keyboard.press("Enter")
    until(page, lambda: commands(shown) == ["answer"], "the answer")
    expect(page.locator("#show-prompt")).to_be_hidden()


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
