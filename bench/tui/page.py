"""The page of a run: what never scrolls away, and the rest, the most important first.

That is what the run is doing now: progress, end, step, wait; why it stands still, what it asks, how it ended.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rich.cells import cell_len
from rich.text import Text

from bench.model.units import plain_quantity, plain_unit
from bench.run.feed.bench_state import figures_of
from bench.run.guard.last_words import roles_in_words
from bench.tui.folding import cut, folded, joined, spread
from bench.tui.look import Look, duration
from bench.tui.tables import alarms, estimates, instruments, links, log, records, temperature, titled
from bench.tui.watch import Seen

STYLES = {
    "starting": "bold cyan", "running": "bold green", "waiting": "bold yellow", "holding": "bold yellow",
    "ending": "bold cyan", "ended": "bold", "stopped": "bold yellow", "failed": "bold red", "lost": "bold red reverse",
}  # fmt: skip
BENCH = {"off": "bold green", "energised": "bold cyan", "moving": "bold cyan", "unknown": "bold red"}
BAND = "bold black on yellow"
BAR = 24  # columns
NARROW = 70
FAULT, GOOD, ASKED, QUIET = "bold red", "bold green", "bold magenta", "yellow"


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
    """Return the page of what was last heard of a run."""
    sections = (doing, outcome, prompt, holds, alarms, temperature, estimates, links, records, instruments, log)
    body = [line for section in sections for line in section(seen, look)]
    return Page(_head(seen, look), body)


def _head(seen: Seen, look: Look) -> list[Text]:
    document = seen.document
    band = [_band(look)] if document.get("simulated") else []
    state = state_of(seen)
    style = STYLES[state] if seen.lost or document.get("attention") != "much" else FAULT
    word = Text(f" {look.glyphs.state(state)} {look.texts(f'state.{state}')} ", style=style)
    lines = [
        *band,
        *spread(
            Text.assemble(word, " ", _what(document, look, look.width - word.cell_len - 1)),
            _fresh(seen, look),
            look.width,
        ),
    ]
    lines += _bench(seen, look)
    if seen.lost:
        said = look.texts("lost.head", age=duration(seen.age_s))
        lines += folded(f"{said}. {look.texts('lost.advice')}", look.width, STYLES["lost"], " ", " ")
    return lines + _guard(seen, look)


def _bench(seen: Seen, look: Look) -> list[Text]:
    """Return what is on, since when that is known, and what stays dangerous."""
    bench = seen.document.get("bench")
    if bench is None:
        return []
    word, confirmed = str(bench["state"]), bench.get("confirmed_utc_s")
    parts = [f" {look.texts(f'bench.{word}')}"]
    if confirmed is not None and bench.get("ended_utc_s") is not None:
        parts.append(look.texts("bench.ended", time=look.time(confirmed, seen.document.get("t_utc_s"))))
    elif confirmed is not None:
        parts.append(look.texts("bench.confirmed", age=duration(seen.document["t_utc_s"] - confirmed)))
    unconfirmed = bench.get("unconfirmed") or {}
    if unconfirmed:
        parts.append(look.texts("bench.unconfirmed", what=look.clean(roles_in_words(unconfirmed))))
    for part in bench["parts"]:
        if part["state"] == "on":
            parts.append(look.clean(f"{part['role']} {figures_of(part)}"))
        elif part["state"] == "unknown" and part["role"] not in unconfirmed:
            parts.append(look.texts("bench.silent", role=look.clean(part["role"])))
    parts += [look.texts(f"bench.remains.{what}") for what in bench["remains"]]
    return joined(parts, look.width, BENCH["unknown" if unconfirmed else word], rest="  ")


def _guard(seen: Seen, look: Look) -> list[Text]:
    """Return whether the bench was left safe by the guard of a run that is gone."""
    guard = seen.document.get("guard")
    if guard is None:
        return []
    key = {True: "guard.safe", False: "guard.unsafe", None: "guard.acting"}[guard["safe"]]
    key = "guard.taken_over" if guard["by"] else key
    said = {"reason": guard["reason"], "roles": roles_in_words(guard["unsafe"]), "by": guard["by"]}
    text = look.texts(key, **{name: look.clean(value) for name, value in said.items()})
    return folded(text, look.width, "bold green" if guard["safe"] else STYLES["lost"], " ", " ")


def _band(look: Look) -> Text:
    text = cut(look.texts("band.simulated"), look.width)
    return Text(text.center(look.width - cell_len(text) + len(text)), style=BAND)  # a wide letter takes two columns


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


def doing(seen: Seen, look: Look) -> list[Text]:
    """Return progress and the end as a range, the step, the wait, what no interlock watches."""
    document = seen.document
    now = document.get("t_utc_s")
    unwatched = [
        line for said in document.get("unwatched") or () for line in folded(look.clean(said), look.width, QUIET)
    ]
    lines = [*_progress(document, look), *_eta(document, look), *_step(document, look), *_wait(document, look, now)]
    return [*lines, *unwatched]


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
    outcome = seen.document.get("outcome")
    if seen.document.get("state") != "ended":
        return []
    code, text = (outcome or {}).get("error"), look.clean((outcome or {}).get("text") or "")
    if code:
        said = text if text.startswith("error ") else look.texts("outcome.bad", code=code, text=text)
    elif outcome is None:
        said = look.texts("outcome.unknown")
    else:
        said = look.texts("outcome.good")
    where = look.texts("outcome.where", folder=look.clean(seen.folder))
    style = FAULT if code else QUIET if outcome is None else GOOD
    return [Text(""), *folded(said, look.width, style), *folded(where, look.width)]


def prompt(seen: Seen, look: Look) -> list[Text]:
    """Return what a person is asked, and how to answer: not from here."""
    asked = seen.document.get("prompt")
    if not asked:
        return []
    lines = folded(look.clean(asked.get("text") or ""), look.width, ASKED, "  ")
    if asked.get("unit"):
        lines += folded(_limits(asked, look), look.width, first="  ")
    presence = "bench" if asked.get("presence") == "bench" else "anywhere"
    how = folded(look.texts(f"prompt.answer.{presence}", folder=look.clean(seen.folder)), look.width, first="  ")
    return titled(look, "section.prompt", [*lines, *how], ASKED)


def _limits(asked: Mapping[str, Any], look: Look) -> str:
    unit = look.clean(asked["unit"])
    given = {name: plain_quantity(asked[name], unit) for name in ("low", "high") if asked.get(name) is not None}
    return look.texts(f"prompt.limits.{'_'.join(given) or 'none'}", unit=plain_unit(unit), **given)


def holds(seen: Seen, look: Look) -> list[Text]:
    """Return why the run stands still."""
    reasons: Mapping[str, Any] = seen.document.get("holds") or {}
    lines = [f"{look.clean(by)}: {look.clean(reason)}" for by, reason in reasons.items()]
    parts = [part for line in lines for part in folded(line, look.width, QUIET, "  ", "    ")]
    return titled(look, "section.holds", parts, "bold yellow")
