"""A stopped session: its plan from its own texts, what it says of its run, and whether somebody may go on with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.model.errors import InputError, InstrumentError
from bench.model.events import (
    Answer,
    Decision,
    End,
    Environment,
    Event,
    Late,
    Prompt,
    Reading,
    Resume,
    ThermalLag,
    UnitLeftOut,
    event_of,
)
from bench.model.lab import demand, recorded_code, refuse_others
from bench.plan import Plan, PlannedSoak, frozen_plan, left_out_by
from bench.record import OPEN_MARKER, Damage, JournalEntry, SessionReader, is_being_written, layout, read_journal
from bench.run.links.unit import DONE, IDENTIFY
from bench.run.position import Resumption, last_turn, stopped_at
from bench.run.provenance import code_of
from bench.run.setpoints import expected_of

_READ = Decision | Prompt | Reading | ThermalLag | UnitLeftOut  # what a run knows by
CRASH = "crash or power cut"


def changed_files(files: Mapping[str, str], texts: Mapping[str, str]) -> dict[str, str]:
    """Return files that are not what the run was made of any more, by name: "changed" or "gone"."""
    changes = {}
    for name, path in sorted(files.items()):
        try:
            now = Path(path).read_text(encoding="utf-8")
        except (OSError, ValueError):
            changes[name] = "gone"
        else:
            if now != texts.get(name):
                changes[name] = "changed"
    return changes


@dataclass(frozen=True)
class Stopped:
    """A session whose run has stopped: everything that is whole of it but the bytes of the links.

    ``last_ns``: monotonic time of the last good message; ``last_utc_ns``: its UTC by the clock pairs of the last part,
    -1 if it has none.
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
        """End of the last part: an error code, or a crash."""
        last = last_turn(self.events)
        return str(last.error) if isinstance(last, End) else CRASH

    @property
    def unit_degC(self) -> float | None:
        """Last temperature of the unit before the stop, degC; None if none is known."""
        readings = (event.unit_degC for event in reversed(self.events) if isinstance(event, Environment))
        return next((reading for reading in readings if reading is not None), None)


def read_stopped(folder: Path) -> Stopped:
    """Read a session that is to be gone on with.

    Raises: InputError B-RES-001 (its run has ended), B-RES-002 (its run goes on in another process), B-RES-003 (no
            plan), B-REC-007 (its journal is of another version), B-REC-010; InstallationError B-LAB-007 (code of the
            lab folder is not what it was), B-LAB-004 to B-LAB-006; SessionDamaged B-RES-004, B-REC-012.
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
    code, lab = recorded_code(manifest)
    demand(code, lab)
    plan = frozen_plan(folder, manifest, reader.texts)
    refuse_others(code, code_of(plan.station, str(plan.campaign["analysis"])), lab)
    events: list[Event] = []
    last_ns, offset_ns = 0, None
    for message in reader.messages():
        last_ns = message.t_ns
        if message.topic == layout.EVENT:
            events.append(event_of(*message.event()))
            offset_ns = None if isinstance(events[-1], Resume) else offset_ns  # monotonic time may have begun anew
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
    last = last_turn(events)
    if isinstance(last, End) and last.error is None:
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
    away_s = (utc_ns - stopped.last_utc_ns) / 1e9 if known else None
    back = away_s is not None and away_s < 0.0  # a clock that lost its time with the power, most often
    event = Resume(
        reason=stopped.reason,
        start=position.start,
        stopped_mono_ns=stopped.last_ns,
        stopped_utc_ns=stopped.last_utc_ns if known else None,
        utc_ns=utc_ns,
        away_s=None if back else away_s,
        unit_degC=stopped.unit_degC,
        utc_back_s=-away_s if back and away_s is not None else None,
    )
    return Resumption(
        stopped.folder, stopped.manifest, position.start, event, position.records, position.withdrawn,
        expected_of(stopped.entries), _unit_answer(stopped), _was_settled(stopped, position.start),
        tuple(event for event in stopped.events if isinstance(event, _READ)),
    )  # fmt: skip


def _unit_answer(stopped: Stopped) -> bytes | None:
    """Return the first answer of the unit that says who it is; None if it was never asked, and of several units."""
    if stopped.plan.units:
        return None  # each must say the serial number of its slot
    answers = (event for event in stopped.events if isinstance(event, Answer) and event.name == IDENTIFY)
    return next((bytes.fromhex(answer.payload) for answer in answers if answer.status == DONE), None)


def _was_settled(stopped: Stopped, start: int) -> bool:
    """Return False if the soak before a step was left unstable; then records behind it say so until it is redone."""
    steps = stopped.plan.steps
    left_out = {number for stretch in left_out_by(steps, stopped.events) for number in stretch}
    soaks = (step.number for step in reversed(steps[:start]) if isinstance(step, PlannedSoak))
    soak = next((number for number in soaks if number not in left_out), None)
    late = (event for event in stopped.events if isinstance(event, Late))
    return not any(event.step == soak and event.policy == "skip" for event in late)


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
    for role, identity in identities.items():
        known = before.get(role)
        if known is not None and (known["model"], known["serial"]) != (identity["model"], identity["serial"]):
            raise InstrumentError(
                "B-RES-006",
                f"{identity['model']} {identity['serial']!r} answers, the session began with {known['model']} "
                f"{known['serial']!r}: records of two standards do not belong in one session",
                where=role,
                next_step="connect the instrument it began with, or 'bench recover --make-up' and a session of its own",
            )
