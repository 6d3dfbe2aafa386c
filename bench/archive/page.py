"""The report on a trial as one self-contained HTML page; the same trial gives the same bytes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from bench.analysis import number
from bench.archive.changes import Changes, Concerned, verdict_text
from bench.model.texts import Texts
from bench.report import Section, Table, page, words_of
from bench.store import conditions_text

FOLDER = Path(__file__).parent
_MOST_ROWS = 400
Row = tuple[str, ...]


def changes_html(report: Changes, language: str) -> str:
    """Return the page, in a language of ``texts/``."""
    words = Texts(FOLDER, language)
    title, subtitle, verdict = head_of(report, words)
    color = "bad" if report.certificates or report.flips else "none"
    sections = sections_of(report, words)
    return page(title, subtitle, sections, words_of(language), verdict=(color, verdict), simulated=report.simulated)


def head_of(report: Changes, words: Texts) -> tuple[str, str, str]:
    """Return title, subtitle and verdict."""
    return (
        words("title", sessions=report.sessions),
        words("subtitle", trial=report.trial, started=report.started_utc, software=report.software),
        words("verdict", certificates=len(report.certificates), flips=len(report.flips)),
    )


def sections_of(report: Changes, words: Texts) -> list[Section]:
    """Return what the page and the terminal say, in chapters."""
    sections = [
        _question(report, words),
        _certificates(report, words),
        _standards(report, words),
        _flips(report, words),
        _quantities(report, words),
        _failures(report, words),
    ]
    return [section for section in sections if section]


def _question(report: Changes, words: Texts) -> Section:
    selection = ", ".join(f"{name} {value}" for name, value in report.selection.items())
    rows = [
        (words("software"), ", ".join(report.released_software) or "–", report.software),
        (words("method"), words("own_method"), report.method or words("own_method")),
        (words("sessions"), "", number(report.sessions)),
        (words("selection"), "", selection or words("everything")),
    ]
    rows += [
        (words("register", standard=f"{entry['model']} {entry['serial']}"), recorded, str(entry["certificate"]))
        for recorded, entry in report.register.items()
    ]
    return _section(words, "question", (words("decided"),), ("name", "released", "now"), rows, prose=True)


def _certificates(report: Changes, words: Texts) -> Section:
    heads = ("number", "customer", "uut", "largest", "of", "changed", "flips", "method", "software", "state")
    rows = [
        (
            entry.number, entry.customer, entry.uut, _signed(entry.largest), entry.largest_of or "–",
            number(entry.changed), number(entry.flips), f"{entry.released_method} → {entry.method or '–'}",
            f"{entry.released_software} → {report.software}", _state(entry, words),
        )
        for entry in report.certificates
    ]  # fmt: skip
    said = words("said.certificates" if rows else "said.no_certificates")
    return _section(words, "certificates", (said,), heads, rows, stub=3)


def _state(entry: Concerned, words: Texts) -> str:
    said = [words("specimen")] if entry.specimen else []
    said += [words("replaced", number=other) for other in entry.replaced_by]
    return ", ".join([*said, *([entry.code] if entry.code else [])]) or words("valid")


def _standards(report: Changes, words: Texts) -> Section:
    heads = ("standard", "certificate", "since", "evidence", "check_standard")
    rows = [
        (
            f"{entry.model} {entry.serial}", entry.certificate, entry.since_utc or "–",
            f"{entry.session}, {entry.session_utc}" if entry.session else words(f"none.{entry.why}"),
            entry.check_standard or "–",
        )
        for entry in report.standards
    ]  # fmt: skip
    said = (words("said.standards"),) if rows else ()
    return _section(words, "standards", said, heads, rows, prose=True)


def _flips(report: Changes, words: Texts) -> Section:
    heads = ("session", "uut", "quantity", "conditions", "released", "now", "unit", "verdict_before", "verdict_now")
    rows = [
        (
            flip.session, flip.uut, flip.quantity, conditions_text(flip.conditions),
            _with_u(flip.released_value, flip.released_expanded_uncertainty),
            _with_u(flip.value, flip.expanded_uncertainty), flip.unit,
            verdict_text(flip.released_verdict, flip.released_quality, words("gone")),
            verdict_text(flip.verdict, flip.quality, words("gone")),
        )
        for flip in report.flips
    ]  # fmt: skip
    said = () if rows else (words("said.no_flips"),)
    return _section(words, "flips", said, heads, rows, stub=4)


def _quantities(report: Changes, words: Texts) -> Section:
    shares = ("least", "5 %", "median", "95 %", "greatest")
    heads = ("quantity", "campaign", "compared", "changed", "above_one", *shares)
    changed = [entry for entry in report.quantities if entry.changed]
    rows = [
        (
            entry.quantity, entry.campaign, number(entry.compared), number(entry.changed), number(entry.above_one),
            *(map(_signed, entry.percentiles) if entry.percentiles else ["–"] * len(shares)),
        )
        for entry in changed
    ]  # fmt: skip
    said = words("said.quantities", same=len(report.quantities) - len(changed), all=len(report.quantities))
    return _section(words, "quantities", (said,), heads, rows, stub=2)


def _failures(report: Changes, words: Texts) -> Section:
    rows = [(entry["session"], entry["code"], entry["fault"]) for entry in report.failures]
    return _section(words, "failures", (), ("session", "code", "why"), rows, prose=True)


def _section(
    words: Texts,
    name: str,
    said: tuple[str, ...],
    heads: Iterable[str],
    rows: Sequence[Row],
    *,
    stub: int = 1,
    prose: bool = False,
) -> Section:
    """Return a chapter with a table, none without rows; of many rows the first."""
    caption = words(f"table.{name}")
    if len(rows) > _MOST_ROWS:
        caption = words("table.cut", caption=caption, shown=_MOST_ROWS, all=len(rows))
    named = tuple(words.all.get(head, head) for head in heads)
    table = Table(caption, named, tuple(rows[:_MOST_ROWS]), stub=stub, prose=prose)
    return Section(name, words(f"section.{name}"), said, (table,) if rows else ())


def _signed(value: float | None) -> str:
    """Return a change in units of U to a thousandth; less is 0."""
    if value is None:
        return "–"
    return f"{value:+.3f}".replace("-", "−") if abs(value) >= 0.0005 else "0"


def _with_u(value: float | None, expanded: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:.6g}".replace("-", "−") + ("" if expanded is None else f" ± {expanded:.3g}")
