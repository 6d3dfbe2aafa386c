"""Alarms, links, records, instruments and the log of a run, as lines that fold to any width."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.text import Text

from bench.run.feed.planned import conditions_in_words
from bench.tui.folding import cut, folded, joined
from bench.tui.look import Look, duration
from bench.tui.watch import Seen

TITLE = "bold cyan"
SEVERITIES = {"warning": ("! ", "yellow"), "alarm": ("!!", "bold red"), "fault": ("X ", "bold red")}
LINK_GOOD = ("streaming", "open", "back")


def titled(look: Look, key: str, lines: list[Text], style: str = TITLE) -> list[Text]:
    """Return a section with its title and a blank line before it; nothing without content."""
    return [Text(""), Text(look.texts(key), style=style), *lines] if lines else []


def alarms(seen: Seen, look: Look) -> list[Text]:
    """Every alarm that is active or that nobody has seen yet."""
    lines: list[Text] = []
    now = seen.document.get("t_utc_s")
    for one in seen.document.get("alarms") or ():
        acknowledged = one.get("acknowledged")
        if acknowledged and not one.get("active"):
            continue
        mark, style = SEVERITIES.get(str(one.get("severity")), ("! ", "yellow"))
        words = [look.time(one.get("t_utc_s"), now), str(one.get("severity", "")), str(one.get("code") or "")]
        words.append(look.texts("alarm.active" if one.get("active") else "alarm.over"))
        if acknowledged:
            words.append(look.texts("alarm.acknowledged", by=acknowledged.get("by", "")))
        text = look.clean(f"{' '.join(word for word in words if word)}: {one.get('text', '')}")
        lines += folded(text, look.width, style, f"{mark} ", "   ")
    return titled(look, "section.alarms", lines, "bold red")


def links(seen: Seen, look: Look) -> list[Text]:
    """Counters of every link to the unit."""
    lines: list[Text] = []
    for name, one in (seen.document.get("links") or {}).items():
        state, age, rate = str(one.get("state") or ""), one.get("age_s"), one.get("rate_Hz")
        good = state in LINK_GOOD and not one.get("bad") and not one.get("lost")
        parts = [f"  {look.clean(name)} {look.clean(state)}"]
        parts += [look.texts(f"link.{what}", count=one.get(what) or 0) for what in ("frames", "bad", "lost")]
        parts.append("" if rate is None else f"{rate:.1f} Hz")
        parts.append(look.texts("link.silent") if age is None else look.texts("link.age", age=duration(age)))
        parts.append("" if state in LINK_GOOD else look.clean(one.get("reason") or ""))
        lines += joined(parts, look.width, "" if good else "yellow", rest="    ")
    return titled(look, "section.links", lines)


def records(seen: Seen, look: Look) -> list[Text]:
    """Return the last records, newest first."""
    lines: list[Text] = []
    now = seen.document.get("t_utc_s")
    for one in (seen.document.get("records") or {}).get("last") or ():
        lost, bad, flags = one.get("lost") or 0, one.get("bad") or 0, one.get("flags")
        parts = [f"  {one.get('number')}", look.time(one.get("t_utc_s"), now), _conditions(one, look)]
        parts.append(look.texts("record.readings", count=one["readings"]) if one.get("readings") is not None else "")
        parts.append(look.texts("record.lost", lost=lost, bad=bad) if lost or bad else "")
        parts.append(look.texts("record.flags", flags=_flags(flags, look)) if flags else "")
        lines += joined(parts, look.width, "yellow" if lost or bad or flags else "", rest="    ")
    return titled(look, "section.records", lines)


def _flags(flags: Any, look: Look) -> str:
    return look.clean(" ".join(str(flag) for flag in flags) if isinstance(flags, list | tuple) else flags)


def _conditions(record: Mapping[str, Any], look: Look) -> str:
    conditions = record.get("conditions")
    if not isinstance(conditions, Mapping):
        return look.clean(conditions or "")
    return look.clean(conditions_in_words(conditions))


def instruments(seen: Seen, look: Look) -> list[Text]:
    """Return the last word with each instrument, one line each; what is wrong below it."""
    lines: list[Text] = []
    now = seen.document.get("t_utc_s")
    for role, one in (seen.document.get("instruments") or {}).items():
        state = str(one.get("state") or "ok")
        word = look.texts(f"instrument.state.{state}") if state in ("ok", "away", "error") else look.clean(state)
        when, answer = one.get("t_utc_s"), one.get("answer_ms")
        ago = "" if when is None or now is None else look.texts("instrument.ago", age=duration(now - when))
        talk = " ".join(f"{mark} {one[what]}" for mark, what in ((">", "command"), ("<", "reply")) if one.get(what))
        parts = [f"{look.clean(role)} {word}", ago, "" if answer is None else f"{answer:.0f} ms", look.clean(talk)]
        text = "  ".join(part for part in parts if part)
        lines.append(Text(cut(f"  {text}", look.width), style="" if state == "ok" else "bold red"))
        if one.get("errors"):
            said = look.texts("instrument.errors", count=one["errors"], error=look.clean(one.get("error") or ""))
            lines += folded(said, look.width, "yellow", "    ", "    ")
    return titled(look, "section.instruments", lines)


def log(seen: Seen, look: Look) -> list[Text]:
    """Return what happened, newest first."""
    lines: list[Text] = []
    now = seen.document.get("t_utc_s")
    for one in seen.document.get("log") or ():
        text = look.clean(f"{look.time(one.get('t_utc_s'), now)} {one.get('kind', '')}: {one.get('text', '')}")
        lines += folded(text, look.width, first="  ", rest="    ")
    return titled(look, "section.log", lines)
