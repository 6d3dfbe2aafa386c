"""The last words of a guard: why it acted, what is confirmed, what is not, what to do; and where to say them.

A run that its guard ended was killed, so that its own terminal shows nothing (a shell says 137, 128 and the number of
SIGKILL). The guard hears of that terminal as a path: a descriptor that it kept would hold back whoever waits for the
end of a pipe, for as long as the guard goes on.
"""

from __future__ import annotations

import os
import stat
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from bench.model.posix import NOT_OURS
from bench.run.guard.diary import guard_word

WRITE_S = 2.0  # a terminal that somebody has stopped (Ctrl-S) takes nothing
_SHOW_CURSOR = "\x1b[?25h"  # a progress display that was killed leaves it hidden


def roles_in_words(unconfirmed: Mapping[str, str]) -> str:
    """Return instruments that are not confirmed safe with what is known of each: ``calibrator (unreachable), dmm``."""
    return ", ".join(f"{role} ({state})" if state else role for role, state in unconfirmed.items())


def last_words(word: Mapping[str, Any], session: str) -> str:
    """Return what a guard leaves to whoever looks next, one paragraph.

    Args: word: of ``guard_word``.   session: folder or name of the session.
    """
    utc = f"{str(word['utc'])[:19]}Z" if word["utc"] else "an unknown time"
    head = f"The guard of {session} has acted ({word['reason']}), last heard of at {utc}."
    names = roles_in_words(word["unsafe"])
    if word["safe"]:
        left = "Confirmed: every instrument is off, or on hold."
        return f"{head} {left} Next: find out why, then 'bench resume {session}'."
    if word["by"]:
        left = f"NOT confirmed when {word['by']} took the bench over: {names or 'any instrument'}."
        return f"{head} {left} Next: {word['by']} has to say what is on; switch off by hand what it does not reach."
    if word["safe"] is None:
        left = f"NOT confirmed: {names or 'any instrument'}; it is at it."
        return f"{head} {left} Next: look again in a minute, until then hands off."
    left = f"NOT confirmed: {names or 'which, it does not say'}; every other instrument is off, or on hold."
    advice = "switch these off at their front panels before anybody touches the bench; the guard goes on trying"
    return f"{head} {left} Next: {advice}, then 'bench resume {session}'."


def guard_lines(folder: Path) -> list[str]:
    """Return the last words of the guard of a session, as one line; none if it did not act."""
    word = guard_word(folder)
    return [] if word is None else [last_words(word, str(folder))]


def terminal_of(descriptor: int) -> str:
    """Return the path of the terminal or file that a descriptor writes to; "" for a pipe, a socket or nothing."""
    try:
        if os.isatty(descriptor):
            return os.ttyname(descriptor)
        is_file = stat.S_ISREG(os.fstat(descriptor).st_mode)
        return str(Path(f"/proc/self/fd/{descriptor}").readlink()) if is_file else ""
    except OSError:
        return ""


def write_to_terminal(place: int | str | Path, text: str) -> bool:
    """Append a paragraph to a terminal or file that is there; return whether it took it within ``WRITE_S``.

    Never raises. Args: place: its path, or a descriptor that stays open.
    """
    taken = threading.Event()

    def write() -> None:
        with suppress(OSError):
            descriptor = _opened(place)
            try:
                _write_all(descriptor, _framed(text, os.isatty(descriptor)))
                taken.set()
            finally:
                os.close(descriptor)

    writer = threading.Thread(target=write, daemon=True)
    writer.start()
    writer.join(WRITE_S)
    return taken.is_set()


def _opened(place: int | str | Path) -> int:
    return os.dup(place) if isinstance(place, int) else os.open(place, os.O_WRONLY | os.O_APPEND | NOT_OURS)


def _framed(text: str, is_terminal: bool) -> bytes:
    """Return a text as one line of its own, without anything that a terminal would take for a command."""
    line = "".join(character if character.isprintable() else "?" for character in " ".join(text.split()))
    return (f"\r\n{_SHOW_CURSOR}{line}\r\n" if is_terminal else f"\n{line}\n").encode(errors="replace")


def _write_all(descriptor: int, content: bytes) -> None:
    while content:
        content = content[os.write(descriptor, content) :]
