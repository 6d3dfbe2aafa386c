"""A finished session on the same page: what a replay shows and does not offer, its history down to single readings."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from browser_rig import PageServer, until, visiting
from playwright.sync_api import Browser, Page, expect
from rehearsal import writable_copy

pytestmark = pytest.mark.waits

ZOOM_MS = 300
FIRST_PLOT_MS = 1500
ATTEMPTS = 3  # another process of the machine may be in the way once
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
    assert box is not None
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
        expect(page.locator("#replay-band")).to_contain_text("RECORDING")
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
        expect(page.locator("#estimates-doubt")).to_contain_text("DOUBTFUL, 1 estimate: The levels are not on a line.")
        said, first = page.locator("#estimates-doubt").bounding_box(), page.locator("#graphs").bounding_box()
        assert said is not None
        assert first is not None
        assert said["y"] < first["y"]
        rows = page.locator("#estimates tbody tr")
        expect(rows.nth(1)).to_contain_text("doubtful")
        assert not any("doubtful" in row for row in rows.all_inner_texts()[2:])
