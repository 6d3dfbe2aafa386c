"""The session of one unit out of one that several shared: what a campaign of that unit alone would have recorded.

Its links and instruments have the names of the data sheet, its records and steps are counted by themselves, and nothing
of another unit is in it: no byte of its links, no command to its supply, no event, no serial number. What the bench did
for all of them stays. The copy is a session of its own with its own hash chain, and says of which one it is part; the
same bytes come out whenever it is made. Everything that reads a session reads it, and knows nothing of slots.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from bench.model.clock import NS
from bench.model.errors import InputError
from bench.model.lab import folder_name
from bench.model.quantities import Values
from bench.model.yamlio import parse_yaml
from bench.plan import UNIT, Plan, PlannedRecord, StationFile, Step, plan_json, steps_of, steps_sha256
from bench.record import OPEN_MARKER, SessionReader, SessionWriter, layout
from bench.session.output import UNITS as RESULTS_OF_UNITS

UNITS = "units"  # section of the manifest of a session that several units share
PART_OF = "part_of"  # section of the manifest of the session of one of them
PLAN = "plan.json"
OTHER = "(another unit)"
_SEQUENCES, _STATIONS = "sequences/", "stations/"
_PROSE = ("text", "reason", "how", "differences")
_PLACES = ("link", "role", "of", "where")


def serials_of(manifest: Values) -> list[str]:
    """Return the serial numbers of the units that share a session, [] for a session of one unit."""
    return [str(unit["serial"]) for unit in manifest.get(UNITS, ())]


@contextmanager
def session_of_unit(folder: Path, serial: str) -> Iterator[Path]:
    """Give the session of one unit in the folder of its results; its segments are gone behind the block.

    Raises: see ``extract``.
    """
    home = folder / RESULTS_OF_UNITS / folder_name(serial)
    try:
        _without_segments(home)  # of a process that was killed
        extract(folder, serial, home)
        yield home
    finally:
        _without_segments(home)


def _without_segments(folder: Path) -> None:
    for path in [*folder.glob("session.*.mcap"), folder / OPEN_MARKER]:
        path.unlink(missing_ok=True)


def extract(folder: Path, serial: str, target: Path) -> str:
    """Write the session of one unit into a new folder; returns its SHA-256.

    Raises: InputError B-CLI-014 (the session has no such unit, or the folder holds another one); SessionDamaged.
    """
    reader = SessionReader(folder)
    manifest = reader.manifest
    units = manifest.get(UNITS, [])
    own = next((unit for unit in units if unit["serial"] == serial), None)
    if own is None:
        known = ", ".join(serials_of(manifest)) or "the one of its data sheet"
        message = f"the session has no unit {serial!r}; its units: {known}"
        raise InputError("B-CLI-014", message, where=str(folder), next_step="name one of them with --unit")
    if any(target.glob("session.*.mcap")):
        message = "the folder holds a session already"
        raise InputError("B-CLI-014", message, where=str(target), next_step="name a new folder with --out")
    others = [unit for unit in units if unit is not own]
    steps = steps_of(reader.texts[PLAN], str(folder))
    part = _Part(own, others, steps, _of_empty_slots(reader.texts, {unit["slot"] for unit in units}))
    texts = {name: text for name, text in reader.texts.items() if not name.startswith(_SEQUENCES)}
    texts[PLAN] = plan_json(part.steps)
    return _copied(reader, part, part.manifest(manifest, reader.sha256), texts, target)


def plan_of_unit(plan: Plan, serial: str) -> Plan:
    """Return the plan of one of the units alone, as its own session holds it."""
    units = [asdict(unit) for unit in plan.units]
    (own,) = (unit for unit in units if unit["serial"] == serial)
    part = _Part(own, [unit for unit in units if unit is not own], plan.steps)
    return replace(plan, steps=part.steps, campaign=part.campaign(plan.campaign), units=())


def _of_empty_slots(texts: Mapping[str, str], used: Collection[str]) -> set[str]:
    """Return links and instruments of slots that no unit sits in."""
    name = next(name for name in texts if name.startswith(_STATIONS))
    slots = parse_yaml(texts[name], name, StationFile).model.slots
    empty = [slot for letter, slot in slots.items() if letter not in used]
    return {own for slot in empty for own in (*slot.links.values(), *slot.roles.values())}


def _copied(reader: SessionReader, part: _Part, manifest: Values, texts: Mapping[str, str], target: Path) -> str:
    """Write the messages of one unit, a chunk for each second and a segment for each hour as the recorder does."""
    writer: SessionWriter | None = None
    closed, second = "not closed", 0
    for message in reader.messages():
        if writer is None:
            writer = SessionWriter.create(target, manifest, texts, t_mono_ns=message.t_ns)
            second = message.t_ns // NS
        if message.t_ns // NS != second:
            second = message.t_ns // NS
            writer.tick(second * NS)
        if message.topic == layout.EVENT:
            kind, fields = message.event()
            closed = str(fields.get("reason")) if kind == "closed" else closed
        part.write(message, writer)
    assert writer is not None, "a session has a manifest"
    return writer.close(closed)


@dataclass
class _Part:
    """What belongs to one unit, and what it is called and counted there."""

    own: Values
    others: Sequence[Values]
    all_steps: Sequence[Step]
    unused: Collection[str] = ()
    steps: tuple[Step, ...] = ()
    _step_of: dict[int, int] = field(default_factory=dict)  # number in the whole plan: number here
    _record_of: dict[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.names = {name: called for called, name in (*self.own["links"].items(), *self.own["roles"].items())}
        self.foreign = {name for unit in self.others for name in (*unit["links"].values(), *unit["roles"].values())}
        self.foreign |= {unit["serial"] for unit in self.others} | set(self.unused)
        serials = sorted((re.escape(unit["serial"]) for unit in self.others), key=len, reverse=True)
        self._serials = re.compile(rf"(?<![\w.-])({'|'.join(serials) or '(?!)'})(?![\w-])")
        kept = [step for step in self.all_steps if step.conditions.get(UNIT, self.own["serial"]) == self.own["serial"]]
        self._step_of = {step.number: number for number, step in enumerate(kept)}
        self.steps = tuple(map(self._step, kept))

    def _step(self, step: Step) -> Step:
        here = {"number": self._step_of[step.number], "role": self.names.get(step.role, step.role)}
        moved = replace(step, conditions=self._conditions(step.conditions), **here)
        if isinstance(moved, PlannedRecord):
            moved = replace(moved, together=False, retry_step=self._at_or_behind(moved.retry_step))
        return moved

    def _conditions(self, conditions: Values) -> dict[str, Any]:
        return {name: value for name, value in conditions.items() if name != UNIT}

    @property
    def _newest(self) -> int:
        """Number of the newest record of the unit that counts."""
        return max(self._record_of.values(), default=0)

    def _at_or_behind(self, step: int) -> int:
        """Return the number here of a step of the whole plan, or of the first behind it that is kept."""
        return next((self._step_of[number] for number in range(step, len(self.all_steps)) if number in self._step_of),
                    len(self._step_of))  # fmt: skip

    def campaign(self, whole: Values) -> dict[str, Any]:
        """Return the section "campaign" of the unit alone."""
        campaign = {**whole, "uut": {**whole["uut"], "serial": self.own["serial"]}}
        gradient_degC = self.own.get("gradient_degC")
        return campaign if gradient_degC is None else {**campaign, "gradient_degC": gradient_degC}

    def manifest(self, whole: Values, session_sha256: str) -> dict[str, Any]:
        """Return the manifest of the session of the unit."""
        serial, lot = self.own["serial"], str(whole["campaign"]["uut"]["serial"])
        links = {self.names[link]: frame for link, frame in whole["links"].items() if link in self.names}
        planned = {"records": sum(isinstance(s, PlannedRecord) and s.phase == "campaign" for s in self.steps),
                   "steps": len(self.steps)}  # fmt: skip
        settings = {k: v for k, v in whole.get("settings", {}).items() if not self._serials.search(v)}
        part_of = {"session_sha256": session_sha256, "slot": self.own["slot"], "units": len(self.others) + 1}
        return {
            **{key: value for key, value in whole.items() if key != UNITS},
            "session": f"{str(whole['session']).removesuffix(lot)}{folder_name(serial)}",
            "campaign": self.campaign(whole["campaign"]),
            "settings": settings,
            "standards": self._by_name(whole["standards"]),
            "identities": self._by_name(whole.get("identities", {})),
            "links": links,
            "measurement_link": self.names[next(iter(self.own["links"].values()))],
            "frame_sha256": self._by_name(whole.get("frame_sha256", {})),
            "plan_sha256": steps_sha256(self.steps),
            "planned": {**whole["planned"], **planned},
            PART_OF: part_of,
        }

    def _by_name(self, entries: Values) -> dict[str, Any]:
        return {self.names.get(name, name): entry for name, entry in entries.items() if name not in self.foreign}

    def write(self, message: layout.Message, writer: SessionWriter) -> None:
        """Write a message as it stands in the session of the unit, if it does."""
        topic, t_ns = message.topic, message.t_ns
        if topic.startswith("/link/"):
            _, _, link, direction = topic.split("/")
            if link in self.names:
                writer.raw(self.names[link], direction, t_ns, bytes(message.payload))
        elif topic.startswith(layout.INSTRUMENT):
            role, said = topic.removeprefix(layout.INSTRUMENT), message.document()
            if role not in self.foreign:
                writer.command(self.names.get(role, role), said["direction"], said["text"], t_ns)
        elif topic == layout.CLOCK:
            pair = message.document()
            writer.clock_pair(int(pair["t_mono_ns"]), int(pair["t_utc_ns"]))
        elif topic == layout.EVENT:
            kind, fields = message.event()
            told = self._event(kind, fields)
            if told is not None and kind != "closed":
                writer.event(kind, t_ns, told)

    def _event(self, kind: str, fields: Values) -> dict[str, Any] | None:
        """Return the fields of an event as the unit's session has it, None if it is of another unit."""
        if self._is_foreign(fields) or (kind == "environment" and "uut" not in fields):  # of the hottest of all
            return None
        told = {name: self._redacted(value) if name in _PROSE else value for name, value in fields.items()}
        told |= {name: self.names[told[name]] for name in _PLACES if told.get(name) in self.names}
        if kind != "unit_left_out":
            told.pop("uut", None)
        if "conditions" in told and told["conditions"] is not None:
            told["conditions"] = self._conditions(told["conditions"])
        if "identities" in told:
            told["identities"] = self._by_name(told["identities"])
        return self._counted(kind, told)

    def _is_foreign(self, fields: Values) -> bool:
        """Return whether an event is of another unit: by its unit, its link or instrument, or the step it was in."""
        if (fields.get("conditions") or {}).get(UNIT) in self.foreign or fields.get("uut") in self.foreign:
            return True
        if any(fields.get(name) in self.foreign for name in _PLACES if isinstance(fields.get(name), str)):
            return True
        step = fields.get("step")
        return isinstance(step, int) and 0 <= step < len(self.all_steps) and step not in self._step_of

    def _redacted(self, said: Any) -> Any:
        """Return prose without the serial numbers of the others."""
        if isinstance(said, list):
            return [self._redacted(line) for line in said]
        return self._serials.sub(OTHER, said) if isinstance(said, str) else said

    def _counted(self, kind: str, told: dict[str, Any]) -> dict[str, Any] | None:
        """Return an event with its steps and records counted as in the session of the unit."""
        if isinstance(told.get("step"), int):
            told["step"] = self._step_of.get(told["step"], told["step"])
        if kind == "record":
            told["number"] = self._record_of.setdefault(told["number"], self._newest + 1)
        elif kind == "gap":  # of the record that begins
            told["record"] = self._newest + 1
        elif kind == "retake":
            if told["record"] not in self._record_of:
                return None
            told["record"] = self._record_of.pop(told["record"])
        elif kind == "skip":
            told |= {"first": self._at_or_behind(told["first"]), "stop": self._at_or_behind(told["stop"])}
            if told["first"] == told["stop"]:
                return None
        elif kind == "resume" and told.get("start") is not None:
            told["start"] = self._at_or_behind(told["start"])
        elif kind == "end":
            told |= {"steps": self._at_or_behind(told["steps"]), "records": self._newest}
        return told
