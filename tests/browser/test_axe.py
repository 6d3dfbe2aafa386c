"""axe-core finds nothing on any page that people see, in either theme; who has no mouse reaches everything."""

from pathlib import Path

import pytest
from axe_playwright_python.base import AXE_SCRIPT
from browser_rig import PATIENCE_MS, PageServer, visiting
from playwright.sync_api import Browser, Page, expect
from report_sample import calibrations
from shown_run import ShownRun

from bench.report.batch.document import batch_html
from bench.report.batch.model import Batch

pytestmark = pytest.mark.waits

DESK, PHONE = {"width": 1280, "height": 800}, {"width": 390, "height": 844}
# Every rule is judged on every element; only what is wrong is written down element by element.
RUN = """(only) => axe.run({ resultTypes: ["violations"], ...(only.length ? { runOnly: only } : {}) }).then(
  ({ violations }) => violations.flatMap(({ id, impact, nodes }) => nodes.map(
    (node) => `${impact}: ${id}: ${node.target}: ${node.failureSummary}`)))"""
THEME = "() => document.documentElement.dataset.theme"
CONTRAST = "color-contrast"
DRAWN = "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
PALE = """() => { document.querySelector("main").insertAdjacentHTML("beforeend",
  "<p style='color: #777; background: #888'>Outputs are on</p>"); }"""


def found(page: Page, *only: str) -> list[str]:
    """What axe finds on a page as it is shown now; ``only``: names of its rules, none for all."""
    if not page.evaluate("() => 'axe' in window"):
        page.evaluate(AXE_SCRIPT)
    return list(page.evaluate(RUN, list(only)))


def show(page: Page, size: dict[str, int], theme: str) -> None:
    page.set_viewport_size({"width": size["width"], "height": size["height"]})
    page.emulate_media(color_scheme=theme)  # type: ignore[arg-type]
    if page.evaluate(THEME) not in (None, theme):
        page.evaluate("(theme) => { document.documentElement.dataset.theme = theme; }", theme)
    page.evaluate(DRAWN)  # sizes and colours are those of the new look


def nothing_is_wrong(page: Page, *, crossed: bool = False) -> None:
    """Every rule at a desk in the dark and on a phone in the light; ``crossed``: contrast the other way round too."""
    looks: list[tuple[dict[str, int], str, tuple[str, ...]]] = [(DESK, "dark", ()), (PHONE, "light", ())]
    if crossed:
        looks += [(PHONE, "dark", (CONTRAST,)), (DESK, "light", (CONTRAST,))]
    wrong = []
    for size, theme, only in looks:
        show(page, size, theme)
        wrong += [f"{size['width']} {theme} {line}" for line in found(page, *only)]
    assert wrong == []


def test_the_first_page_the_login_and_a_page_that_is_not_there(
    browser: Browser, server: PageServer, living: dict[str, ShownRun], over: dict[str, str]
) -> None:
    del living, over  # on the first page
    with visiting(browser, server, None, may_fail=True) as visitor:  # 401 at first
        visitor.page.goto(f"{server.origin}/")
        nothing_is_wrong(visitor.page)
        visitor.login("viewer")
        visitor.page.goto(f"{server.origin}/")
        visitor.page.wait_for_selector("#sessions tbody tr")
        visitor.page.wait_for_selector(".run-card")
        nothing_is_wrong(visitor.page, crossed=True)
        assert visitor.page.goto(f"{server.origin}/runs/nothing").status == 404  # type: ignore[union-attr]
        nothing_is_wrong(visitor.page)


def test_what_is_too_pale_is_found(browser: Browser, server: PageServer) -> None:
    with visiting(browser, server, "viewer") as visitor:
        visitor.page.goto(f"{server.origin}/")
        visitor.page.wait_for_selector("#sessions tbody tr")
        visitor.page.evaluate(PALE)
        (said,) = found(visitor.page, CONTRAST)
        assert said.startswith("serious: color-contrast")


def asking_why(page: Page) -> None:
    page.click("#take")
    page.click("#abort:enabled")
    page.wait_for_selector("#reason[open]")


@pytest.mark.parametrize("name", ["running", "prompt", "door"])
def test_the_page_of_a_run_that_lives(
    browser: Browser, server: PageServer, living: dict[str, ShownRun], name: str
) -> None:
    with visiting(browser, server, "operator") as visitor:
        page = visitor.open_run(living[name].name)
        page.wait_for_selector("#operator:not(:empty)")
        nothing_is_wrong(page, crossed=name == "running")
        if name == "running":
            asking_why(page)
            nothing_is_wrong(page)


def test_the_page_of_a_session_that_is_over(browser: Browser, server: PageServer, over: dict[str, str]) -> None:
    with visiting(browser, server, "viewer") as visitor:
        visitor.page.goto(f"{server.origin}/runs/{over['pass']}")
        visitor.page.wait_for_selector("#session-outcome:not([hidden])")
        nothing_is_wrong(visitor.page)


@pytest.fixture(scope="module")
def documents(golden: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The report of a session, and that of a batch."""
    batch = Batch()
    for document in calibrations(12):
        batch.add(document, str(document["session"]))
    path = tmp_path_factory.mktemp("batch") / "batch.html"
    path.write_text(batch_html(batch, "test 0"), encoding="utf-8")
    return {"report": golden / "report.html", "batch": path}


@pytest.mark.parametrize("name", ["report", "batch"])
def test_a_report(browser: Browser, documents: dict[str, Path], name: str) -> None:
    context = browser.new_context()
    page = context.new_page()
    page.goto(documents[name].as_uri())
    nothing_is_wrong(page)
    context.close()


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
            if not stop["hidden"] or stop["control"] is None:  # the page itself
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
