"""``bench top``: a living run in the terminal; it looks on and commands nothing."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from bench.commands.console import console, say
from bench.model.clock import WallClock
from bench.model.errors import InputError
from bench.model.texts import ENGLISH, check_language
from bench.run.control.client import FeedClient, FeedGone
from bench.run.guard.last_words import guard_lines
from bench.session.partial_fits import PartialFits
from bench.tui.app import TopApp
from bench.tui.look import ASCII, FOLDER, Look, catalogue, glyphs_for
from bench.tui.page import page_of
from bench.tui.watch import Seen, Watch, ending, remember_earlier

SOCKETS = ("live.sock", "live.path")
AGAIN_S = 1.0


def top(session: Path | None, out: Path, language: str = ENGLISH) -> None:
    """Watch the run of a session, or the newest run that answers in ``out``; without a terminal print its state once.

    On a terminal it waits for a run to appear in ``out``; one that draws ASCII only is shown English.
    Raises: InputError B-TUI-001 if no run answers, B-TXT-001 for a language that the view does not have.
    """
    check_language(language, FOLDER)
    on_terminal = sys.stdout.isatty() and sys.stdin.isatty() and os.environ.get("TERM", "dumb") != "dumb"
    watch = _watched([session] if session is not None else _candidates(out))
    if watch is None and session is None and on_terminal:
        watch = _waited_for(out)
    if watch is None:
        said = [line for folder in ([session] if session else _candidates(out)) for line in guard_lines(folder)]
        message = "; ".join(["no run answers here", *said])
        advice = (
            "" if said else "name the folder of a living run, or its --out; 'bench serve' shows finished sessions too"
        )
        raise InputError("B-TUI-001", message, where=str(session or out), next_step=advice)
    glyphs = glyphs_for(os.environ, sys.stdout.encoding or "")
    look = Look(catalogue(ENGLISH if glyphs == ASCII else language), glyphs)
    if not on_terminal:
        _print(watch.seen, look)
        return
    fits, folder = PartialFits(WallClock()), Path(watch.seen.folder)

    async def fitted() -> Mapping[str, Any] | None:
        await fits.once(folder)
        return fits.of(folder.name)

    TopApp(watch.seen, look, watch.look, fitted).run(mouse=False)  # so that text can be marked and copied


def _candidates(out: Path) -> list[Path]:
    """Return folders in which a run may answer, the newest first."""
    folders = {path.parent for name in SOCKETS for path in out.glob(f"*/{name}")}
    return sorted(folders, key=lambda folder: (folder.stat().st_mtime_ns, folder.name), reverse=True)


def _watched(folders: list[Path]) -> Watch | None:
    """Return the first run that answers, None if none does."""
    for folder in folders:
        try:
            watch = Watch(folder, FeedClient(folder), WallClock(), partial(ending, folder), FeedGone)
        except FeedGone:
            continue
        remember_earlier(watch.seen, folder)
        return watch
    return None


def _waited_for(out: Path) -> Watch:
    """Return a run as soon as one answers; Ctrl-C ends the waiting."""
    say(f"no run answers in {out} yet: waiting for one to begin, Ctrl-C leaves")
    clock = WallClock()
    while (watch := _watched(_candidates(out))) is None:
        clock.sleep(AGAIN_S)
    return watch


def _print(seen: Seen, look: Look) -> None:
    out = console()
    page = page_of(seen, look.at(width=out.width))
    for line in (*page.head, *page.body):
        out.print(line.plain)
