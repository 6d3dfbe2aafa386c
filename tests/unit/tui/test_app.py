"""The terminal view as a person meets it: the screen, keys, small terminals; pictures for a person.

Set BENCH_SCREENSHOTS to a folder to keep the pictures (SVG) there.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest
from rich.cells import cell_len
from textual.pilot import Pilot
from top_sample import ALARM, ESTIMATES, PROMPT, FakeFeed, Gone, SetClock, document

from bench.tui.app import TopApp
from bench.tui.look import ASCII, UNICODE, Glyphs, Look, catalogue
from bench.tui.watch import Watch

SIZES = {"terminal": (80, 24), "phone": (60, 20), "wide": (140, 50)}
Act = Callable[[Pilot[None], "Bench"], Coroutine[Any, Any, None]]


class Bench:
    """A feed, a clock and the view of them."""

    def __init__(self, glyphs: Glyphs = UNICODE, **changes: Any) -> None:
        self.feed, self.clock = FakeFeed(document(**changes)), SetClock()
        self.end: dict[str, Any] | None = None
        self.watch = Watch(Path("/data/sessions/run"), self.feed, self.clock, lambda: self.end, Gone)
        self.app = TopApp(self.watch.seen, Look(catalogue(), glyphs), self.watch.look, self.fitted)

    async def fitted(self) -> dict[str, Any]:
        return ESTIMATES

    def screen(self) -> list[str]:
        """Every line that is on the screen now."""
        size = self.app.size
        strips = self.app.screen._compositor.render_strips()
        lines = ["".join(segment.text for segment in strip) for strip in strips]
        assert len(lines) <= size.height
        assert all(cell_len(line) <= size.width for line in lines)
        return [line.rstrip() for line in lines]

    def picture(self, name: str, folder: Path) -> None:
        """Keep a picture for a person."""
        place = Path(os.environ.get("BENCH_SCREENSHOTS", folder))
        place.mkdir(parents=True, exist_ok=True)
        (place / f"top_{name}.svg").write_text(self.app.export_screenshot(title=name), encoding="utf-8")


def show(bench: Bench, act: Act, size: str = "terminal") -> None:
    async def shown() -> None:
        async with bench.app.run_test(size=SIZES[size]) as pilot:
            await pilot.pause()
            await act(pilot, bench)

    asyncio.run(shown())


async def until(pilot: Pilot[None], bench: Bench, word: str) -> list[str]:
    """The screen, as soon as it shows a word; fails after some 20 rounds of half a second."""
    for _ in range(100):
        await pilot.pause(0.1)
        if any(word in line for line in bench.screen()):
            return bench.screen()
    raise AssertionError(f"{word} is not on the screen: {bench.screen()}")


CASES: dict[str, tuple[dict[str, Any], tuple[str, ...]]] = {
    "running": ({}, ("RUNNING", "soak 50 degC", "48.2 degC, +0.4 degC/min", "412 of 765 records", "live")),
    "holding": ({"state": "holding", "holds": {"operator": "door opened"}, "alarms": [ALARM]},
                ("HOLDING", "door opened", "ALARMS", "port_b: adapter")),
    "prompt": ({"prompt": PROMPT, "simulated": True}, ("THE RUN ASKS", "Bridge resistance?", "SIMULATED")),
    "ended": ({"state": "ended", "wait": None, "eta": None, "outcome": {"error": None, "text": ""}},
              ("ENDED", "every step was done", "/data/sessions/run")),
    "failed": ({"state": "ended", "wait": None, "outcome": {"error": "B-RUN-031", "text": "50 degC not reached"}},
               ("ENDED WITH A FAULT", "B-RUN-031: 50 degC not reached")),
}  # fmt: skip


@pytest.mark.parametrize("size", ["terminal", "phone"])
@pytest.mark.parametrize("case", CASES)
def test_what_is_on_the_screen(case: str, size: str, tmp_path: Path) -> None:
    changes, words = CASES[case]

    async def act(pilot: Pilot[None], bench: Bench) -> None:
        text = "\n".join(bench.screen())
        assert [word for word in words if word not in text] == [], text
        assert "q leave (the run goes on)" in bench.screen()[-2 if size == "phone" else -1] + bench.screen()[-1]
        bench.picture(f"{case}_{size}", tmp_path)

    show(Bench(**changes), act, size)


def test_a_run_that_falls_silent_is_lost_and_comes_back(tmp_path: Path) -> None:
    async def act(pilot: Pilot[None], bench: Bench) -> None:
        bench.feed.silent, bench.clock.s = True, 75.0
        found = await until(pilot, bench, "LOST")
        assert "NO ANSWER for 1:15" in "\n".join(found)
        assert "RUNNING" not in "\n".join(found)
        bench.picture("lost_terminal", tmp_path)
        bench.feed.silent = False
        assert "LOST" not in "\n".join(await until(pilot, bench, "RUNNING"))

    show(Bench(), act)


def test_the_end_of_a_run_stays_on_the_screen() -> None:
    async def act(pilot: Pilot[None], bench: Bench) -> None:
        bench.feed.silent, bench.end = True, {"outcome": {"error": "B-RUN-010", "text": "asked to stop"}}
        assert "B-RUN-010: asked to stop" in "\n".join(await until(pilot, bench, "ENDED WITH A FAULT"))
        await pilot.pause(1.2)
        assert bench.app.is_running
        assert "B-RUN-010: asked to stop" in "\n".join(bench.screen())

    show(Bench(), act)


@pytest.mark.parametrize("key", ["q", "ctrl+c"])
def test_leaving_changes_nothing(key: str) -> None:
    async def act(pilot: Pilot[None], bench: Bench) -> None:
        await pilot.press(key)
        await pilot.pause()

    bench = Bench()
    show(bench, act)
    assert bench.app.return_code == 0
    assert not bench.app.is_running


def test_everything_can_be_scrolled_to_and_the_head_stays(tmp_path: Path) -> None:
    async def act(pilot: Pilot[None], bench: Bench) -> None:
        first = bench.screen()
        assert "LOG" not in first
        await pilot.press("end")
        await pilot.pause()
        last = bench.screen()
        assert "LOG" in last
        assert "RUNNING" in last[0]
        bench.picture("scrolled_terminal", tmp_path)
        of = last[-1].split()[-1]
        assert last[-1].split()[-3].endswith(f"-{of}")
        await pilot.press("home", "down")
        await pilot.pause()
        assert bench.screen()[1] == first[2]

    show(Bench(), act)


def test_uncertainties_of_the_results_so_far(tmp_path: Path) -> None:
    async def act(pilot: Pilot[None], bench: Bench) -> None:
        text = "\n".join(await until(pilot, bench, "RESULTS SO FAR"))
        assert "after 412 records" in text
        assert "Scale-factor error N  1 of 2  U so far 22 ppm  at the end 22 ppm  predicted 22 ppm" in text
        assert "Bias  1 of 1  U so far 10 nA  at the end 10 nA  predicted 10 nA" in text
        bench.picture("results", tmp_path)

    show(Bench(), act, "wide")


def test_local_time_by_a_key() -> None:
    async def act(pilot: Pilot[None], bench: Bench) -> None:
        assert "12:06:40Z" in bench.screen()[0]
        await pilot.press("u")
        await pilot.pause()
        assert "Z" not in bench.screen()[0].partition("live")[0].split()[-1]
        assert "+" in bench.screen()[0] or "-" in bench.screen()[0].split()[-3]

    show(Bench(), act)


@pytest.mark.parametrize("size", SIZES)
def test_ascii_only_where_the_terminal_knows_no_more(size: str, tmp_path: Path) -> None:
    async def act(pilot: Pilot[None], bench: Bench) -> None:
        assert all(line.isascii() for line in bench.screen())
        await pilot.press("pagedown")
        await pilot.pause()
        assert all(line.isascii() for line in bench.screen())
        bench.picture(f"ascii_{size}", tmp_path)

    show(Bench(ASCII, alarms=[ALARM], simulated=True), act, size)


@pytest.mark.parametrize("set_", [True, False])
def test_no_color_is_respected(monkeypatch: pytest.MonkeyPatch, set_: bool) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    if set_:
        monkeypatch.setenv("NO_COLOR", "1")

    async def act(pilot: Pilot[None], bench: Bench) -> None:
        colours = {
            colour.name
            for strip in bench.app.screen._compositor.render_strips()
            for segment in strip.apply_filter(bench.app._filters[-1], bench.app.screen.background_colors[1])
            if segment.style
            for colour in (segment.style.color, segment.style.bgcolor)
            if colour is not None and not colour.is_default
        }
        assert bool(colours) is not set_

    show(Bench(), act)
