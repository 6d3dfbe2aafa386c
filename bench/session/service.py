"""A recorded session read again: from its folder to records, events, results and their analysis.

The make-up sessions that complete it are read as one with it: ``bench fit SESSION --with MAKE_UP``.

What a session must say before anything is computed from it, whoever wrote it (docs/session-format.md).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from bench.analysis import Analysis, Document
from bench.model.declaration import AnalysisDeclaration
from bench.model.errors import FitError, InputError, SessionDamaged
from bench.model.events import End, Environment, Event, Exchange, Prompt, Reading, Resume, UnitLeftOut
from bench.model.lab import differing, recorded_code
from bench.model.systems import declared_by
from bench.model.yamlio import first_wrong
from bench.plan import steps_of
from bench.record import OPEN_MARKER, RecordRow, damaged
from bench.replay import IMPORT, Replayed, moved_rows, replay_rows, replay_series
from bench.session.acceptances import known_acceptances
from bench.session.record_states import condition_key, measuring, row_problem
from bench.session.register import Register, with_register
from bench.session.view import SessionView, analyse_view, happened
from bench.session.wording import say

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
        place, what = first_wrong(error)
        raise InputError(
            "B-RPL-004",
            f"the manifest of the session is not complete: {what}",
            where=f"manifest: {place}",
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


_OF_STANDARD = ("model", "serial", "certificate", "uncertainty", "corrections", "stated")
_SAME = ("analysis", "channels", "uut", "rate_Hz", "af_clock_Hz", "master_Hz", "fg_Hz")


def analysed(
    folder: Path,
    method: str | None,
    strict: bool = False,
    make_up: Sequence[Path] = (),
    register: Register | None = None,
) -> tuple[dict[str, Any], Analysis, SessionView]:
    """Return results, analysis and view of a session, together with the sessions that make up for it.

    ``register``: standards in place of recorded certificates.
    Raises: InputError B-CLI-008 if the sequence of the session asks for no analysis; those of ``read_view`` and
            ``check_complete``; SessionDamaged B-REC-011 if what is left of a damaged session gives no result.
    """
    view = with_register(read_view(folder, strict=strict), register or {})
    if make_up:
        view = merged(view, [read_view(other) for other in make_up])
    if not view.has_analysis:
        raise InputError("B-CLI-008", "the sequence of this session asks for no analysis", where=str(folder))
    check_complete(view.manifest, view.rows, view.events)
    try:
        results, analysis = analyse_view(view, method)
    except FitError as error:
        if view.damaged:
            raise damaged(folder, view.damage, f"; what is left gives no result: {error.message}") from error
        raise
    return results, analysis, view


def read_view(folder: Path, strict: bool = False, *, of_several: bool = False) -> SessionView:
    """Return a session as its folder holds it; damage is listed, unless ``strict`` (then SessionDamaged).

    ``of_several``: read one that several units share, too: what happened, without records.
    Raises: InputError B-RPL-007 as of ``replay_rows``, InstallationError B-LAB-007 if its analysis is of a lab folder,
            and not here.
    """
    replayed = replay_rows(folder, strict=strict, of_several=of_several)
    notes = [*replayed.notes]
    notes += [say("segment.no_end", name=name) for name in replayed.unfinished]
    acceptances, not_of_it = known_acceptances(folder, replayed.session_sha256)
    notes += not_of_it
    notes += _other_code(replayed.manifest)
    out = [event.sentence for _, event in replayed.events if isinstance(event, UnitLeftOut)]
    notes += out
    series: Mapping[str, NDArray[np.float64]] = {}
    if replayed.manifest.get("kind") == IMPORT:
        imported = replay_series(folder)
        series = imported.columns
        notes += imported.notes
    return SessionView(
        manifest=replayed.manifest,
        rows=replayed.measurement_rows,
        counts=replayed.totals,
        session_sha256=replayed.session_sha256,
        plan_steps=steps_of(replayed.texts.get("plan.json", "[]")),
        events=happened(replayed.events),
        notes=notes,
        damage=replayed.damage,
        series=series,
        splices=replayed.splices,
        incomplete=bool(out) or _is_incomplete(folder, replayed),
        utc_offset_ns=replayed.utc_offset_ns,
        texts=replayed.texts,
        acceptances=acceptances,
    )


def _other_code(manifest: Document) -> list[str]:
    """Return a sentence if a lab's analysis has changed since. Raises: InstallationError B-LAB-007 if it is gone."""
    code, lab = recorded_code(manifest)
    sentence = differing(code, str(manifest.get("campaign", {}).get("analysis", "none")), lab)
    return [sentence] if sentence else []


def _is_incomplete(folder: Path, replayed: Replayed) -> bool:
    """The run goes on, was stopped, or its last segment has no end; other software may write no "end" event."""
    last = next((event for _, event in reversed(replayed.events) if isinstance(event, End | Resume)), None)
    stopped = isinstance(last, Resume) or (last is not None and (last.error is not None or last.steps < 0))
    newest = max(path.name for path in folder.glob("session.*.mcap"))
    return stopped or newest in replayed.unfinished or (folder / OPEN_MARKER).exists()


def merged(view: SessionView, others: Sequence[SessionView]) -> SessionView:
    """Return one view of several sessions of one unit; times of the later ones are placed by UTC, behind the first.

    It is complete when every planned record is valid in one of them. The notes name the overlap.
    Raises: InputError B-RES-010 if a session is of another unit, analysis or set of channels, or of other standards.
    """
    records = measuring(view.plan_steps)
    if not records or any(record.samples for record in records):
        raise InputError(
            "B-RES-010",
            "its results do not come from records that are made up one by one",
            where=str(view.manifest["session"]),
            next_step="'bench resume' goes on with it; else run the campaign again",
        )
    for other in others:
        _compatible(view, other)
        view = _joined(view, other)
    valid = {condition_key(row.window.conditions) for row in view.rows if not row_problem(row)}
    planned = {condition_key(record.conditions) for record in records}
    return replace(view, incomplete=bool(planned - valid))


def _compatible(view: SessionView, other: SessionView) -> None:
    first, second = view.manifest["campaign"], other.manifest["campaign"]
    differing = [name for name in _SAME if first.get(name) != second.get(name)]
    if _standards(view) != _standards(other):  # one register is used for all records, and another one is not true
        differing.append("standards")
    if view.manifest.get("simulated") != other.manifest.get("simulated"):
        differing.append("simulated")
    if differing:
        raise InputError(
            "B-RES-010",
            f"differs from {view.manifest['session']} in {', '.join(differing)}",
            where=str(other.manifest["session"]),
            next_step="name a session that a make-up sequence of the first one gave",
        )


def _standards(view: SessionView) -> dict[str, dict[str, Any]]:
    """Return what the values and uncertainties of the standards rest on, by role."""
    register = view.manifest.get("standards", {})
    return {role: {name: standard.get(name) for name in _OF_STANDARD} for role, standard in register.items()}


def _joined(view: SessionView, other: SessionView) -> SessionView:
    shift_ns = _shift_ns(view, other)
    highest = max((row.window.number for row in view.rows), default=0)
    later = [replace(row, window=replace(row.window, number=row.window.number + highest)) for row in other.rows]
    rows = moved_rows([*((0, row) for row in view.rows), *((1, row) for row in later)], [0, shift_ns])
    notes = [f"Completed by the session {other.manifest['session']} of {len(other.rows)} records."]
    return replace(
        view,
        rows=rows,
        counts={name: count + other.counts.get(name, 0) for name, count in view.counts.items()},
        events=[*view.events, *((t_ns + shift_ns, event) for t_ns, event in other.events)],
        notes=[*view.notes, *other.notes, *notes, *_overlap_notes(view.rows, other.rows)],
        damage=(*view.damage, *other.damage),
        make_up=(*view.make_up, other.session_sha256),
    )


def _shift_ns(view: SessionView, other: SessionView) -> int:
    """By the UTC of both; two rehearsals begin at one UTC, so never before the end of the first."""
    end_ns = max((t_ns for t_ns, _ in view.events), default=0)
    start_ns = min((t_ns for t_ns, _ in other.events), default=0)
    by_utc = 0
    if view.utc_offset_ns is not None and other.utc_offset_ns is not None:
        by_utc = other.utc_offset_ns - view.utc_offset_ns
    return max(by_utc, end_ns - start_ns)


def _overlap_notes(rows: Iterable[RecordRow], again: Iterable[RecordRow]) -> list[str]:
    known = {condition_key(row.window.conditions): row for row in rows if not row_problem(row)}
    said = []
    for row in again:
        before = known.get(condition_key(row.window.conditions))
        if before is not None and not row_problem(row) and (change_ppm := _change_ppm(before, row)) is not None:
            said.append(f"Overlap, {_place(row.window.conditions)}: {change_ppm:+.2f} ppm in the make-up session.")
    return said


def _change_ppm(before: RecordRow, after: RecordRow) -> float | None:
    """Return relative change of the net pulse rate of a point, ppm; None without a current."""
    channel = before.window.conditions.get("channel")
    if channel is None or not before.window.link or not before.window.conditions.get("current_A"):
        return None
    rates = []
    for row in (before, after):
        net = int(row.sums["npp"][channel - 1]) - int(row.sums["ppp"][channel - 1])
        rates.append(net / int(row.sums["master_count"]))
    return (rates[1] / rates[0] - 1.0) * 1e6 if rates[0] else None


def _place(conditions: Mapping[str, Any]) -> str:
    sign = "-" if conditions.get("polarity", 1) < 0 else "+"
    level = f"{sign}{conditions['current_A']:g} A"
    return f"channel {conditions['channel']} at {conditions.get('temperature_degC', float('nan')):g} degC, {level}"
