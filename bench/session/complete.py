"""What a session must say before anything is computed from it, whoever wrote it (docs/session-format.md)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from bench.analysis import Document
from bench.model.declaration import AnalysisDeclaration
from bench.model.errors import InputError, SessionDamaged
from bench.model.events import Environment, Event, Exchange, Prompt, Reading
from bench.model.systems import declared_by
from bench.record import RecordRow

_PAGE = "docs/session-format.md lists what a session needs"
_NEEDED: Mapping[type[Event], frozenset[str]] = {
    Reading: frozenset({"role", "name", "value", "conditions"}),
    Exchange: frozenset(
        {
            "step", "item", "name", "sequence", "attempts", "begin_ns", "end_ns", "status", "refused", "sent",
            "received", "conditions",
        }
    ),
    Prompt: frozenset({"step", "value", "unit", "low", "high"}),
    Environment: frozenset({"air_degC", "unit_degC"}),
}  # fmt: skip


class _Tolerant(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")


class _UnitUnderTest(_Tolerant):
    model: str
    serial: str


class _Campaign(_Tolerant):
    analysis: str
    uut: _UnitUnderTest


class _Planned(_Tolerant):
    prepare_s: float


class _Manifest(_Tolerant):
    session: str
    simulated: bool
    plan_sha256: str
    links: dict[str, str]
    measurement_link: str
    campaign: _Campaign
    planned: _Planned
    standards: dict[str, dict[str, Any]]


def check_complete(manifest: Document, rows: Iterable[RecordRow], events: Iterable[tuple[int, Event]]) -> None:
    """Refuse a session that lacks what every analysis needs, or the conditions of its own.

    Raises: InputError B-RPL-004 (manifest), B-RPL-005 (conditions of a record), B-RPL-006 (fields of its samples);
            SessionDamaged B-RPL-003 (an event).
    """
    _check_manifest(manifest)
    declared = declared_by(manifest["campaign"])
    if declared is not None:
        for row in rows:
            _check_record(declared, row)
    for t_ns, event in events:
        _check_event(t_ns, event)


def _check_manifest(manifest: Document) -> None:
    try:
        _Manifest.model_validate(manifest)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise InputError(
            "B-RPL-004",
            f"the manifest of the session is not complete: {first['msg'][:1].lower()}{first['msg'][1:]}",
            where="manifest: " + ".".join(str(part) for part in first["loc"]),
            next_step=_PAGE,
        ) from error


def _check_record(declared: AnalysisDeclaration, row: RecordRow) -> None:
    """A record that states none of the conditions is not meant for the analysis."""
    stated = row.window.conditions
    asked = declared.conditions
    if declared.conditions_of_open is not None and stated.get("route") == "open":
        asked = declared.conditions_of_open
    missing = [name for name in asked if name not in stated]
    if missing and len(missing) < len(asked):
        raise InputError(
            "B-RPL-005",
            f"the analysis {declared.name} asks for the condition {', '.join(missing)}, which the record does not have",
            where=f"record {row.window.number}",
            next_step=_PAGE,
        )
    if not missing and row.samples is not None and (lacking := set(declared.fields) - set(row.samples.columns)):
        raise InputError(
            "B-RPL-006",
            f"its frames carry no {', '.join(sorted(lacking))}, which the analysis {declared.name} reads",
            where=f"record {row.window.number}",
            next_step=_PAGE,
        )


def _check_event(t_ns: int, event: Event) -> None:
    unknown = _NEEDED.get(type(event), frozenset()).intersection(event.unknown)
    if unknown and not (isinstance(event, Prompt) and not event.quantity):
        raise SessionDamaged(
            "B-RPL-003",
            f"a {event.kind} event is not complete: {', '.join(sorted(unknown))}",
            where=f"event at {t_ns} ns",
            next_step="docs/session-format.md lists the fields of each event",
        )
