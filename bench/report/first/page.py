"""The first page: identification, what is not sound, results, statements and room to sign.

Clause by clause it is held against ISO/IEC 17025:2017, 7.8.2 to 7.8.8, in docs/report.md.

What the first page says in words: uncertainty, decision rule with its risk, surroundings, traceability, limits.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date, datetime, timedelta
from typing import Any

import numpy as np

from bench.analysis import Estimate, is_sound, limits_of, limits_text, number, unit_text, with_uncertainty
from bench.maths.verdict import NON_BINARY, meaning_of
from bench.model.systems import analysis_declaration, is_size
from bench.model.texts import Texts, quantity_title, value_title
from bench.report.dcc import method_of
from bench.report.estimate_tables import conditions_text, readable
from bench.report.first.results import MEASURED, Block, shown_results
from bench.report.laboratory import Contact, Laboratory, not_covered
from bench.report.model import ReportModel
from bench.report.tables import named, role_of
from bench.report.verdict_tables import doubt_paragraphs, percent, used

_MOST_STANDARDS = 12
Statement = tuple[str, str]


def statements(
    model: ReportModel, laboratory: Laboratory | None, not_accredited: Sequence[str], words: Texts
) -> Iterator[Statement]:
    """Yield head and text of each statement, in their order. ``not_accredited``: by ``mark_refused``."""
    judged = _judged(model)
    if judged:
        yield words("first.nearest"), _nearest(model, judged, words)
    yield words("first.uncertainty"), words("first.uncertainty.text")
    yield words("first.rule"), decision(model, judged, words)
    yield words("first.method"), _method(model, words)
    yield words("first.environment"), environment(model, laboratory, words)
    yield words("first.traceability"), _traceability(model, laboratory, words)
    if laboratory is not None:
        yield from _of_the_laboratory(laboratory, not_accredited, words)
    yield words("first.validity"), words("first.validity.log" if model.of_a_log else "first.validity.text")


def _judged(model: ReportModel) -> list[Estimate]:
    return [row for row in model.rows if limits_of(row) is not None and row.verdict != "none" and is_sound(row)]


def _nearest(model: ReportModel, judged: Sequence[Estimate], words: Texts) -> str:
    """Return the judged value whose interval uses most of its limits, and how much it leaves; any beyond uses more."""
    row = max(judged, key=used)
    limits = limits_of(row)
    assert limits is not None
    scale, unit = readable([row])
    expanded = row.expanded_uncertainty or 0.0
    left = min(row.value - limits[0], limits[1] - row.value) - expanded
    probability = row.conformance_probability
    campaign = model.analysis
    where = conditions_text(words, {key: of for key, of in row.conditions.items() if key != MEASURED}, campaign)
    suffix = "" if unit == "1" else f" {unit_text(unit)}"
    return words(
        "first.nearest.text" if expanded else "first.nearest.plain",
        quantity=quantity_title(campaign, row.quantity, words.language) + (f" ({where})" if where else ""),
        value=with_uncertainty(row.value * scale, expanded * scale) + suffix,
        k=f"{row.coverage_factor:.2f}",
        limits=limits_text(limits, scale, words.all["coverage.span"], size=is_size(campaign, row.quantity)) + suffix,
        room=words(
            "first.nearest.beyond" if left < 0.0 else "first.nearest.left", size=_rounded(left * scale) + suffix
        ),
        inside="–" if probability is None else percent(probability),
        verdict=words(f"verdict.{row.verdict}"),
    )


def _rounded(size: float) -> str:
    return number(float(f"{abs(size):.3g}"))


def decision(model: ReportModel, judged: Sequence[Estimate], words: Texts) -> str:
    """Return the rule in words, and the greatest probability that one of its statements is wrong.

    Of an accepted value it is the probability that the true value is outside its limits; of a refused one, inside.
    """
    limited = any(limits_of(row) is not None for row in model.rows)
    if not judged and not limited:
        return words("first.rule.none")
    origin = words("first.rule.by.log" if model.of_a_log else "first.rule.by.sequence")
    said = [words(f"first.rule.{model.results.get('decision_rule') or NON_BINARY}", origin=origin)]
    if not judged:
        return " ".join([*said, words("first.rule.unsound")])
    with_U = [row for row in judged if row.expanded_uncertainty]
    accepted = [row for row in with_U if meaning_of(row.verdict).accepts]
    refused = [row for row in with_U if not meaning_of(row.verdict).accepts]
    for name, rows in (("accepted", accepted), ("refused", refused)):
        risks = [_risk(row) for row in rows if row.conformance_probability is not None]
        if risks:
            said.append(words(f"first.rule.{name}", count=len(risks), risk=_risk_text(max(risks))))
    if len(with_U) < len(judged):
        said.append(words("first.rule.without", count=len(judged) - len(with_U)))
    return " ".join(said)


def _risk(row: Estimate) -> float:
    inside = row.conformance_probability or 0.0
    return 1.0 - inside if meaning_of(row.verdict).accepts else inside


def _risk_text(risk: float) -> str:
    """Per cent, never rounded down to certainty."""
    if risk < 1e-4:
        return "<\u00a00.01\u00a0%"
    return f"{100.0 * risk:.2f}\u00a0%"


def _method(model: ReportModel, words: Texts) -> str:
    campaign, by = model.analysis, str(model.results.get("method", "–"))
    told = {**model.results, "method": value_title(campaign, "method", by, words.language)}
    method = method_of(told, words.language)
    parts = [named(method.description)]
    parts += [words("first.method.reference", reference=method.reference)] if method.reference else []
    quality = model.results.get("quality", {})
    counts = {name: number(quality.get(name, 0)) for name in ("splices", "retaken")}
    software = model.results.get("provenance", {}).get("software", "–")
    origin = {"sequence": model.origin.get("sequence", "–"), "software": software}
    key = "first.method.log" if model.of_a_log else "first.method.text"
    parts.append(words(key, **origin, **counts))
    return " ".join(parts)


def environment(model: ReportModel, laboratory: Laboratory | None, words: Texts) -> str:
    """Return the air of the laboratory, as measured and as the laboratory states it, chamber and unit."""
    rooms = [place.degC for place in model.run.surroundings if place.laboratory]
    spans = [("laboratory", _span(np.concatenate(rooms) if rooms else np.empty(0)))]
    spans += [("chamber", _span(model.trace.air_degC)), ("unit", _span(model.trace.unit_degC))]
    said = [words(f"first.environment.{name}", span=_degC(span, words)) for name, span in spans if span is not None]
    if laboratory is None:
        return " ".join(said) or words("first.environment.none")
    stated = laboratory.surroundings
    humidity = ""
    if stated.humidity is not None:
        low, high = (number(100.0 * value) for value in stated.humidity)
        humidity = words("first.environment.humidity", low=low, high=high)
    said.append(words("first.environment.stated", span=_degC(stated.temperature, words), humidity=humidity))
    measured = spans[0][1]
    if measured is not None and not stated.temperature[0] <= measured[0] <= measured[1] <= stated.temperature[1]:
        said.append(words("first.environment.outside"))
    return " ".join(said)


def _span(values: np.ndarray[Any, np.dtype[np.float64]]) -> tuple[float, float] | None:
    known = values[np.isfinite(values)]
    return (float(known.min()), float(known.max())) if known.size else None


def _degC(span: tuple[float, float], words: Texts) -> str:
    low, high = (number(value, 1) for value in span)
    return low if low == high else words("first.span", low=low, high=high)


def _traceability(model: ReportModel, laboratory: Laboratory | None, words: Texts) -> str:
    said = [] if laboratory is None else [laboratory.traceability]
    declared = analysis_declaration(model.analysis)
    if declared is not None and declared.bench_clock:
        said.append(words("first.traceability.bench_clock"))
    listed = [_standard(words, role, entry) for role, entry in sorted(model.standards.items())]
    if not listed:
        return " ".join([*said, words("first.traceability.none")])
    more = len(listed) - _MOST_STANDARDS
    text = "; ".join(listed[:_MOST_STANDARDS]) + (words("first.traceability.more", count=more) if more > 0 else "")
    return " ".join([*said, words("first.traceability.standards", listed=text)])


def _standard(words: Texts, role: str, entry: Mapping[str, Any]) -> str:
    by = entry.get("laboratory")
    return words(
        "first.traceability.by" if by else "first.traceability.standard",
        role=role_of(words, role),
        model=entry.get("model", "–"),
        serial=entry.get("serial", "–"),
        certificate=entry.get("certificate", "–"),
        day=entry.get("calibrated", "–"),
        by=by,
    )


def _of_the_laboratory(laboratory: Laboratory, not_accredited: Sequence[str], words: Texts) -> Iterator[Statement]:
    replaced, adjusted, following = laboratory.replaces, laboratory.adjustment, laboratory.next_calibration
    accredited = laboratory.accreditation
    if replaced is not None:
        yield words("first.replaces"), words("first.replaces.text", number=replaced.number, reason=replaced.reason)
    if adjusted is not None:
        text = words(f"first.adjustment.{adjusted.results}", what=adjusted.what)
        other = "" if adjusted.other is None else words("first.adjustment.other", number=adjusted.other)
        yield words("first.adjustment"), f"{text} {other}".strip()
    if following is not None:
        yield words("first.next"), words("first.next.text", day=following.day.isoformat())
    if laboratory.statements:
        yield words("first.laboratory.statements"), " ".join(laboratory.statements)
    if accredited is not None:
        key = "first.accreditation.none" if not_accredited else "first.accreditation.text"
        by = {"body": accredited.body, "number": accredited.number, "reasons": "; ".join(not_accredited)}
        yield words("first.accreditation"), words(key, **by)


def mark_refused(model: ReportModel, laboratory: Laboratory, shown: Sequence[Estimate], words: Texts) -> list[str]:
    """Return why the results on the page may not stand under the laboratory's accreditation; [] if they may."""
    if laboratory.accreditation is None:
        return []
    if model.simulated:
        return [words("first.accreditation.simulated")]
    if not shown:
        return [words("first.accreditation.nothing")]
    judged = _judged(model)
    rows = [*shown, *([max(judged, key=used)] if judged else [])]
    reasons = not_covered(laboratory.accreditation, model.analysis, rows)
    return [f"{quantity}: {reason}" for quantity, reason in reasons.items()]


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
