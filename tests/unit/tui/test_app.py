"""The terminal view as a person meets it: the screen, keys, small terminals."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest
from rich.cells import cell_len
from textual.pilot import Pilot
from top_sample import ALARM, ESTIMATES, FakeFeed, Gone, SetClock, document

from bench.tui.app import TopApp
from bench.tui.look import UNICODE, Look, catalogue
from bench.tui.watch import Watch

SIZES = {"terminal": (80, 24), "phone": (60, 20), "wide": (140, 50)}
Act = Callable[[Pilot[None], "Bench"], Coroutine[Any, Any, None]]


class Bench:
    """A feed, a clock and the view of them."""

    def __init__(self, **changes: Any) -> None:
        self.feed, self.clock = FakeFeed(document(**changes)), SetClock()
        self.end: dict[str, Any] | None = None
        self.watch = Watch(Path("/data/sessions/run"), self.feed, self.clock, lambda: self.end, Gone)
        self.app = TopApp(self.watch.seen, Look(catalogue(), UNICODE), self.watch.look, self.fitted)

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


@pytest.mark.parametrize("size", SIZES)
def test_what_goes_on_is_on_the_screen(size: str) -> None:
    async def act(pilot: Pilot[None], bench: Bench) -> None:
        text = "\n".join(bench.screen())
        assert all(word in text for word in ("HOLDING", "door opened", "port_b: adapter", "live")), text
        assert "q leave (the run goes on)" in " ".join(bench.screen()[-2:])

    show(Bench(state="holding", holds={"operator": "door opened"}, alarms=[ALARM]), act, size)


def test_a_run_that_falls_silent_is_lost_and_comes_back() -> None:
    async def act(pilot: Pilot[None], bench: Bench) -> None:
        bench.feed.silent, bench.clock.s = True, 75.0
        found = await until(pilot, bench, "LOST")
        assert "NO ANSWER for 1:15" in "\n".join(found)
        assert "RUNNING" not in "\n".join(found)
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
