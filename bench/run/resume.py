"""What a stopped session says about its run, and whether somebody may go on with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.model.errors import InputError, InstrumentError
from bench.model.events import Resume
from bench.plan import Plan, PlannedSoak
from bench.record import OPEN_MARKER, Damage, JournalEntry, SessionReader, is_being_written, layout, read_journal
from bench.run.frozen import frozen_plan
from bench.run.links.unit import DONE, IDENTIFY
from bench.run.steps.position import Event, Resumption, stopped_at
from bench.run.steps.setpoints import expected_of

CRASH = "crash or power cut"


@dataclass(frozen=True)
class Stopped:
    """A session whose run has stopped: everything that is whole of it but the bytes of the links.

    ``last_ns``: monotonic time of the last good message; ``last_utc_ns``: its UTC by the clock pairs, -1 if unknown.
    ``damage``: what is not whole any more.
    """

    folder: Path
    manifest: Mapping[str, Any]
    plan: Plan
    events: list[Event]
    entries: tuple[JournalEntry, ...]
    last_ns: int
    last_utc_ns: int
    damage: tuple[Damage, ...]

    @property
    def reason(self) -> str:
        """How the last part ended: an error code, or a crash."""
        last = next((one for one in reversed(self.events) if one[0] in ("end", "resume")), None)
        return str(last[2]["error"]) if last is not None and last[0] == "end" else CRASH

    @property
    def unit_degC(self) -> float | None:
        """Last temperature of the unit before the stop, degC; None if none is known."""
        readings = (fields.get("unit_degC") for kind, _, fields in reversed(self.events) if kind == "environment")
        return next((reading for reading in readings if reading is not None), None)


def read_stopped(folder: Path) -> Stopped:
    """Read a session that is to be gone on with.

    Raises: InputError B-RES-001 (its run has ended), B-RES-002 (its run goes on in another process), B-RES-003 (no
            plan), B-REC-010; SessionDamaged B-RES-004, B-REC-012.
    """
    if is_being_written(folder):
        raise InputError(
            "B-RES-002",
            "its run goes on in another process",
            where=str(folder),
            next_step="'bench abort' ends it safely; then it can be gone on with",
        )
    reader = SessionReader(folder)
    manifest = reader.manifest
    plan = frozen_plan(folder, manifest, reader.texts)
    events: list[Event] = []
    last_ns, offset_ns = 0, None
    for message in reader.messages():
        last_ns = message.t_ns
        if message.topic == layout.EVENT:
            kind, fields = message.event()
            events.append((kind, message.t_ns, fields))
        elif message.topic == layout.CLOCK:
            pair = message.document()
            offset_ns = int(pair["t_utc_ns"]) - int(pair["t_mono_ns"])
    _has_not_ended(folder, events)
    entries, utc_ns = read_journal(folder).entries, -1 if offset_ns is None else last_ns + offset_ns
    return Stopped(folder, manifest, plan, events, entries, last_ns, utc_ns, tuple(reader.damage))


def _has_not_ended(folder: Path, events: list[Event]) -> None:
    """Every step done and the session closed is an end; a session that was not closed any more is still to be."""
    if (folder / OPEN_MARKER).exists():
        return
    last = next((one for one in reversed(events) if one[0] in ("end", "resume")), None)
    if last is not None and last[0] == "end" and last[2].get("error") is None:
        raise InputError(
            "B-RES-001",
            "its run has ended: every step was done",
            where=str(folder),
            next_step="'bench fit' prints its results, 'bench recover' lists records that are not valid",
        )


def resumption(stopped: Stopped, utc_ns: int) -> Resumption:
    """Return how the run goes on; ``utc_ns`` is the UTC of now."""
    position = stopped_at(stopped.plan, stopped.entries, stopped.events)
    known = stopped.last_utc_ns >= 0
    event = Resume(
        reason=stopped.reason,
        start=position.start,
        stopped_mono_ns=stopped.last_ns,
        stopped_utc_ns=stopped.last_utc_ns if known else None,
        utc_ns=utc_ns,
        away_s=(utc_ns - stopped.last_utc_ns) / 1e9 if known else None,
        unit_degC=stopped.unit_degC,
    )
    return Resumption(
        stopped.folder, stopped.manifest, position.start, event, position.records, position.withdrawn,
        expected_of(stopped.entries), _unit_answer(stopped.events), _was_settled(stopped, position.start),
    )  # fmt: skip


def _unit_answer(events: list[Event]) -> bytes | None:
    """The first answer of the unit that says who it is; None if it was never asked."""
    answers = (fields for kind, _, fields in events if kind == "answer" and fields.get("name") == IDENTIFY)
    return next((bytes.fromhex(str(one["payload"])) for one in answers if one.get("status") == DONE), None)


def _was_settled(stopped: Stopped, start: int) -> bool:
    """False if the soak before a step was left unstable; then records behind it say so until it is done again."""
    soak = next((step.number for step in reversed(stopped.plan.steps[:start]) if isinstance(step, PlannedSoak)), None)
    late = (fields for kind, _, fields in stopped.events if kind == "late")
    return not any(one.get("step") == soak and one.get("policy") == "skip" for one in late)


def same_plan(plan: Plan, given: Plan, where: str) -> None:
    """Raise InputError B-RES-005 unless a sequence that was named compiles to the plan of the session."""
    if given.sha256 != plan.sha256:
        raise InputError(
            "B-RES-005",
            f"compiles to another plan ({given.sha256[:12]}) than the session's ({plan.sha256[:12]})",
            where=where,
            next_step="leave --sequence out: the session's own plan is gone on with; or begin a new run",
        )


def same_instruments(manifest: Mapping[str, Any], identities: Mapping[str, Mapping[str, str]]) -> None:
    """Raise InstrumentError B-RES-006 if an instrument is not the one the session began with."""
    before = manifest.get("identities", {})
    for role, found in identities.items():
        known = before.get(role)
        if known is not None and (known["model"], known["serial"]) != (found["model"], found["serial"]):
            raise InstrumentError(
                "B-RES-006",
                f"{found['model']} {found['serial']!r} answers, the session began with {known['model']} "
                f"{known['serial']!r}: records of two standards do not belong in one session",
                where=role,
                next_step="connect the instrument it began with, or 'bench recover --make-up' and a session of its own",
            )
