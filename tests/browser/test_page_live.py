"""The live page in a real browser, and a finished session on it: what is shown, never what is not so."""

import json
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from browser_rig import PageServer, until, visiting
from playwright.sync_api import Browser, Page, expect
from rehearsal import writable_copy
from shown_run import GYROS, ShownRun

from bench.session.partial_fits import LONGEST_FIT_S

pytestmark = pytest.mark.waits

FIRST_POINTS_S = 2.0
RESUMED_MS = 10_000
ATTEMPTS = 3  # another process of the machine may be in the way once
SMALL = {"width": 700, "height": 500}  # only what is seen is drawn, by the processors of this machine
SLOW_MS = 1000 * LONGEST_FIT_S  # of the lowest priority: hardly anything beside a busy machine

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
        expect(page.locator("#links thead th").nth(5)).to_have_text("Jumps")
        expect(page.locator("#links tbody td").nth(5)).to_have_text("4")
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


ZOOM_MS = 300
FIRST_PLOT_MS = 1500
COMMANDS = ("pause", "resume", "abort", "take", "give")
# From the end of a drag to the frame in which its data are drawn.
WATCH = """() => {
  const at = document.querySelector("figure.graph.wide:last-of-type p.bucket");
  window.zoomed = [];
  let since = null;
  addEventListener("pointerup", () => { since = performance.now(); }, true);
  new MutationObserver(() => {
    if (since === null) return;
    const began = since;
    since = null;
    requestAnimationFrame(() => requestAnimationFrame(() => window.zoomed.push(performance.now() - began)));
  }).observe(at, { childList: true, subtree: true, characterData: true });
}"""
DRAWN = """async () => {
  const { page } = await import("/static/state.js");
  const drawn = () => page.history?.card.figure?.rows.n > 100;
  while (!drawn()) await new Promise(requestAnimationFrame);
  await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
  return performance.now();
}"""


def run_there(server: PageServer, sequence: str) -> str:
    """A finished session in the folder of the server, by name."""
    command = [sys.executable, "-m", "bench", "run", sequence, "--seed", "1", "--out", str(server.out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return next(path.name for path in server.out.glob(f"2000*_{sequence}_*") if path.is_dir())


@pytest.fixture(scope="module")
def finished(server: PageServer, short: tuple[Path, subprocess.CompletedProcess[str]]) -> str:
    return writable_copy(short[0], server.out / short[0].name).name


def history(page: Page) -> str:
    """What the graph of the history says about what it draws."""
    return page.locator("figure.graph.wide").last.locator("p.bucket").inner_text()


def drag(page: Page, part: float) -> None:
    """Zoom into so much of what the history shows, from its middle on, as one does with a mouse."""
    plot = page.locator("figure.graph.wide").last.locator(".plot")
    plot.scroll_into_view_if_needed()
    before, box = history(page), plot.bounding_box()
    left, width = box["x"] + 70, box["width"] - 80  # inside the axes
    height = box["y"] + box["height"] / 2
    for _ in range(ATTEMPTS):  # a page that is busy takes a drag that is over in no time for a click
        page.mouse.move(left + width * 0.4, height)
        page.mouse.down()
        for share in (0.5, 1.0):
            page.mouse.move(left + width * (0.4 + part * share), height)
        page.mouse.up()
        for _ in range(50):
            if history(page) != before:
                return
            page.wait_for_timeout(100)
    raise AssertionError("dragging does not zoom")


def zoom_to_readings(page: Page, parts: tuple[float, ...]) -> list[float]:
    """Drag again and again, to single readings; the time of each until it is drawn, ms."""
    until(page, lambda: "of each" in history(page), "the history of the whole session")
    page.evaluate(WATCH)
    for number, part in enumerate(parts):
        drag(page, part)
        until(page, lambda count=number + 1: len(page.evaluate("window.zoomed")) >= count, "drawn")
    assert history(page).startswith("mean over 1 s")
    assert "of each" not in history(page)  # single frames, each with the mean up to it
    return [float(one) for one in page.evaluate("window.zoomed")]


def test_a_replay_offers_no_command(browser: Browser, server: PageServer, finished: str) -> None:
    with visiting(browser, server, "operator") as visitor:
        page = visitor.open_run(finished)
        expect(page.locator("#replay-band")).to_contain_text("REPLAY")
        expect(page.locator("header.bar")).to_contain_text("SIMULATED")
        expect(page.locator("#watermark")).to_be_visible()
        for name in COMMANDS:
            expect(page.locator(f"#{name}")).to_be_hidden()
        expect(page.locator("#estimates tbody tr").first).to_contain_text(
            re.compile(r"Scale-factor error N.*ppm", re.S)
        )
        expect(page.locator("#estimates button.quantity").first).to_have_attribute("title", "dsf_n")
        one_figure_of_each(page)
        print("zoom to raw, ms:", [round(one) for one in zoom_to_readings(page, (0.03, 0.04))])
        at = page.inner_text("#replay-at")
        page.click("#replay-play")
        page.select_option("#replay-speed", "1000")
        expect(page.locator("#replay-at")).not_to_have_text(at)
        expect(page.locator("#replay-band")).to_be_visible()
        expect(page.locator("#commands")).to_be_hidden()


def one_figure_of_each(page: Page) -> None:
    """Rates in the unit of the channels under test, counts by one choice; temperature with its limits; a result."""
    gyros = page.locator("figure.graph").first
    said = gyros.locator("p.bucket")
    expect(said).to_contain_text("mean over 1 s")
    expect(gyros.locator(".ends button")).to_contain_text(["channel 1", "channel 2"])
    gyros.locator("summary").click()
    expect(gyros.locator("table")).to_contain_text("channel 1 (port_a.npp-ppp[1]/s) / mA")
    gyros.get_by_role("button", name="Counts").click()
    expect(said).to_contain_text("min and max of each 0.1 s")  # what came in single frames
    expect(gyros.locator(".ends button")).to_have_count(6)
    expect(page.locator("figure.graph.wide").first).to_contain_text("guard (unit): 70 \u00b0C")
    expect(page.locator("figure.graph")).to_have_count(4)  # gyros, accelerometers, temperature, history
    caption = page.locator("#estimate-figure figcaption")
    expect(caption).to_contain_text("Scale-factor error N")
    page.locator("#estimates button.quantity").nth(1).click()
    expect(caption).to_contain_text("Scale-factor error P")


@pytest.mark.sweep
@pytest.mark.parametrize("sequence", ["scale_factor_38h", "bias_ramp_25h"])
def test_whole_campaigns_are_drawn_at_once(browser: Browser, server: PageServer, sequence: str) -> None:
    """25 h and 38 h, ten channels: first plot from the request for the page on; each zoom 38 h, 1 h, 1 min, raw."""
    name = run_there(server, sequence)
    first, zoomed = [], []
    for _ in range(ATTEMPTS):
        with visiting(browser, server, "viewer") as visitor:
            page = visitor.page
            page.goto(f"{server.origin}/runs/{name}", wait_until="domcontentloaded")
            first.append(float(page.evaluate(DRAWN)))
            page.wait_for_timeout(2000)
            zoomed.append(zoom_to_readings(page, (1 / 38, 1 / 60, 1 / 4)))
    print(sequence, "first plot, ms:", [round(one) for one in first])
    print(sequence, "zooms, ms:", [[round(one) for one in row] for row in zoomed])
    shutil.rmtree(server.out / name)
    assert min(first) < FIRST_PLOT_MS
    assert max(map(min, zip(*zoomed, strict=True))) < ZOOM_MS


def test_what_is_not_sound_stands_before_everything_else(browser: Browser, server: PageServer, finished: str) -> None:
    folder = server.out / finished
    doubted = folder.with_name(finished.replace("SIM-1", "SIM-2"))
    shutil.copytree(folder, doubted)
    results = json.loads((folder / "results.json").read_text())
    reason = {"code": "lack_of_fit", "sentence": "The levels are not on a line.", "figure": 9.0}
    results["estimates"][1] |= {
        "quality": "doubtful", "reasons": [reason], "std_uncertainty": None, "coverage_factor": None,
        "expanded_uncertainty": None, "dof": None, "conformance_probability": None, "verdict": "indeterminate",
    }  # fmt: skip
    (doubted / "results.json").write_text(json.dumps(results))
    with visiting(browser, server, "viewer") as visitor:
        page = visitor.open_run(doubted.name)
        expect(page.locator("#estimates-doubt")).to_contain_text(
            "DOUBTFUL, 1 estimate of dsf_p: The levels are not on a line."
        )
        said, first = page.locator("#estimates-doubt").bounding_box(), page.locator("#graphs").bounding_box()
        assert said["y"] < first["y"]
        rows = page.locator("#estimates tbody tr")
        expect(rows.nth(1)).to_contain_text("doubtful")
        assert not any("doubtful" in row for row in rows.all_inner_texts()[2:])
