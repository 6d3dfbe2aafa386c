"""The compiled plan: one flat, numbered, hashed list of steps. A position in a run is a number in this list."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, Literal, Self

from bench.frame import FrameDefinition, parse_frame
from bench.model.errors import InputError
from bench.model.events import Event
from bench.model.ports import Actions, Drivers, Effect
from bench.model.quantities import QUANTITY, Values
from bench.plan.language.interlocks import InterlockRule
from bench.plan.language.sequence import Early
from bench.plan.station import Station

Phase = Literal["prepare", "campaign", "finally"]
Place = tuple[int, Phase, float, float, str, str, Values, str]  # values of the fields of every step
PLACE = ("number", "phase", "at_s", "duration_s", "role", "name", "conditions", "where")
KINDS: dict[str, type[Step]] = {}  # every kind of step, by its name
ROW = ("number", "phase", "kind", "at_s", "duration_s", "role", "name", "arguments", "conditions", "where")


@dataclass(frozen=True, slots=True)
class SetPoint:
    """A demand of a step on the air of the chamber."""

    temperature_degC: float
    ramp_degC_min: float


@dataclass(frozen=True, slots=True)
class Step:
    """One step of a plan: a class of its own for each kind, with its arguments (``bench.plan.step_kinds``).

    ``number`` is its index in ``Plan.steps``. ``at_s`` is its planned start inside its phase; planned time advances
    only in settle, record and soak steps (``duration_s``), all others take no planned time. ``conditions`` say under
    which loop values and set-points the step is done, with unit suffixes. What each kind holds is listed in
    docs/sequences.md. Arguments that have a default are left out of the file of a plan where they have it.

    ``on_the_bus``: it says to whom it talks, and takes time there but no planned time. ``proof``: the event that it
    always leaves, by which a recording knows that it is done. ``may_end``: it may stand in 'finally'. ``unread``: what
    stands in the place of an argument that could not be read.

    Raises: TypeError where a kind is declared that does not say what it is called (``kind``), the two above, what it
            may do to the bench (``effects``), whether it is done again once everything was made safe (``again``), what
            it leaves (``leaves``) and how a sequence has it (``written``): no kind is harmless by silence.
    """

    kind: ClassVar[str]
    on_the_bus: ClassVar[bool]
    proof: ClassVar[type[Event] | None]
    may_end: ClassVar[bool] = False
    unread: ClassVar[float | None] = math.nan

    number: int
    phase: Phase
    at_s: float
    duration_s: float
    role: str
    name: str
    conditions: Values
    where: str

    def __init_subclass__(cls) -> None:
        for question in ("kind", "on_the_bus", "proof", "effects", "again", "leaves", "written"):
            if question not in vars(cls):
                raise TypeError(f"the kind of step {cls.__name__} has no {question!r}")
        KINDS[cls.kind] = cls

    def effects(self, actions: Actions) -> frozenset[Effect]:
        """Return what the step may do to the bench; ``actions``: those of the instrument that its role names."""
        raise NotImplementedError

    def again(self, actions: Actions) -> tuple[Any, ...] | None:
        """Return order and identity of a step that is done again after everything was made safe, the last of each
        identity; None for one that is not.
        """
        raise NotImplementedError

    def leaves(self, actions: Actions) -> bool:
        """Return whether the step leaves an event that results are made of; records are looked for by their number."""
        raise NotImplementedError

    def written(self, drivers: Drivers) -> Values:
        """Return the step as a sequence has it; ``drivers``: declared actions by role.

        Raises: InputError B-RES-008 for one that cannot be done by itself.
        """
        raise NotImplementedError

    @property
    def calls(self) -> tuple[Step, ...]:
        """Return what it reads, each as a step of its own."""
        return ()

    @property
    def quantities(self) -> list[str]:
        """Return the quantities that it reads or asks for."""
        return [self.conditions[QUANTITY]] if QUANTITY in self.conditions else []

    @property
    def sets(self) -> Values:
        """Return what it has a person change on the bench, by name."""
        return {}

    @property
    def set_point(self) -> SetPoint | None:
        """Return what the step asks of the air of the chamber, None if it asks nothing."""
        return None

    def confirmed(self, actions: Actions) -> Values:
        """Return what the step, once it is done, has set and its instrument has confirmed: {"role.action": arguments},
        else empty.
        """
        return {}

    @classmethod
    def read(cls, place: Place, arguments: Values) -> Self:
        """Return a step from its arguments in a plan file and what else is in its row."""
        return cls(*place, **{_FIELDS.get(key, key): value for key, value in cls.taken(arguments).items()})

    @classmethod
    def taken(cls, arguments: Values) -> Values:
        """Return the arguments of a plan file as the step holds them."""
        return arguments

    def told(self) -> dict[str, Any]:
        """Return the arguments as they stand in a plan file."""
        values = [(own, getattr(self, own.name)) for own in fields(self)[len(PLACE) :]]
        return {_KEYS.get(own.name, own.name): value for own, value in values if value != own.default}

    def as_json(self) -> dict[str, Any]:
        """Return the row of a plan file."""
        return {name: self.told() if name == "arguments" else getattr(self, name) for name in ROW}


def no_effect(step: Step, actions: Actions) -> frozenset[Effect]:
    """Answer for a kind of step that switches nothing and moves nothing."""
    return frozenset()


def not_again(step: Step, actions: Actions) -> None:
    """Answer for a kind of step that is not done again."""


def nothing(step: Step, actions: Actions) -> bool:
    """Answer for a kind of step that leaves no event."""
    return False


def an_event(step: Step, actions: Actions) -> bool:
    """Answer for a kind of step that always leaves one."""
    return True


def cannot_be_taken_again(step: Step, why: str, goes_on: str) -> InputError:
    """Refuse to write a step by itself; ``goes_on``: with what 'bench resume' does."""
    next_step = f"'bench resume' goes on with the {goes_on}; else run the campaign again"
    return InputError("B-RES-008", why, where=step.where, next_step=next_step)


# Arguments of which the field is not called as in a plan file.
_KEYS = {
    "temperature_degC": "temperature",
    "ramp_degC_min": "ramp",
    "slot_s": "slot",
    "within_degC": "within",
    "for_s": "for",
    "hold_limit_s": "hold_limit",
    "residual_degC": "residual",
    "least_s": "least",
    "every_s": "every",
    "longest_s": "longest",
    "timeout_s": "timeout",
    "takes_s": "takes",
    "code": "command",
}
_FIELDS = {key: name for name, key in _KEYS.items()}


@dataclass(frozen=True)
class PlannedUnit:
    """One unit of a campaign that several share, in its slot of the station.

    ``links`` and ``roles``: what a sequence calls them, and what they are called for this slot; ``card`` of the switch
    matrix that leads to it; ``gradient_degC``: how far the unit may be from what its sensor says, 95 %.
    """

    slot: str
    serial: str
    links: Mapping[str, str]
    roles: Mapping[str, str]
    card: int | None = None
    gradient_degC: float | None = None

    @property
    def names(self) -> frozenset[str]:
        """Return the serial number, and the links and instruments that are the unit's alone."""
        return frozenset((self.serial, *self.links.values(), *self.roles.values()))


@dataclass(frozen=True)
class Plan:
    """A compiled sequence.

    ``duration_s`` is the campaign phase and ``prepare_s`` the preparation before it. ``texts`` holds every YAML file
    the plan was made of, by "folder/name.yaml". ``campaign`` holds the constants the analysis needs (JSON values).
    ``frames`` maps each link to the name of its frame definition; records count the frames of ``measurement_link``, or
    are made of readings where there is no link (""); ``link_bytes_s`` is what all links together send, byte per second.
    ``dimensions`` holds, per step, the base unit of each argument that was written with a unit (``bench.plan.expected``
    names those of a record's readings); ``origins`` where the argument (or the "duration") was written, if not at the
    step itself; ``declared`` the place of the channel that an argument is. ``remarks`` are mistakes that did not keep
    the plan from being made; the static check reports them with its own. ``interlocks`` are those of the station and
    of the sequence;
    ``early`` says when early verdicts are given, None for none. ``files`` says where the texts were read, by their
    names; ``settings`` are the ``--set`` values it was compiled with. ``units`` are those that share the campaign, ()
    where there is one: then ``frames`` has the links of all of them, and ``measurement_link`` is that of the first.
    """

    name: str
    title: str
    steps: tuple[Step, ...] = field(repr=False)
    duration_s: float
    prepare_s: float
    record_count: int
    sha256: str
    texts: Mapping[str, str] = field(repr=False)
    campaign: Values = field(repr=False)
    station: Station = field(repr=False)
    frames: Mapping[str, str]
    measurement_link: str
    link_bytes_s: float
    dimensions: tuple[Mapping[str, str], ...] = field(repr=False)
    origins: tuple[Mapping[str, str], ...] = field(repr=False)
    declared: tuple[Mapping[str, str], ...] = field(repr=False)
    remarks: tuple[InputError, ...] = field(repr=False)
    interlocks: tuple[InterlockRule, ...] = field(default=(), repr=False)
    early: Early | None = None
    files: Mapping[str, str] = field(default_factory=dict, repr=False)
    settings: Mapping[str, str] = field(default_factory=dict)
    units: tuple[PlannedUnit, ...] = ()

    def unit_of(self, name: object) -> PlannedUnit | None:
        """Return the unit that a link, a role or a serial number belongs to, None if it is nobody's alone."""
        return next((unit for unit in self.units if name in unit.names), None)

    @property
    def finally_s(self) -> float:
        """Planned time after the campaign, second."""
        return sum(step.duration_s for step in self.phase("finally"))

    def definitions(self) -> dict[str, FrameDefinition]:
        """Return the frame definition of each link, from the texts of the plan."""
        names = {link: f"frames/{frame}.yaml" for link, frame in self.frames.items()}
        return {link: parse_frame(self.texts[name], name) for link, name in names.items()}

    def phase(self, phase: Phase) -> tuple[Step, ...]:
        """Return steps of one phase, in order."""
        return tuple(step for step in self.steps if step.phase == phase)


Steps = Sequence[Step]


def steps_sha256(steps: Iterable[Step]) -> str:
    """Return hash of a step list: SHA-256 of its canonical JSON, positions in the YAML left out."""
    digest = hashlib.sha256()
    encode = json.JSONEncoder(sort_keys=True, separators=(",", ":"), allow_nan=False).encode
    for step in steps:
        row = [step.number, step.phase, step.kind, step.at_s, step.duration_s, step.role, step.name]
        digest.update(encode([*row, step.told(), dict(step.conditions)]).encode() + b"\n")
    return digest.hexdigest()
