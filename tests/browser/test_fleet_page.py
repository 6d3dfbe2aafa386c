"""Two hundred benches on one page, in a real browser: three are killed, two cut off, and the page itself is.

The benches are played over real sockets by the process of this test (benchmarks/fleet.py), one of them is a real
``bench serve`` that is killed.
"""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
import store_sample
from browser_rig import PageServer, until, visiting
from playwright.sync_api import Browser, Page, expect
from shown_run import LIVING, ShownRun, state_of
from test_axe import DESK, PHONE, nothing_is_wrong, well_led
from test_situations import picture

from bench.model.clock import WallClock
from bench.store import record_calibration
from benchmarks.fleet import Player

pytestmark = pytest.mark.waits

LIMIT_S = 5.0
CLOCK = WallClock()
RUN = "20260301T000000Z_real_7"
STATES = """() => Object.fromEntries([...document.querySelectorAll("#benches tbody tr[data-key]")].map(
  (row) => [row.dataset.key, row.querySelector(".fleet-state").dataset.state]))"""
ROWS = """() => [...document.querySelectorAll("#benches tbody tr[data-key]")].map(
  (row) => [row.dataset.key, row.className.match(/need-(\\w+)/)[1]])"""


@pytest.fixture(scope="module")
def player() -> Iterator[Player]:
    played = Player()
    yield played
    played.close()


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PageServer]:
    server = PageServer(tmp_path_factory.mktemp("bench"))
    yield server
    if server.process.poll() is None:
        server.end()


@pytest.fixture(scope="module")
def fleet(player: Player, bench: PageServer, tmp_path_factory: pytest.TempPathFactory) -> Iterator[PageServer]:
    top = tmp_path_factory.mktemp("fleet")
    path = player.write(top)
    token = top / "real.token"
    token.touch(0o600)
    token.write_text(bench.tokens["viewer"])
    path.write_text(
        path.read_text() + f"  - {{name: real, place: here, url: '{bench.origin}', token_file: real.token}}\n"
    )
    server = PageServer(top, shown=("--fleet", str(path)))
    yield server
    server.end()


def states(page: Page) -> dict[str, str]:
    return dict(page.evaluate(STATES))


def within(page: Page, wanted: dict[str, str], limit_s: float, begun_ns: int | None = None) -> float:
    """Seconds until the page says so of these benches, from now or from ``begun_ns``; fails after the limit."""
    begun_ns = CLOCK.now_ns() if begun_ns is None else begun_ns
    while True:
        passed_s = (CLOCK.now_ns() - begun_ns) / 1e9
        found = states(page)
        if wanted.items() <= found.items():
            return passed_s
        assert passed_s <= limit_s, {name: found[name] for name in wanted if found[name] != wanted[name]}
        page.wait_for_timeout(50)


def open_fleet(page: Page, fleet: PageServer, wanted: dict[str, str]) -> None:
    page.goto(f"{fleet.origin}/")
    page.wait_for_selector("#benches tbody tr")
    within(page, wanted, 20.0)


def as_it_is_shown(page: Page, bench: PageServer) -> None:
    """The real bench, whose run holds at its open door; its links, and nothing that commands."""
    real = page.locator("#benches tr[data-key=real]")
    for words in ("HOLDING", "door is open", "38.0 %", "ENERGISED", "NGU 7", "here"):
        expect(real).to_contain_text(words)
    expect(real.locator("a").first).to_have_attribute("href", f"{bench.origin}/")
    expect(page.locator(f"#benches a[href='{bench.origin}/runs/{RUN}']")).to_have_count(1)
    expect(page.locator("#benches button, #benches input, #benches form")).to_have_count(0)


def those_that_need_somebody_stand_first(page: Page, gone: list[str], silent: str) -> None:
    names, need = zip(*page.evaluate(ROWS), strict=True)
    assert list(need) == sorted(need, key=["much", "some", "none"].index)
    assert list(names[: len(gone)]) == gone
    row = page.locator(f"#benches tr[data-key={silent}]")
    expect(row).to_contain_text("heard last")
    expect(row).not_to_contain_text("ENERGISED")
    page.click("#states button[data-filter=unknown]")
    until(page, lambda: list(states(page)) == gone, "those that are unknown")
    page.fill("#search", f"{silent} room")
    until(page, lambda: list(states(page)) == [silent], "the one that is looked for")
    page.fill("#search", "")
    page.click("#states button[data-filter=all]")


def test_states_are_right_within_five_seconds(
    browser: Browser, player: Player, bench: PageServer, fleet: PageServer, screenshots: Path
) -> None:
    run = ShownRun(bench.out, RUN)
    run.state.update(state_of(LIVING["door"]))
    played = {one.name: one.state for one in player.benches}
    assert set(played.values()) == {"running", "holding", "waiting", "idle"}
    killed, cut = player.benches[:3], player.benches[3:5]
    with visiting(browser, fleet, "viewer", viewport=DESK) as visitor:
        page = visitor.page
        open_fleet(page, fleet, {**played, "real": "holding"})
        as_it_is_shown(page, bench)
        cut_ns = CLOCK.now_ns()
        for one in cut:
            one.is_cut = True
        for one in killed:
            player.kill(one)
        bench.end(signal.SIGKILL)
        gone = [*(one.name for one in (*killed, *cut)), "real"]
        passed_s = within(page, {**played, **dict.fromkeys(gone, "unknown")}, LIMIT_S, cut_ns)
        print(f"UNKNOWN after {passed_s:.2f} s")
        those_that_need_somebody_stand_first(page, gone, cut[0].name)
        for size, viewport in (("wide", DESK), ("phone", PHONE)):
            page.set_viewport_size(viewport)
            picture(page, screenshots / f"fleet_{size}.png")
        for one in killed:
            player.start(one)
        for one in cut:
            one.is_cut = False
        within(page, {**played, "real": "unknown"}, 40.0)
    run.close()


def test_a_page_that_does_not_hear_its_server_knows_nothing(
    browser: Browser, player: Player, fleet: PageServer
) -> None:
    """The server is stopped, not ended: its connections stay open and say nothing."""
    played = {one.name: one.state for one in player.benches}
    with visiting(browser, fleet, "viewer", may_fail=True) as visitor:
        page = visitor.page
        open_fleet(page, fleet, played)
        assert sum(need == "none" for _, need in page.evaluate(ROWS)) > 100
        fleet.process.send_signal(signal.SIGSTOP)
        try:
            within(page, dict.fromkeys(played, "unknown"), LIMIT_S)
            until(page, lambda: {need for _, need in page.evaluate(ROWS)} == {"much"}, "all need somebody")
            expect(page.locator("#benches")).not_to_contain_text("ENERGISED")
            expect(page.locator("#trouble")).to_be_visible()
        finally:
            fleet.process.send_signal(signal.SIGCONT)
        within(page, played, 20.0)
        expect(page.locator("#trouble")).to_be_hidden()


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PageServer]:
    """A page of twelve benches, one of them unknown, with a history in which a unit is overdue."""
    top = tmp_path_factory.mktemp("few")
    url = f"sqlite:///{top / 'history.sqlite'}"
    for document, manifest in store_sample.calibrations(2, 200.0, 17):
        record_calibration(url, document, manifest, None)
    played = Player(12)
    path = played.write(top)
    played.kill(played.benches[0])
    server = PageServer(top, shown=("--fleet", str(path), "--history", url))
    yield server
    server.end()
    played.close()


def open_few(page: Page, few: PageServer) -> None:
    page.goto(f"{few.origin}/")
    page.wait_for_selector("#benches .is-running")
    page.wait_for_selector("#due tbody tr a, #due tbody .overdue")
    page.wait_for_selector("#sessions tbody tr")


def test_everybody_reads_and_reaches_it(browser: Browser, few: PageServer, screenshots: Path) -> None:
    with visiting(browser, few, "viewer", viewport={"width": 1000, "height": 700}) as visitor:
        open_few(visitor.page, few)
        well_led(visitor.page)
        nothing_is_wrong(visitor.page, crossed=True)
        expect(visitor.page.locator("#due")).to_contain_text("OVERDUE")
        expect(visitor.page.locator("#sessions tbody tr")).to_have_count(2)
        picture(visitor.page, screenshots / "fleet_few.png")
    with visiting(browser, few, "viewer", has_touch=True, viewport=PHONE) as visitor:
        open_few(visitor.page, few)
        picture(visitor.page, screenshots / "fleet_few_phone.png")
