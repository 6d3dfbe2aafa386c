"""The plan as far as it is expanded: steps with their planned times, variables resolved, mistakes noted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import PurePath
from typing import Any, NoReturn

from bench.frame import FrameDefinition
from bench.model.quantities import Values
from bench.model.units import likely
from bench.plan.findings import Draft, suggestion
from bench.plan.language import sequence as language
from bench.plan.language.steps import CallStep
from bench.plan.plan import Phase, PlannedUnit, Step
from bench.plan.station import Station, range_after
from bench.plan.values import Channel, NamedValues, Quantity, Scope, UnknownVariable, plain

Path = tuple[str | int, ...]
MAX_STEPS = 50_000
TIMED = ("npp", "ppp")  # counts whose pulses can be timed
COMMAND = "command"  # the message of a frame definition that carries commands to the unit
NO_TIME = Quantity(0.0, "s")
_WHOLE = 1e-6  # of a frame or a round
DURATION = "duration"  # its key among the origins of a step


class TooManySteps(Exception):
    """The plan grew over MAX_STEPS."""


_Set = tuple[float | None, float | None]


@dataclass(frozen=True)
class Known:
    """Knowledge of the compiler at a place of the plan.

    ``at_s``: planned time.   ``sources_A``: level and range that each source was programmed to, None if not known.
    ``settle_band_degC``: that of the last soak.
    """

    at_s: float = 0.0
    sources_A: Mapping[str, _Set] = field(default_factory=dict)
    settle_band_degC: float | None = None


class Expander(Draft[language.Sequence]):
    """State of one expansion, and what each kind of step needs to append itself."""

    def __init__(
        self,
        draft: Draft[language.Sequence],
        station: Station,
        channels: Mapping[int, Channel],
        rate_Hz: float,
        frames: Mapping[str, FrameDefinition],
    ) -> None:
        super().__init__(draft.document, draft.findings)
        self.station = station
        self.channels = channels
        self.rate_Hz = rate_Hz
        self.link = next(iter(self.model.frame), "")  # that records count; "" where they are made of readings
        counted = frames.get(self.link)  # one that cannot be read forbids nothing
        self.counts_pulses = bool(self.link) and (counted is None or counts_pulses(counted))
        self.has_samples = bool(self.link) and (counted is None or has_samples(counted))
        self.command_links = [n for n in self.model.frame if n not in frames or COMMAND in frames[n].messages]
        self.frames = frames
        self.layouts = {link: definition.commands for link, definition in frames.items()}
        self.steps: list[Step] = []
        self.phase: Phase = "prepare"
        self.known = Known()
        self.dimensions: list[dict[str, str]] = []
        self.origins: list[Mapping[str, str]] = []
        self.declared: list[Mapping[str, str]] = []
        self.doubtful: set[int] = set()
        self.retry_step: int | None = None
        self.expected = NamedValues()
        self.campaign: Values = {}  # constants of the unit, as in the manifest
        self.units: tuple[PlannedUnit, ...] = ()
        self.unit: PlannedUnit | None = None  # of the loop over the units that is expanded
        self._short = PurePath(self.document.name).name

    def add(
        self, node: Node, kind: type[Step], role: str, name: str, arguments: Values,
        duration: Quantity | None = NO_TIME, conditions: Values | None = None,
    ) -> None:  # fmt: skip
        """Append a step at the present planned time and advance it by ``duration`` (None: its mistake is noted).

        Arguments may still be Quantity or Channel objects; their dimensions, origins and places are kept for the
        static check. An argument that is None could not be read; a limit of a prompt may be left open.
        """
        if len(self.steps) >= MAX_STEPS:
            self.too_many(node)
        if self.phase == "finally" and not kind.may_end:
            message = f"a {kind.kind} step cannot stand in 'finally': only calls and a soak leave the bench in order"
            node.fail("B-PLAN-037", message)
        if duration is None:
            self.doubtful.add(len(self.steps))
        duration_s = 0.0 if duration is None else duration.value
        numbers = {key: kind.unread if value is None else plain(value) for key, value in arguments.items()}
        quantities = {k: v for k, v in arguments.items() if isinstance(v, Quantity)}
        self.dimensions.append({k: v.dimension for k, v in quantities.items()})
        origins = {k: v.origin for k, v in quantities.items() if v.origin}
        self.origins.append(
            origins if duration is None or not duration.origin else {**origins, DURATION: duration.origin}
        )
        channels = {k: v for k, v in arguments.items() if isinstance(v, Channel)}
        self.declared.append({k: self.document.where(("channels", v.group, "numbers")) for k, v in channels.items()})
        known = node.scope.context if conditions is None else conditions
        role = self.place(role, node)
        where = self._short + self.document.where(node.path).removeprefix(self.document.name)
        place = len(self.steps), self.phase, self.known.at_s, duration_s, role, name, known, where
        self.steps.append(kind.read(place, numbers))
        self.known = replace(self.known, at_s=round(self.known.at_s + duration_s, 9))

    def place(self, name: str, node: Node) -> str:
        """Return the station's name of a link or role: inside a loop over the units that of the unit's slot."""
        if self.unit is not None:
            return self.unit.links.get(name) or self.unit.roles.get(name, name)
        if any(name in unit.links or name in unit.roles for unit in self.units):
            message = f"{name} is there once for each unit, and the step does not say for which"
            node.fail("B-PLAN-141", message, "put the step inside 'for: unit', 'in: units'")
        return name

    def keep_dimensions(self, quantities: Mapping[str, Quantity], steps: int) -> None:
        """Keep the dimensions of quantities that stand inside other arguments of the newest steps."""
        for dimensions in self.dimensions[-steps:] if quantities else ():
            dimensions.update({name: value.dimension for name, value in quantities.items()})

    def too_many(self, node: Node) -> NoReturn:
        """Note that the plan grows without end, and give it up. Raises: TooManySteps."""
        node.fail("B-PLAN-036", f"the plan has more than {MAX_STEPS} steps or turns of its loops", "shorten them")
        raise TooManySteps

    def node(self, *path: str | int, variables: Values | None = None) -> Node:
        """Return a place outside of all loops, which may name these variables."""
        return Node(self, path, Scope(variables or {}, self.role_attribute, {}))

    def role_attribute(self, role: str, attribute: str) -> Any:
        """Return ``{role.range}``: the lowest range of its standard that holds the level last programmed, ampere."""
        if role not in self.station.instruments or attribute != "range":
            raise UnknownVariable(f"{{{role}.{attribute}}} is unknown{suggestion(role, self.station.instruments)}")
        if role not in self.known.sources_A:
            raise UnknownVariable(
                f"{{{role}.range}} is unknown: no level was programmed on {role} before, "
                "or not the same on every way through a decision"
            )
        level_A, found_A = self.known.sources_A[role]
        if level_A is None:
            return None
        if found_A is None:
            raise ValueError(f"no range of {role} in the station file holds {level_A:g} A")
        return Quantity(found_A, "A")

    def programmed(self, role: str, level: Any, locked: bool) -> None:
        """Follow the level and the range of a source; a level that could not be read leaves both unknown."""
        set_A: _Set = None, None
        if isinstance(level, Quantity) and level.dimension == "A":
            _, before_A = self.known.sources_A.get(role, set_A)
            set_A = level.value, range_after(self.station.ranges_A(role), level.value, locked, before_A)
        self.known = replace(self.known, sources_A={**self.known.sources_A, role: set_A})

    def begin(self, phase: Phase) -> None:
        """Begin a phase: its planned time starts at zero."""
        self.phase = phase
        self.known = replace(self.known, at_s=0.0)


@dataclass(frozen=True)
class Node:
    """A place of the sequence file as it is expanded: the plan so far, the path of the place, variables it may name."""

    plan: Expander
    path: Path
    scope: Scope

    def below(self, *keys: str | int) -> Node:
        """Return a place below this one."""
        return Node(self.plan, (*self.path, *keys), self.scope)

    def inside(self, variables: Values, context: Values | None = None) -> Node:
        """Return the same place with more variables; ``context`` adds to what identifies the position in the loops."""
        return Node(self.plan, self.path, self.scope.extended(variables, context))

    def fail(self, code: str, message: str, next_step: str = "", origin: str = "") -> None:
        """Note a mistake at this place."""
        self.plan.fail(code, self.path, message, next_step, origin)

    def resolve(self, raw: Any, *keys: str | int) -> Any:
        """Return the value of what stands under ``keys``, or None after noting the mistake (B-PLAN-030, -031)."""
        try:
            return self.scope.resolve(raw)
        except UnknownVariable as error:
            self.below(*keys).fail("B-PLAN-030", str(error))
        except ValueError as error:
            self.below(*keys).fail("B-PLAN-031", str(error))
        return None

    def values(self, arguments: Values) -> dict[str, Any]:
        """Return the values of what stands below, by key."""
        return {name: self.resolve(raw, name) for name, raw in arguments.items()}

    def called(self, call: CallStep) -> tuple[str, str, dict[str, Any]]:
        """Return role, name and arguments of a call that stands here; mistakes are noted as by ``values``."""
        ((called, arguments),) = call.root.items()
        role, name = called.split(".")
        return role, name, self.below(called).values(arguments or {})

    def quantity(self, raw: Any, dimension: str, *keys: str | int) -> Quantity | None:
        """Return a field that is already a number in the base unit, or still a reference; None after a mistake."""
        value = Quantity(raw, dimension) if isinstance(raw, float) else self.resolve(raw, *keys)
        if isinstance(value, Quantity) and value.dimension == dimension:
            return value
        if value is not None:
            shown, origin = (
                (f"in {value.dimension}", value.origin) if isinstance(value, Quantity) else (repr(plain(value)), "")
            )
            message = f"{raw} is {shown}; a quantity in {dimension} is due{likely(value, dimension)}"
            self.below(*keys).fail("B-PLAN-031", message, origin=origin)
        return None


def counts_pulses(definition: FrameDefinition) -> bool:
    """Return whether a message of these frames holds what the pulses of a record are timed by."""
    messages = definition.layout.messages
    return any({item.name for item in message.fields if item.per == "frame"}.issuperset(TIMED) for message in messages)


def has_samples(definition: FrameDefinition) -> bool:
    """Return whether a message of these frames holds samples."""
    return any(item.per == "sample" for message in definition.layout.messages for item in message.fields)


def check_whole(node: Node, seconds: Quantity, times: float, of: str) -> None:
    """Note a record that does not hold frames or rounds of readings a whole number of times, once at least."""
    if not (times >= 1 and abs(times - round(times)) <= _WHOLE):
        node.fail("B-PLAN-042", f"{seconds.value:g} s is not a whole number of {of}", origin=seconds.origin)
