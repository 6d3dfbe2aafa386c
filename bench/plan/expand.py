"""Unrolls a sequence into its flat list of steps: loops, procedures, variables, and the planned time of each step."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any, NoReturn

from bench.frame import FrameDefinition
from bench.model.yamlio import Document
from bench.plan import language, leaves
from bench.plan.channels import channel_numbers
from bench.plan.drivers import range_after
from bench.plan.findings import Findings, suggestion
from bench.plan.language_steps import ChannelPick, ForStep, ProcedureStep, TimelineEntry
from bench.plan.plan import Phase, Step, StepKind
from bench.plan.station import Station
from bench.plan.values import Channel, Quantity, Scope, UnknownVariable, named, plain, traced

Path = tuple[str | int, ...]
MAX_STEPS = 50_000
MAX_CALLS = 20
COMMAND = "command"  # the message of a frame definition that carries commands to the unit
MAY_END = ("call", "verify", "send", "unit", "soak")  # kinds of step that 'finally' may hold
REQUIRED = "required"
NO_TIME = Quantity(0.0, "s")
DURATION = "duration"  # its key among the origins of a step


class TooManySteps(Exception):
    """The plan grew over MAX_STEPS."""


class Expander:
    """State of one expansion: the steps so far, planned time, and the mistakes found."""

    def __init__(
        self,
        document: Document[language.Sequence],
        station: Station,
        channels: Mapping[int, Channel],
        rate_Hz: float,
        frames: Mapping[str, FrameDefinition],
        findings: Findings,
    ) -> None:
        self.document = document
        self.station = station
        self.channels = channels
        self.rate_Hz = rate_Hz
        link = next(iter(document.model.frame), None)
        counted = None if link is None else frames.get(link)  # one that cannot be read forbids nothing
        self.counts_pulses = link is not None and (counted is None or counts_pulses(counted))
        self.has_samples = link is not None and (counted is None or has_samples(counted))
        self.command_links = [n for n in document.model.frame if n not in frames or COMMAND in frames[n].messages]
        self.layouts = {link: definition.commands for link, definition in frames.items()}
        self.findings = findings
        self.steps: list[Step] = []
        self.phase: Phase = "prepare"
        self.at_s = 0.0
        self.levels_A: dict[str, float | None] = {}
        self.ranges_A: dict[str, float | None] = {}
        self.settle_band_degC: float | None = None
        self.dimensions: list[dict[str, str]] = []
        self.origins: list[Mapping[str, str]] = []
        self.doubtful: set[int] = set()
        self.retry_step: int | None = None
        self._calls: list[str] = []
        self._turns = 0
        self._short = PurePath(document.name).name
        self._unused = set(document.model.procedures)

    # -- what a leaf step needs ------------------------------------------------------------------------------

    def add(
        self, kind: StepKind, role: str, name: str, arguments: Mapping[str, Any], scope: Scope, path: Path,
        duration: Quantity | None = NO_TIME, conditions: Mapping[str, Any] | None = None,
    ) -> None:  # fmt: skip
        """Append a step at the present planned time and advance it by ``duration`` (None: its mistake is noted).

        Arguments may still be Quantity or Channel objects; their dimensions and origins are kept for the static
        check. An argument that is None could not be read.
        """
        if len(self.steps) >= MAX_STEPS:
            self._too_many(path)
        if self.phase == "finally" and kind not in MAY_END:
            message = f"a {kind} step cannot stand in 'finally': only calls and a soak leave the bench in order"
            self.fail("B-PLAN-037", path, message)
        if duration is None:
            self.doubtful.add(len(self.steps))
        duration_s = 0.0 if duration is None else duration.value
        numbers = {key: plain(value) for key, value in arguments.items()}
        place = self._short + self.document.where(path).removeprefix(self.document.name)
        known = scope.context if conditions is None else conditions
        step = Step(len(self.steps), self.phase, kind, self.at_s, duration_s, role, name, numbers, known, place)
        self.steps.append(step)
        quantities = {k: v for k, v in arguments.items() if isinstance(v, Quantity)}
        self.dimensions.append({k: v.dimension for k, v in quantities.items()})
        origins = {k: v.origin for k, v in quantities.items() if v.origin}
        self.origins.append(
            origins if duration is None or not duration.origin else {**origins, DURATION: duration.origin}
        )
        self.at_s = round(self.at_s + duration_s, 9)

    def keep_dimensions(self, quantities: Mapping[str, Quantity], steps: int) -> None:
        """Keep the dimensions of quantities that stand inside other arguments of the newest steps."""
        for dimensions in self.dimensions[-steps:] if quantities else ():
            dimensions.update({name: value.dimension for name, value in quantities.items()})

    def _too_many(self, path: Path) -> NoReturn:
        self.fail("B-PLAN-036", path, f"the plan has more than {MAX_STEPS} steps or turns of its loops", "shorten them")
        raise TooManySteps

    def fail(self, code: str, path: Path, message: str, next_step: str = "", origin: str = "") -> None:
        """Note a mistake at a place of the sequence file."""
        self.findings.add(code, self.document.where(path), message, next_step, origin)

    def line(self, path: Path) -> str:
        """``line N`` of a place of the sequence file."""
        return "line " + self.document.where(path).split(":")[-2]

    def resolve(self, raw: Any, scope: Scope, path: Path) -> Any:
        """Resolved value, or None after noting the mistake (B-PLAN-030, -031)."""
        try:
            return scope.resolve(raw)
        except UnknownVariable as error:
            self.fail("B-PLAN-030", path, str(error))
        except ValueError as error:
            self.fail("B-PLAN-031", path, str(error))
        return None

    def quantity(self, raw: Any, dimension: str, scope: Scope, path: Path) -> Quantity | None:
        """A field that is already a number in the base unit, or still a reference; None after noting a mistake."""
        value = Quantity(raw, dimension) if isinstance(raw, float) else self.resolve(raw, scope, path)
        if isinstance(value, Quantity) and value.dimension == dimension:
            return value
        if value is not None:
            origin = value.origin if isinstance(value, Quantity) else ""
            message = f"{raw} is {_describe(value)}; a quantity in {dimension} is due"
            self.fail("B-PLAN-031", path, message, origin=origin)
        return None

    def role_attribute(self, role: str, attribute: str) -> Any:
        """``{role.range}``: the lowest range of its standard that holds the level last programmed, ampere."""
        if role not in self.station.instruments or attribute != "range":
            raise UnknownVariable(f"{{{role}.{attribute}}} is unknown{suggestion(role, self.station.instruments)}")
        if role not in self.levels_A:
            raise UnknownVariable(f"{{{role}.range}} is unknown: no level was programmed on {role} before")
        level_A, found_A = self.levels_A[role], self.ranges_A[role]
        if level_A is None:
            return None
        if found_A is None:
            raise ValueError(f"no range of {role} in the station file holds {level_A:g} A")
        return Quantity(found_A, "A")

    def programmed(self, role: str, level: Any, locked: bool) -> None:
        """Follow the level and the range of a source; a level that could not be read leaves both unknown."""
        if not isinstance(level, Quantity) or level.dimension != "A":
            self.levels_A[role] = self.ranges_A[role] = None
            return
        ladder_A = self.station.ranges_A(role)
        self.levels_A[role] = level.value
        self.ranges_A[role] = range_after(ladder_A, level.value, locked, self.ranges_A.get(role))

    def begin(self, phase: Phase) -> None:
        """Begin a phase: its planned time starts at zero."""
        self.phase = phase
        self.at_s = 0.0

    def report_unused(self) -> None:
        """A procedure that nothing calls is a mistake: nothing in it was checked (B-PLAN-038)."""
        for name in sorted(self._unused):
            if self.findings and len(re.findall(rf"\b{name}\b", self.document.text)) > 1:
                continue  # what would have used it may be what is wrong
            self.fail("B-PLAN-038", ("procedures", name), f"procedure {name!r} is never used", "use it or remove it")

    # -- structure -------------------------------------------------------------------------------------------

    def run(self, steps: Sequence[Any], path: Path, scope: Scope) -> None:
        """Expand a list of steps."""
        for index, step in enumerate(steps):
            here = (*path, index)
            if isinstance(step, ForStep):
                self._loop(step, here, scope)
            elif isinstance(step, ProcedureStep):
                self._procedure(step, here, scope)
            else:
                leaves.expand(self, step, here, scope)

    def timeline(self, entries: Sequence[TimelineEntry], path: Path, scope: Scope) -> None:
        """Expand the flat form; the time between two entries becomes a settle step."""
        for index, entry in enumerate(entries):
            here = (*path, index)
            wait_s = round(entry.at - self.at_s, 9)
            if wait_s < 0:
                message = f"at {entry.at:g} s: what stands before ends only at {self.at_s:g} s"
                self.fail("B-PLAN-035", (*here, "at"), message, "give it a later time")
            elif wait_s > 0:
                self.add("settle", "", "", {}, scope, here, Quantity(wait_s, "s"))
            self.retry_step = len(self.steps)
            leaves.expand_entry(self, entry, here, scope)

    def _loop(self, step: ForStep, path: Path, scope: Scope) -> None:
        for index, value in enumerate(self._values(step.in_, (*path, "in"), scope)):
            self._turns += 1
            if self._turns > MAX_STEPS:
                self._too_many(path)
            if value is None:
                continue
            context = {named(step.for_, value): plain(value)}
            inner = scope.extended({step.for_: value, f"{step.for_}_index": index}, context)
            self.run(step.do, (*path, "do"), inner)

    def _values(self, raw: Any, path: Path, scope: Scope) -> Sequence[Any]:
        if isinstance(raw, ChannelPick):
            return self._pick(raw, (*path, "channels"))
        if isinstance(raw, list):
            places = [(item, (*path, index)) for index, item in enumerate(raw)]
            return [traced(self.resolve(item, scope, at), f"the list, {self.line(at)}") for item, at in places]
        if raw == "channels":
            return [self.channels[number] for number in sorted(self.channels)]
        if raw in self.document.model.tables:
            table = self.document.model.tables[raw]
            return [self._entry(raw, index, item, scope) for index, item in enumerate(table)]
        value = self.resolve(raw, scope, path)
        if isinstance(value, tuple):
            return value
        if value is not None:
            known = suggestion(raw, ["channels", *self.document.model.tables])
            self.fail("B-PLAN-032", path, f"{raw!r} is not a list to loop over{known}")
        return ()

    def _entry(self, table: str, index: int, raw: Any, scope: Scope) -> Any:
        path = ("tables", table, index)
        return traced(self.resolve(raw, scope, path), f"{table}[{index}], {self.line(path)}")

    def _pick(self, pick: ChannelPick, path: Path) -> list[Channel]:
        try:
            numbers = channel_numbers(pick.channels)
        except ValueError as error:
            self.fail("B-PLAN-020", path, str(error))
            return []
        for number in numbers:
            if number not in self.channels:
                self.fail("B-PLAN-020", path, f"channel {number} is not declared under 'channels'")
        return [self.channels[number] for number in numbers if number in self.channels]

    def _procedure(self, step: ProcedureStep, path: Path, scope: Scope) -> None:
        name, arguments = next(iter(step.root.items()))
        procedure = self.document.model.procedures.get(name)
        if procedure is None:
            known = suggestion(name, [*self.document.model.procedures, *leaves.WORDS])
            self.fail("B-PLAN-033", path, f"there is no procedure or step {name!r}{known}")
            return
        if name in self._calls or len(self._calls) >= MAX_CALLS:
            self.fail("B-PLAN-034", path, f"procedure {name!r} calls itself: {' > '.join([*self._calls, name])}")
            return
        values = self._arguments(procedure, name, arguments or {}, (*path, name), scope)
        self._unused.discard(name)
        outer, self.retry_step = self.retry_step, len(self.steps)
        self._calls.append(name)
        self.run(procedure.do, ("procedures", name, "do"), scope.extended(values))
        self._calls.pop()
        self.retry_step = outer

    def _arguments(
        self, procedure: language.Procedure, name: str, given: Mapping[str, Any], path: Path, scope: Scope
    ) -> dict[str, Any]:
        for key in given:
            if key not in procedure.arguments:
                known = suggestion(key, procedure.arguments)
                self.fail("B-PLAN-033", (*path, key), f"procedure {name!r} has no argument {key!r}{known}")
        values: dict[str, Any] = {}
        for key, default in procedure.arguments.items():
            if key not in given and default == REQUIRED:
                self.fail("B-PLAN-033", path, f"procedure {name!r} needs the argument {key!r}")
                values[key] = None
            elif key in given:
                values[key] = self._argument(key, given[key], (*path, key), scope)
            else:
                values[key] = self._argument(key, default, ("procedures", name, "arguments", key), scope)
        return values

    def _argument(self, key: str, raw: Any, path: Path, scope: Scope) -> Any:
        return traced(self.resolve(raw, scope, path), f"argument {key}, {self.line(path)}")


def counts_pulses(definition: FrameDefinition) -> bool:
    """Whether a message of these frames holds what the pulses of a record are timed by."""
    messages = definition.layout.messages
    return any({item.name for item in one.fields if item.per == "frame"}.issuperset(leaves.TIMED) for one in messages)


def has_samples(definition: FrameDefinition) -> bool:
    """Whether a message of these frames holds samples."""
    return any(item.per == "sample" for one in definition.layout.messages for item in one.fields)


def _describe(value: Any) -> str:
    return f"in {value.dimension}" if isinstance(value, Quantity) else f"{plain(value)!r}"
