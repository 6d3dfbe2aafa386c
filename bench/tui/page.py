"""The page of a run: what never scrolls away, and the rest, the most important first.

That is what the run is doing now: progress, end, step, wait; why it stands still, what it asks, how it ended.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rich.cells import cell_len
from rich.text import Text

from bench.model.texts import ENGLISH
from bench.model.units import plain_quantity, plain_unit
from bench.run.feed.bench_state import figures_of
from bench.run.feed.place import conditions_in_words
from bench.run.guard.last_words import roles_in_words
from bench.tui.folding import cut, folded, joined, spread
from bench.tui.look import Look, duration
from bench.tui.watch import AIR, UNIT, Range, Seen

TITLE = "bold cyan"
SEVERITIES = {"warning": ("! ", "yellow"), "alarm": ("!!", "bold red"), "fault": ("X ", "bold red")}
LINK_GOOD = ("streaming", "open", "back")
PLOT_ROWS = 3
PLOT_COLUMNS = 60
_BRAILLE = 0x2800
_DOTS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))  # bit of a dot by column and row of a cell, from the top
LEAST_SPAN = 0.5  # a plot of less than this would draw the noise of a sensor as a mountain


def titled(look: Look, key: str, lines: list[Text], style: str = TITLE) -> list[Text]:
    """Return a section with its title and a blank line before it; nothing without content."""
    return [Text(""), Text(look.texts(key), style=style), *lines] if lines else []


def alarms(seen: Seen, look: Look) -> list[Text]:
    """Return every alarm that is active or that nobody has seen yet."""
    lines: list[Text] = []
    now = seen.document.get("t_utc_s")
    for alarm in seen.document.get("alarms") or ():
        acknowledged = alarm.get("acknowledged")
        if acknowledged and not alarm.get("active"):
            continue
        mark, style = SEVERITIES.get(str(alarm.get("severity")), ("! ", "yellow"))
        words = [look.time(alarm.get("t_utc_s"), now), str(alarm.get("severity", "")), str(alarm.get("code") or "")]
        words.append(look.texts("alarm.active" if alarm.get("active") else "alarm.over"))
        if acknowledged:
            words.append(look.texts("alarm.acknowledged", by=acknowledged.get("by", "")))
        if shelved := alarm.get("shelved"):
            until = look.time(shelved.get("until_utc_s"), now)
            words.append(
                look.texts("alarm.shelved", until=until, by=shelved.get("by", ""), reason=shelved.get("reason"))
            )
            style = "yellow"
        text = look.clean(f"{alarm.get('id', '')} {' '.join(word for word in words if word)}: {alarm.get('text', '')}")
        lines += folded(text, look.width, style, f"{mark} ", "   ")
    return titled(look, "section.alarms", lines, "bold red")


def links(seen: Seen, look: Look) -> list[Text]:
    """Return counters of every link to the unit."""
    lines: list[Text] = []
    for name, link in (seen.document.get("links") or {}).items():
        state, age, rate = str(link.get("state") or ""), link.get("age_s"), link.get("rate_Hz")
        good = state in LINK_GOOD and not link.get("bad") and not link.get("lost")
        parts = [f"  {look.clean(name)} {look.clean(state)}"]
        parts += [look.texts(f"link.{what}", count=link.get(what) or 0) for what in ("frames", "bad", "lost")]
        parts.append("" if rate is None else f"{rate:.1f} Hz")
        parts.append(look.texts("link.silent") if age is None else look.texts("link.age", age=duration(age)))
        parts.append("" if state in LINK_GOOD else look.clean(link.get("reason") or ""))
        lines += joined(parts, look.width, "" if good else "yellow", rest="    ")
    return titled(look, "section.links", lines)


def records(seen: Seen, look: Look) -> list[Text]:
    """Return the last records, newest first."""
    lines: list[Text] = []
    now = seen.document.get("t_utc_s")
    for record in (seen.document.get("records") or {}).get("last") or ():
        lost, bad, flags = record.get("lost") or 0, record.get("bad") or 0, record.get("flags")
        parts = [f"  {record.get('number')}", look.time(record.get("t_utc_s"), now), _conditions(record, look)]
        parts.append(
            look.texts("record.readings", count=record["readings"]) if record.get("readings") is not None else ""
        )
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


def estimates(seen: Seen, look: Look) -> list[Text]:
    """Return the greatest uncertainty of each quantity: of the records so far, at the end of the run, as predicted."""
    known = seen.estimates
    if known is None:
        return []
    lines = folded(look.texts("estimates.when", records=known["records"]), look.width, first="  ", rest="    ")
    for said in known.get("doubt") or ():
        lines += folded(look.clean(said), look.width, "yellow", "  ", "    ")
    by_title: dict[str, list[Mapping[str, Any]]] = {}
    for row in known["rows"]:
        titles = row["titles"]
        by_title.setdefault(look.clean(titles.get(look.texts.language) or titles[ENGLISH]), []).append(row)
    for title, rows in by_title.items():
        determined = sum(row["value"] is not None for row in rows)
        parts = [f"  {title}", look.texts("estimates.known", known=determined, of=len(rows))]
        parts += [_greatest(rows, f"{which}_uncertainty", look) for which in ("expanded", "expected", "predicted")]
        lines += joined(parts, look.width, rest="    ")
    return titled(look, "section.estimates", lines)


def _greatest(rows: Sequence[Mapping[str, Any]], which: str, look: Look) -> str:
    """Return the greatest of an uncertainty with two digits; "" if no row has it."""
    greatest = max((row[which] for row in rows if row.get(which)), default=None)
    if greatest is None:
        return ""
    return look.texts(f"estimates.{which}", U=look.clean(plain_quantity(float(f"{greatest:.2g}"), rows[0]["unit"])))


def instruments(seen: Seen, look: Look) -> list[Text]:
    """Return the last word with each instrument, one line each; what is wrong below it."""
    lines: list[Text] = []
    now = seen.document.get("t_utc_s")
    for role, instrument in (seen.document.get("instruments") or {}).items():
        state = str(instrument.get("state") or "ok")
        word = look.texts(f"instrument.state.{state}") if state in ("ok", "away", "error") else look.clean(state)
        when, answer = instrument.get("t_utc_s"), instrument.get("answer_ms")
        ago = "" if when is None or now is None else look.texts("instrument.ago", age=duration(now - when))
        talk = " ".join(
            f"{mark} {instrument[what]}" for mark, what in ((">", "command"), ("<", "reply")) if instrument.get(what)
        )
        parts = [f"{look.clean(role)} {word}", ago, "" if answer is None else f"{answer:.0f} ms", look.clean(talk)]
        text = "  ".join(part for part in parts if part)
        lines.append(Text(cut(f"  {text}", look.width), style="" if state == "ok" else "bold red"))
        if instrument.get("errors"):
            error = look.clean(instrument.get("error") or "")
            said = look.texts("instrument.errors", count=instrument["errors"], error=error)
            lines += folded(said, look.width, "yellow", "    ", "    ")
    return titled(look, "section.instruments", lines)


def log(seen: Seen, look: Look) -> list[Text]:
    """Return what happened, newest first."""
    lines: list[Text] = []
    now = seen.document.get("t_utc_s")
    for entry in seen.document.get("log") or ():
        text = look.clean(f"{look.time(entry.get('t_utc_s'), now)} {entry.get('kind', '')}: {entry.get('text', '')}")
        lines += folded(text, look.width, first="  ", rest="    ")
    return titled(look, "section.log", lines)


def temperature(seen: Seen, look: Look) -> list[Text]:
    """Return one line of values and the plot."""
    document = seen.document
    planned = planned_degC(document.get("timetable") or {}, document.get("t_utc_s"))
    values = {"planned": planned, "air": seen.last.get(AIR), "unit": seen.last.get(UNIT)}
    parts = [look.texts(f"temperature.{name}", value=look.degC(value)) for name, value in values.items()]
    lines = joined([f"  {parts[0]}", *parts[1:]], look.width)
    return titled(look, "section.temperature", [*lines, *_plot(seen, look)])


def _plot(seen: Seen, look: Look) -> list[Text]:
    braille = look.glyphs.braille
    columns = min(PLOT_COLUMNS, look.width - 2)
    ranges = seen.trend.ranges(dots_across(columns, braille))
    known: list[Range] = [extent for extent in ranges if extent is not None]
    if not known:
        return [Text(f"  {look.texts('plot.empty')}")]
    low, high = axis(ranges)
    span = duration(seen.trend.span_s)
    caption = look.texts("plot.caption", span=span, low=f"{low:.2f}", high=f"{high:.2f}")
    rows = [Text(f"  {line}", style="green") for line in plot(ranges, PLOT_ROWS, braille)]
    return [*rows, *folded(caption, look.width, first="  ")]


def planned_degC(timetable: Mapping[str, Any], t_utc_s: float | None) -> float | None:
    """Return planned temperature at a moment, degC, between the corners of the polyline; None outside of it."""
    times, values = timetable.get("t_utc_s") or [], timetable.get("temperature_degC") or []
    if t_utc_s is None or len(times) != len(values) or not times or not times[0] <= t_utc_s <= times[-1]:
        return None
    after = min(bisect_right(times, t_utc_s), len(times) - 1)
    before = max(0, after - 1)
    span = times[after] - times[before]
    share = (t_utc_s - times[before]) / span if span > 0 else 0.0
    return float(values[before] + share * (values[after] - values[before]))


def dots_across(columns: int, braille: bool) -> int:
    """Return how many values a plot of so many columns shows."""
    return columns * (2 if braille else 1)


def plot(ranges: Sequence[Range | None], rows: int, braille: bool) -> list[str]:
    """Return rows of a plot, top first; (least, greatest) per dot across, None where there was nothing.

    The axis spans all values, at least ``LEAST_SPAN``.
    """
    height = rows * (4 if braille else 1)
    low, high = axis(ranges)
    across = len(ranges) + (len(ranges) % 2 if braille else 0)
    grid = [[False] * across for _ in range(height)]
    for column, extent in enumerate(ranges):
        if extent is not None:
            top, bottom = (_row(value, low, high, height) for value in (extent[1], extent[0]))
            for row in range(top, bottom + 1):
                grid[row][column] = True
    if not braille:
        return ["".join("*" if dot else " " for dot in line) for line in grid]
    return [_cells(grid[at : at + 4]) for at in range(0, height, 4)]


def axis(ranges: Sequence[Range | None]) -> Range:
    """Return least and greatest value of the axis; (0, 1) without a value."""
    known = [extent for extent in ranges if extent is not None and all(math.isfinite(value) for value in extent)]
    if not known:
        return 0.0, 1.0
    low, high = min(least for least, _ in known), max(other for _, other in known)
    missing = max(0.0, LEAST_SPAN - (high - low)) / 2
    return low - missing, high + missing


def _row(value: float, low: float, high: float, height: int) -> int:
    """Return row of a value, 0 at the top."""
    return round((high - value) / (high - low) * (height - 1))


def _cells(lines: Sequence[Sequence[bool]]) -> str:
    cells = []
    for column in range(0, len(lines[0]), 2):
        bits = sum(_DOTS[x][y] for x in (0, 1) for y in range(4) if lines[y][column + x])
        cells.append(chr(_BRAILLE + bits) if bits else " ")
    return "".join(cells)


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
