"""The terminal view of a living run: it looks on, twice a second, and changes nothing.

What the results come to, a process of its own finds out now and then (``bench.session.partial_fits``).
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import replace
from typing import Any, ClassVar

from rich.text import Text
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.widgets import Static

from bench.model.clock import pause
from bench.tui.folding import spread
from bench.tui.look import Look
from bench.tui.page import page_of
from bench.tui.watch import Seen

LOOK_EVERY_S = 0.5
FIT_LOOK_S = 1.0
Fitted = Callable[[], Awaitable[Mapping[str, Any] | None]]


class TopApp(App[None]):
    """A page on the terminal.

    Args: seen: what is known of the run. look: how it is drawn. again: asks the run once more, on a thread.
          fitted: gives the estimates so far, after a new fit where one is due.
    """

    ENABLE_COMMAND_PALETTE = False
    CSS = """
    Screen { background: ansi_default; color: ansi_default; }
    #head { height: auto; max-height: 60%; }
    #rest { height: 1fr; scrollbar-size: 0 0; }
    #body { height: auto; }
    #keys { height: auto; text-style: reverse; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("q", "quit", priority=True),
        Binding("ctrl+c", "quit", priority=True),
        Binding("u", "zone", priority=True),
        *(Binding(keys, f"scroll('{how}')") for keys, how in (
            ("down,j", "down"), ("up,k", "up"), ("pagedown,space", "page_down"), ("pageup,b", "page_up"),
            ("home,g", "home"), ("end,G", "end"),
        )),
    ]  # fmt: skip

    def __init__(self, seen: Seen, look: Look, again: Callable[[], Seen], fitted: Fitted) -> None:
        super().__init__(ansi_color=True)  # the terminal's own colours, light or dark
        self._seen, self._look, self._again, self._fitted = seen, look, again, fitted
        self._estimates: Mapping[str, Any] | None = None

    def compose(self) -> ComposeResult:
        yield Static(id="head", markup=False)
        with VerticalScroll(id="rest", can_focus=False):
            yield Static(id="body", markup=False)
        yield Static(id="keys", markup=False)

    def on_mount(self) -> None:
        self.watch(self.query_one("#rest"), "scroll_y", self._draw_keys, init=False)
        self._draw()
        self.run_worker(self._follow())
        self.run_worker(self._fit())

    def on_resize(self) -> None:
        self._draw()

    async def _follow(self) -> None:
        while True:
            self._seen = await asyncio.to_thread(self._again)
            if not self.query("#head"):  # the screen is being taken down
                return
            self._draw()
            await pause(LOOK_EVERY_S)

    async def _fit(self) -> None:
        while self._seen.document["state"] != "ended":
            self._estimates = await self._fitted()
            await pause(FIT_LOOK_S)

    def _draw(self) -> None:
        self._look = self._look.at(width=max(20, self.size.width))
        page = page_of(replace(self._seen, estimates=self._estimates), self._look)
        self.query_one("#head", Static).update(Text("\n").join(page.head))
        self.query_one("#body", Static).update(Text("\n").join(page.body))
        self.call_after_refresh(self._draw_keys)

    def _draw_keys(self) -> None:
        rest = self.query_one("#rest", VerticalScroll)
        first, height, of = round(rest.scroll_y) + 1, rest.size.height, rest.virtual_size.height
        texts = self._look.texts
        more = texts("key.more", first=first, last=min(of, first + height - 1), of=of) if of > height else ""
        lines = spread(Text(texts("key.help")), Text(more), self._look.width)
        self.query_one("#keys", Static).update(Text("\n").join(lines))

    def action_zone(self) -> None:
        """UTC or the time of this machine."""
        self._look = self._look.at(local=not self._look.local)
        self._draw()

    def action_scroll(self, how: str) -> None:
        """Scroll what is not pinned, at once: no animation over a slow line."""
        getattr(self.query_one("#rest", VerticalScroll), f"scroll_{how}")(animate=False)
