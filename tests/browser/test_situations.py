"""Twelve situations as people meet them: what the first page, the page of a run, a phone and the terminal say of each.

``make situations`` takes the pictures, for a person to look at.
"""

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
from browser_rig import PageServer, visiting
from playwright.sync_api import Browser, Page, expect
from shown_run import LIVING, OVER, ShownRun, state_of

pytestmark = pytest.mark.waits

IN_THE_SWEEP = ("soak", "port", "instrument", "door", "pass", "fail")  # the first page has them all
SIZES = {"wide": {"width": 1280, "height": 800}, "phone": {"width": 390, "height": 844}}

# Age of what was heard last in the moment in which the page says that it knows nothing: by the page's own clock.
AGE_WHEN_UNKNOWN = """async () => {
  const { age_s } = await import("/static/state.js");
  const bench = document.querySelector("#bench");
  const seen = () => { if (bench.dataset.state === "unknown") window.age_s ??= age_s(); };
  new MutationObserver(seen).observe(bench, { attributes: true });
}"""


def test_the_first_page(
    browser: Browser, server: PageServer, living: dict[str, ShownRun], over: dict[str, str], screenshots: Path
) -> None:
    with visiting(browser, server, "viewer", viewport=SIZES["wide"]) as visitor:
        page = visitor.page
        page.goto(f"{server.origin}/")
        for name, situation in LIVING.items():
            card = page.locator(f"a.run-card[href='/runs/{living[name].name}']")
            for words in (situation.word, *situation.says, "ENERGISED", "confirmed"):
                expect(card).to_contain_text(words)
            expect(card).not_to_contain_text("SAFE", ignore_case=True)
            expect(card).to_have_attribute("data-attention", situation.attention)
        guarded = page.locator(f"a.run-card[href='/runs/{over['guard']}']")
        for words in ("STOPPED", "no heartbeat for 2 s", "OUTPUTS OFF", "by the guard"):
            expect(guarded).to_contain_text(words)
        attention = page.eval_on_selector_all("a.run-card", "(cards) => cards.map((card) => card.dataset.attention)")
        assert attention == sorted(attention, key=["much", "some", "none"].index)
        for what in ("pass", "fail", "doubtful", "damaged"):
            page.click(f"#outcomes button[data-outcome={what}]")
            expect(page.locator(f"#sessions tr[data-key='{over[what]}']")).to_contain_text(OVER[what])
        page.click("#outcomes button[data-outcome='']")
        expect(page.locator("#sessions tbody tr").last).to_have_attribute("data-key", over["damaged"])
        for size, viewport in SIZES.items():
            page.set_viewport_size(viewport)
            picture(page, screenshots / f"first_{size}.png")


def picture(page: Page, path: Path) -> None:
    """Take a picture, if somebody wants to look at it: a whole page takes a browser without a graphics card seconds."""
    if "BENCH_SCREENSHOTS" in os.environ:
        page.screenshot(path=path, full_page=True)


def each(names: Iterable[str]) -> list[Any]:
    return [pytest.param(name, marks=[pytest.mark.sweep] if name in IN_THE_SWEEP else []) for name in names]


@pytest.mark.parametrize("name", each(LIVING))
def test_the_page_of_a_run(
    browser: Browser, server: PageServer, living: dict[str, ShownRun], screenshots: Path, name: str
) -> None:
    situation = LIVING[name]
    with visiting(browser, server, "viewer", viewport=SIZES["wide"]) as visitor:
        page = visitor.page
        page.goto(f"{server.origin}/runs/{living[name].name}")
        page.wait_for_selector("body[data-fresh=fresh]")
        page.wait_for_selector("#bench[data-state=energised]")
        expect(page.locator("#badge-word")).to_have_text(situation.word)
        for words in situation.says:
            expect(page.locator("body")).to_contain_text(words)
        for size, viewport in SIZES.items():
            page.set_viewport_size(viewport)
            picture(page, screenshots / f"run_{name}_{size}.png")


def test_a_lost_link_is_unknown_within_five_seconds(browser: Browser, server: PageServer) -> None:
    run = ShownRun(server.out, "20260303T000000Z_lost_7")
    run.state.update(state_of(LIVING["running"]))
    with visiting(browser, server, "viewer", may_fail=True) as visitor:
        page = visitor.page
        page.goto(f"{server.origin}/runs/{run.name}")
        page.wait_for_selector("#bench[data-state=energised]")
        page.evaluate(AGE_WHEN_UNKNOWN)
        run.close()
        page.wait_for_selector("#bench[data-state=unknown]")
        assert page.evaluate("window.age_s") < 5.0
        expect(page.locator("#bench")).not_to_contain_text("20 mA")


def test_a_first_page_whose_server_is_gone_is_unknown(browser: Browser, tmp_path: Path) -> None:
    server = PageServer(tmp_path)
    run = ShownRun(server.out, "20260303T000000Z_gone_7")
    run.state.update(state_of(LIVING["running"]))
    with visiting(browser, server, "viewer", may_fail=True) as visitor:
        page = visitor.page
        page.goto(f"{server.origin}/")
        page.wait_for_selector(".run-card .bench[data-state=energised]")
        server.end()
        page.wait_for_selector(".run-card .bench[data-state=unknown]", timeout=9000)  # 5 s after it was heard last
        expect(page.locator(".run-card")).to_have_attribute("data-attention", "much")
    run.close()


@pytest.mark.parametrize("what", each(OVER))
def test_a_session_that_is_over_begins_with_its_outcome(
    browser: Browser, server: PageServer, over: dict[str, str], screenshots: Path, what: str
) -> None:
    with visiting(browser, server, "viewer", viewport=SIZES["wide"]) as visitor:
        page = visitor.page
        page.goto(f"{server.origin}/runs/{over[what]}")
        expect(page.locator("#session-outcome .outcome-word")).to_have_text(OVER[what])
        expect(page.locator("#session-outcome #report")).to_be_visible()
        picture(page, screenshots / f"over_{what}.png")
