"""The page of a run: what never scrolls away, and the rest, the most important first."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from rich.text import Text

from bench.tui.folding import cut, folded, spread
from bench.tui.look import Look, duration
from bench.tui.now import doing, holds, outcome, prompt
from bench.tui.tables import alarms, instruments, links, log, records
from bench.tui.temperature import temperature
from bench.tui.watch import Seen

STYLES = {
    "starting": "bold cyan", "running": "bold green", "holding": "bold yellow", "ending": "bold cyan",
    "ended": "bold", "stopped": "bold yellow", "failed": "bold red", "lost": "bold red reverse",
}  # fmt: skip
BAND = "bold black on yellow"
_SECTIONS: tuple[Callable[[Seen, Look], list[Text]], ...] = (
    doing, outcome, prompt, holds, alarms, temperature, links, records, instruments, log,
)  # fmt: skip


@dataclass(frozen=True)
class Page:
    """Lines that always stay in sight, and lines that scroll under them."""

    head: list[Text]
    body: list[Text]


def state_of(seen: Seen) -> str:
    """Return the state of a run as the page names it: also ``lost`` and ``failed``, which no run says of itself."""
    document = seen.document
    if seen.lost:
        return "lost"
    failed = document["state"] == "ended" and (document.get("outcome") or {}).get("error")
    return "failed" if failed else str(document["state"])


def page_of(seen: Seen, look: Look) -> Page:
    """The page of what was last heard of a run."""
    body = [line for section in _SECTIONS for line in section(seen, look)]
    return Page(_head(seen, look), body)


def _head(seen: Seen, look: Look) -> list[Text]:
    document = seen.document
    band = [_band(look)] if document.get("simulated") else []
    state = state_of(seen)
    word = Text(f" {look.glyphs.state(state)} {look.texts(f'state.{state}')} ", style=STYLES[state])
    lines = [
        *band,
        *spread(
            Text.assemble(word, " ", _what(document, look, look.width - word.cell_len - 1)),
            _fresh(seen, look),
            look.width,
        ),
    ]
    if seen.lost:
        said = look.texts("lost.head", age=duration(seen.age_s))
        lines += folded(f"{said}. {look.texts('lost.advice')}", look.width, STYLES["lost"], " ", " ")
        lines += _guard(seen, look)
    return lines


def _guard(seen: Seen, look: Look) -> list[Text]:
    """Return whether the bench was left safe by the guard of a run that is gone."""
    if seen.guard is None:
        return []
    key = {True: "guard.safe", False: "guard.unsafe", None: "guard.acting"}[seen.guard["safe"]]
    roles = look.clean(", ".join(seen.guard["unsafe"]))
    text = look.texts(key, reason=look.clean(seen.guard["reason"]), roles=roles)
    return folded(text, look.width, "bold green" if seen.guard["safe"] else STYLES["lost"], " ", " ")


def _band(look: Look) -> Text:
    return Text(cut(look.texts("band.simulated"), look.width).center(look.width), style=BAND)


def _what(document: Mapping[str, Any], look: Look, width: int) -> str:
    uut = document.get("uut") or {}
    name = " ".join(str(part) for part in (document.get("sequence"), uut.get("model"), uut.get("serial")) if part)
    return cut(look.clean(name), max(1, width))


def _fresh(seen: Seen, look: Look) -> Text:
    """Return how old what is shown is; a run that has ended does not get old."""
    document = seen.document
    if document.get("source") == "replay":
        return Text(look.texts("fresh.replay"))
    now = look.time(document.get("t_utc_s"))
    if seen.lost or document["state"] == "ended":
        return Text(now)
    return Text(f"{now}  {look.texts('fresh.live', age=duration(seen.age_s))}")
