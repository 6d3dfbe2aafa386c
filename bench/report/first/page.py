"""The first page: identification, what is not sound, results, statements and room to sign.

Clause by clause it is held against ISO/IEC 17025:2017, 7.8.2 to 7.8.8, in docs/report.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import date, datetime, timedelta

from bench.model.systems import analysis_declaration
from bench.model.texts import Texts
from bench.report.first.results import Block, shown_results
from bench.report.first.statements import Statement, mark_refused, statements
from bench.report.laboratory import Contact, Laboratory
from bench.report.model import ReportModel
from bench.report.verdict_tables import doubt_paragraphs

_ROLES = ("prepared", "checked", "approved")


@dataclass(frozen=True)
class FirstPage:
    """``number`` stands on every page, ``end`` behind the last; ``entries`` are pairs of name and value.

    ``not_accredited``: why no mark of the accreditation that the laboratory states stands on it.
    ``results``: small tables, ``notes`` below them.   ``statements``: pairs of head and text.
    ``signing``: what a signature means.   ``signatures``: who signs, "" for anybody.
    """

    title: str
    subject: str
    number: str
    end: str
    entries: tuple[tuple[str, str], ...]
    doubt: tuple[str, ...]
    results: tuple[Block, ...]
    notes: tuple[str, ...]
    statements: tuple[Statement, ...]
    signing: str
    signatures: tuple[tuple[str, str], ...]
    not_accredited: tuple[str, ...] = ()


def first_page(model: ReportModel, laboratory: Laboratory | None, words: Texts) -> FirstPage:
    """Return the first page of a report; without a laboratory it says what nobody stated."""
    session = str(model.results.get("session", ""))
    number = session if laboratory is None else laboratory.number_of(session)
    shown = shown_results(model, words)
    refused = [] if laboratory is None else mark_refused(model, laboratory, shown.rows, words)
    return FirstPage(
        title=_title(model, laboratory, words),
        subject=model.subject(words.language),
        number=number,
        end=words("first.end", number=number),
        entries=tuple(_entries(model, laboratory, words)),
        doubt=doubt_paragraphs(model, words),
        results=shown.blocks,
        notes=shown.notes,
        statements=tuple(statements(model, laboratory, refused, words)),
        signing=words("signature.watermarked" if model.simulated else "signature.table"),
        signatures=_signatures(laboratory, words),
        not_accredited=tuple(refused),
    )


def _title(model: ReportModel, laboratory: Laboratory | None, words: Texts) -> str:
    if laboratory is None:
        return words("first.title.report")
    kind = "test" if _is_test(model) else "calibration"
    return words(f"first.title.{kind}.specimen" if model.simulated else f"first.title.{kind}")


def _is_test(model: ReportModel) -> bool:
    """Return True for a test (ISO/IEC 17025 7.8.3): items that pass or fail, where a calibration gives values."""
    declared = analysis_declaration(model.analysis)
    return declared is not None and declared.made_of == "tests"


def _entries(model: ReportModel, laboratory: Laboratory | None, words: Texts) -> Iterator[tuple[str, str]]:
    """Yield what a reader looks for first, in pairs that stand side by side."""
    uut = model.results.get("uut", {})
    unit = words("summary.unit", model=uut.get("model", "–"), serial=uut.get("serial", "–"))
    values = dict.fromkeys(("customer", "state", "place", "received", "issued", "order"), words("first.not_stated"))
    values |= {"laboratory": words("first.give_laboratory"), "item": unit}
    performed = "tested" if _is_test(model) else "performed"
    values[performed] = _days(model, words)
    if laboratory is not None:
        values |= {name: value for name, value in _stated(laboratory, unit, words).items() if value}
    for name in ("laboratory", "customer", "item", "state", "place", "order", "received", performed, "issued"):
        yield words(f"first.{name}"), values[name]
    yield words("first.recording"), str(model.results.get("session", ""))


def _stated(laboratory: Laboratory, unit: str, words: Texts) -> dict[str, str]:
    own, item = laboratory.laboratory, laboratory.item
    named = [item.name, item.manufacturer, unit]
    named += [words("first.customer_number", number=item.customer_number)] if item.customer_number else []
    return {
        "laboratory": _contact(own) + (f"; {own.code}" if own.code else ""),
        "customer": _contact(laboratory.customer),
        "item": ", ".join(part for part in named if part),
        "state": item.state or "",
        "place": words(f"first.place.{laboratory.location}"),
        "order": laboratory.order or "",
        "received": laboratory.received.isoformat() if laboratory.received else "",
        "issued": laboratory.issued.isoformat() if laboratory.issued else "",
    }


def _contact(contact: Contact) -> str:
    street = " ".join(part for part in (contact.street, contact.street_number) if part)
    city = " ".join(part for part in (contact.post_code, contact.city) if part)
    parts = (contact.name, street, city, contact.country, contact.e_mail, contact.phone)
    return ", ".join(part for part in parts if part)


def days_of(model: ReportModel) -> tuple[date, date] | None:
    """Return first and last day (UTC) of the measurement: by the name of the session, and how long was recorded."""
    if not model.started_utc:
        return None
    began = datetime.fromisoformat(model.started_utc)
    length_s = next(filter(math.isfinite, (model.run.length_s, model.run.log_s)), 0.0)
    return began.date(), (began + timedelta(seconds=length_s)).date()


def _days(model: ReportModel, words: Texts) -> str:
    days = days_of(model)
    if days is None:
        return words("first.unknown")
    began, ended = days
    return str(began) if began == ended else words("first.span", low=began, high=ended)


def _signatures(laboratory: Laboratory | None, words: Texts) -> tuple[tuple[str, str], ...]:
    """Return role and name of each who signs; without a laboratory the roles alone."""
    if laboratory is None:
        return tuple((words(f"signature.{role}"), "") for role in _ROLES)
    return tuple(
        (person.role or words("first.signs"), person.name) for person in laboratory.responsible if person.signs
    )
