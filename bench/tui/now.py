"""What a run is doing now: progress, end, step, wait; why it stands still, what it asks, how it ended."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.text import Text

from bench.model.units import plain_quantity
from bench.tui.folding import folded, joined
from bench.tui.look import Look, duration
from bench.tui.watch import Seen

BAR = 24  # columns
NARROW = 70
FAULT, GOOD, ASKED, QUIET = "bold red", "bold green", "bold magenta", "yellow"


def doing(seen: Seen, look: Look) -> list[Text]:
    """Progress and the end as a range, the step, the wait."""
    document = seen.document
    now = document.get("t_utc_s")
    return [*_progress(document, look), *_eta(document, look), *_step(document, look), *_wait(document, look, now)]


def _progress(document: Mapping[str, Any], look: Look) -> list[Text]:
    share = min(1.0, max(0.0, float(document.get("progress") or 0.0)))
    columns = BAR if look.width >= NARROW else BAR // 2
    full = int(share * columns)
    bar = look.glyphs.full * full + look.glyphs.empty * (columns - full)
    records = document.get("records") or {}
    counts = look.texts("records.counts", done=records.get("done", 0), planned=records.get("planned", 0))
    more = [look.texts(f"records.{what}", count=records[what]) for what in ("retaken", "flagged") if records.get(what)]
    return joined([f"{bar} {100 * share:3.0f} %", counts, *more], look.width)


def _eta(document: Mapping[str, Any], look: Look) -> list[Text]:
    if document.get("state") == "ended":
        return []
    eta = document.get("eta")
    if not eta:
        return [Text(look.texts("eta.none"))]
    likely = eta.get("likely_utc_s")
    times = {name: look.time(eta.get(f"{name}_utc_s"), likely) for name in ("earliest", "latest")}
    times["likely"] = look.time(likely, document.get("t_utc_s"))
    return folded(look.texts("eta.range", **times), look.width)


def _step(document: Mapping[str, Any], look: Look) -> list[Text]:
    step = document.get("step")
    if not step or document.get("state") == "ended":
        return []
    number = look.texts("step.number", number=step.get("number"), of=step.get("of"))
    what = look.clean(step.get("what") or "")
    return folded(f"{number}  {step.get('phase') or ''}  {what}", look.width, "bold")


def _wait(document: Mapping[str, Any], look: Look, now: float | None) -> list[Text]:
    wait = document.get("wait")
    if not wait:
        return []
    since, until = wait.get("since_utc_s"), wait.get("until_utc_s")
    elapsed = None if since is None or now is None else now - since
    parts = [look.clean(wait.get("reason") or "")]
    if elapsed is not None and until is not None and since is not None:
        parts.append(look.texts("wait.for", elapsed=duration(elapsed), total=duration(until - since)))
        parts.append(look.texts("wait.until", time=look.time(until, now)))
    elif elapsed is not None:
        parts.append(look.texts("wait.since", elapsed=duration(elapsed)))
    if wait.get("last"):
        parts.append(look.texts("wait.last", last=look.clean(wait["last"])))
    return joined([f"  {parts[0]}", *parts[1:]], look.width, rest="    ")


def outcome(seen: Seen, look: Look) -> list[Text]:
    """Return how the run ended, and where its session is."""
    found = seen.document.get("outcome")
    if seen.document.get("state") != "ended":
        return []
    code, text = (found or {}).get("error"), look.clean((found or {}).get("text") or "")
    if code:
        said = text if text.startswith("error ") else look.texts("outcome.bad", code=code, text=text)
    elif found is None:
        said = look.texts("outcome.unknown")
    else:
        said = look.texts("outcome.good")
    where = look.texts("outcome.where", folder=look.clean(seen.folder))
    style = FAULT if code else QUIET if found is None else GOOD
    return [Text(""), *folded(said, look.width, style), *folded(where, look.width)]


def prompt(seen: Seen, look: Look) -> list[Text]:
    """Return what a person is asked, and how to answer: not from here."""
    asked = seen.document.get("prompt")
    if not asked:
        return []
    lines = folded(look.clean(asked.get("text") or ""), look.width, ASKED, "  ")
    if asked.get("unit"):
        lines += folded(_limits(asked, look), look.width, first="  ")
    how = folded(look.texts("prompt.answer", folder=look.clean(seen.folder)), look.width, first="  ")
    return [Text(""), Text(look.texts("section.prompt"), style=ASKED), *lines, *how]


def _limits(asked: Mapping[str, Any], look: Look) -> str:
    unit = look.clean(asked["unit"])
    given = {name: plain_quantity(asked[name], unit) for name in ("low", "high") if asked.get(name) is not None}
    return look.texts(f"prompt.limits.{'_'.join(given) or 'none'}", unit=unit, **given)


def holds(seen: Seen, look: Look) -> list[Text]:
    """Return why the run stands still."""
    found: Mapping[str, Any] = seen.document.get("holds") or {}
    if not found:
        return []
    title = Text(look.texts("section.holds"), style="bold yellow")
    lines = [f"{look.clean(by)}: {look.clean(reason)}" for by, reason in found.items()]
    return [Text(""), title, *(one for line in lines for one in folded(line, look.width, QUIET, "  ", "    "))]
