"""A page that is open for 38 hours of a run: what the browser and the server hold stays what it was after the first.

The run is fed at a hundred times its speed (23 minutes): 1000 points a second, a hundred times as many as live.
"""

from pathlib import Path

import pytest
from browser_rig import PageServer, Visitor, chromium, metrics, visiting
from playwright.sync_api import CDPSession
from shown_run import HOURS, FastRun

LOOK_ms = 20_000
MOST_TIMES = 1.5
HELD = ("JSHeapUsedSize", "Nodes", "JSEventListeners")


def held(visitor: Visitor, cdp: CDPSession, run: FastRun) -> dict[str, float]:
    """What is held now by browser and server."""
    found = metrics(cdp)
    resident_kB = next(
        line.split()[1]
        for line in Path(f"/proc/{visitor.server.process.pid}/status").read_text().splitlines()
        if line.startswith("VmRSS:")
    )
    now = {name: found[name] for name in HELD} | {"server_MB": int(resident_kB) / 1e3, "hours": run.hours}
    print(" ".join(f"{name} {value:.1f}" for name, value in now.items()), flush=True)
    return now


def use(visitor: Visitor) -> None:
    """Somebody looks: windows, zoom, cursor, numbers as a table, the other theme."""
    page = visitor.page
    plots = page.locator("figure.graph .plot")
    plots.last.focus()
    for key in ("+", "+", "+", "ArrowLeft", "0", "d", "d"):
        page.keyboard.press(key)
        page.wait_for_timeout(300)
    plots.first.hover()
    for number, window in enumerate(("10 min", "1 h", "run")):
        button = page.locator("figure.graph").nth(number).get_by_role("button", name=window, exact=True)
        button.click()
        assert button.get_attribute("aria-pressed") == "true"
    page.wait_for_timeout(500)


@pytest.mark.sweep
def test_38_hours(tmp_path: Path) -> None:
    server = PageServer(
        tmp_path, (str(Path(__file__).resolve().parents[1] / "support" / "page" / "page_with_fits.py"),)
    )
    run = FastRun(server.out, "20260101T000000Z_fast_1")
    seen = []
    try:
        with chromium() as browser, visiting(browser, server, "operator") as visitor:
            page = visitor.open_run(run.name)
            cdp = page.context.new_cdp_session(page)
            cdp.send("Performance.enable")
            page.locator("figure.graph details.numbers summary").first.click()
            label = page.locator("figure.graph").first.locator(".ends button").first
            texts = set()
            while run.hours < HOURS:
                use(visitor)
                page.wait_for_timeout(LOOK_ms if run.hours > 1 else 1000)
                visitor.requests.clear()
                texts.add(label.inner_text())
                assert page.inner_text("#badge-word") == "RUNNING"
                if run.hours > 1:
                    seen.append(held(visitor, cdp, run))
            page.wait_for_selector("#estimates tbody tr")
            assert len(texts) > len(seen) / 2, "nothing moved"
    finally:
        run.close()
        server.end()
    first, last = seen[0], seen[-1]
    for name in (*HELD, "server_MB"):
        assert last[name] < MOST_TIMES * first[name], (name, first[name], last[name])
