"""From a sequence file, the station it is for, and the values of ``--set`` to a Plan.

All mistakes are to be shown at once: one in one file must not hide those in the other, and a wrong unit at one end of a
file not a wrong name at the other. So files that hold other mistakes, and cannot be compiled, are still searched for
misspelt instruments, actions and drivers.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import Any, TypeVar

from pydantic import RootModel

from bench.frame import FrameDefinition, load_frame
from bench.model.errors import InputError, InputErrors
from bench.model.lab import find_beside, find_shipped
from bench.model.quantities import Values
from bench.model.units import likely, read_quantity
from bench.model.yamlio import Document, load_yaml
from bench.plan.channels import (
    campaign_channels,
    check_counted,
    check_declared,
    declared_channels,
    planned_units,
    rules_of_units,
    unit_constants,
)
from bench.plan.check.actions import with_bus_time
from bench.plan.check.analysis import check_limits, check_named
from bench.plan.check.everything import NO_SERIAL, SERIAL, check_steps, short
from bench.plan.check.stations import check_station, plan_rules
from bench.plan.deciding import is_other_length
from bench.plan.expand import Expander, Node, TooManySteps
from bench.plan.expected import check_judged, fits_of
from bench.plan.findings import Draft, Findings, suggestion
from bench.plan.language.sequence import Sequence, language_of_sequence
from bench.plan.language.steps import Step_
from bench.plan.plan import Phase, Plan, Step, steps_sha256
from bench.plan.station import Station, driver_actions, load_station
from bench.plan.step_kinds import PlannedRecord
from bench.plan.unroll import Unroller
from bench.plan.values import ACTION_PATTERN, plain, traced

WORLD = "world."
_T = TypeVar("_T")
Place = tuple[str | int, ...]
SECTIONS = ("prepare", "steps", "timeline", "finally", "procedures")
_ACTION = re.compile(ACTION_PATTERN)
_NAMING = ("call", "verify")  # keys whose value may be an action


def split_overrides(
    document: Document[Sequence], overrides: Mapping[str, str], findings: Findings
) -> tuple[dict[str, str], dict[str, str]]:
    """Return parameters of the sequence, and options of the simulated world.

    A key that the sequence has no parameter for is left out and noted (B-PLAN-003), naming the known ones.
    """
    known = document.model.parameters
    for key in overrides:
        if not key.startswith(WORLD) and key not in known:
            meant = suggestion(key, [*known, "world.<option>"])
            findings.add("B-PLAN-003", f"--set {key}", f"{document.name} has no parameter {key!r}{meant}")
    parameters = {key: value for key, value in overrides.items() if key in known}
    world = {key.removeprefix(WORLD): value for key, value in overrides.items() if key.startswith(WORLD)}
    return parameters, world


def apply_parameters(document: Document[Sequence], given: Mapping[str, str], findings: Findings) -> dict[str, Any]:
    """Return parameters of the sequence with the given ones in place; each must be of the sort of the one it replaces.

    A list is given with commas, an empty one by nothing. One of another sort is noted (B-PLAN-005) and the shipped
    value stays.
    """
    parameters: dict[str, Any] = dict(document.model.parameters)
    for key, text in given.items():
        shipped = parameters[key]
        try:
            many = isinstance(shipped, list)
            parts = text.split(",") if many and text else []
            parameters[key] = [_like(shipped[0], part) for part in parts] if many else _like(shipped, text)
        except (ValueError, IndexError) as error:
            findings.add("B-PLAN-005", f"--set {key}", f"{text!r} cannot replace {shipped!r}: {error}")
    return parameters


def _like(shipped: Any, text: str) -> Any:
    text = text.strip()
    if isinstance(shipped, bool):
        if text not in ("true", "false"):
            raise ValueError("true or false is due")
        return text == "true"
    if isinstance(shipped, (int, float)):
        return _number_like(shipped, text)
    old, new = read_quantity(str(shipped)), read_quantity(text)
    if (old and old[1]) != (new and new[1]):
        raise ValueError(
            f"a quantity in {old[1]} is due{likely(text, old[1])}" if old else "a text without a unit is due"
        )
    return text


def _number_like(shipped: float, text: str) -> float:
    due = "a whole number is due" if isinstance(shipped, int) else "a number is due"
    try:
        number = type(shipped)(text)
    except (ValueError, OverflowError):
        raise ValueError(due) from None
    if not math.isfinite(number):
        raise ValueError(due)
    return number


def load_both(source: Path, station: Station | None) -> tuple[Document[Sequence], Station]:
    """Return the sequence, and the station given or else the one it names.

    Raises: InputErrors with the mistakes of both files; if one of them cannot be compiled, the names in it are still
    looked at.
    """
    findings = Findings()
    document = _read(lambda: load_yaml(source, language_of_sequence), findings)
    file = None if station is not None else _station_file(source, document, findings)
    if file is not None:
        station = _read(lambda: load_station(file), findings)
    if document is not None and station is not None:
        return document, station
    if station is not None:
        check_station(station, findings)
        drivers = {role: entry.driver for role, entry in station.instruments.items()}
    else:
        bench = None if file is None else plain_tree(file)
        drivers = {} if bench is None else driver_names(bench, findings)
    tree = plain_tree(source)
    if tree is not None and drivers:
        check_names(tree, drivers, findings)
    raise InputErrors(findings.sorted())


def _read(load: Callable[[], _T], findings: Findings) -> _T | None:
    try:
        return load()
    except InputError as error:
        findings.extend(error)
        return None


def _station_file(source: Path, document: Document[Sequence] | None, findings: Findings) -> Path | None:
    """Return file of the station that a sequence names, even if the rest of the sequence cannot be read."""
    place = document if document is not None else plain_tree(source)
    if document is not None:
        name: object = document.model.station
    else:
        root = None if place is None else place.model.root  # type: ignore[union-attr]
        name = root.get("station") if isinstance(root, dict) else None
    if place is None or not isinstance(name, str):
        return None
    try:
        return find_beside(source, "stations", name)
    except InputError as error:
        findings.add("B-PLAN-045", place.where(("station",)), error.message, error.next_step)
        return None


def plain_tree(path: Path) -> Document[RootModel[Any]] | None:
    """Return a YAML file as plain values with their positions; None if even the loader refuses it."""
    try:
        return load_yaml(path, RootModel[Any])
    except InputError:
        return None


def driver_names(tree: Document[RootModel[Any]], findings: Findings) -> dict[str, str]:
    """Return drivers of a station file by role; those that do not exist are noted (B-PLAN-011)."""
    root = tree.model.root
    instruments = root.get("instruments") if isinstance(root, dict) else None
    drivers: dict[str, str] = {}
    for role, entry in instruments.items() if isinstance(instruments, dict) else ():
        driver = entry.get("driver") if isinstance(entry, dict) else None
        if isinstance(driver, str):
            drivers[role] = driver
            try:
                driver_actions(driver)
            except InputError as error:
                if error.code == "B-PLAN-011":  # a name that is not plain is noted by the loader
                    findings.add(error.code, tree.where(("instruments", role, "driver")), error.message)
    return drivers


def check_names(tree: Document[RootModel[Any]], drivers: Mapping[str, str], findings: Findings) -> None:
    """Note every ``role.action`` of a sequence file that names no role (B-PLAN-040) or no action (B-PLAN-050)."""
    root = tree.model.root
    for section in SECTIONS if isinstance(root, dict) else ():
        for called, path in _calls(root.get(section), (section,)):
            role, name = called.split(".")
            if role not in drivers:
                message = f"the station has no instrument {role!r}{suggestion(role, drivers)}"
                findings.add("B-PLAN-040", tree.where(path), message)
                continue
            try:
                actions = driver_actions(drivers[role])
            except InputError:
                continue
            if name not in actions:
                message = f"{role} ({drivers[role]}) has no action {name!r}{suggestion(name, actions)}"
                findings.add("B-PLAN-050", tree.where(path), message)


def _calls(value: Any, path: Place) -> Iterator[tuple[str, Place]]:
    if isinstance(value, list):
        for index, item in enumerate(value):
            if isinstance(item, str) and _ACTION.fullmatch(item):
                yield item, (*path, index)
            yield from _calls(item, (*path, index))
    elif isinstance(value, dict):
        for key, item in value.items():
            if _ACTION.fullmatch(key):
                yield key, (*path, key)
            elif key in _NAMING and isinstance(item, str) and _ACTION.fullmatch(item):
                yield item, (*path, key)
            yield from _calls(item, (*path, key))


def compile_sequence(
    path: str | Path, station: Station | None = None, overrides: Mapping[str, str] | None = None
) -> Plan:
    """Compile a sequence into a flat numbered plan.

    Args:
        path: a sequence file, or the name of a shipped one.
        station: the bench to plan for; None means the one the sequence names.
        overrides: ``--set`` values: parameters of the sequence, and ``world.<option>`` of a simulated station.
    Raises:
        InputErrors with every mistake, each with file:line:column (codes B-YAML, B-FRAME, B-PLAN).
    """
    source = find_shipped("sequences", path)
    document, station = load_both(source, station)
    findings = Findings()
    parameters, world_options = split_overrides(document, overrides or {}, findings)
    try:
        station = station.with_options(world_options)
    except InputErrors as error:
        findings.extend(error)
    values = apply_parameters(document, parameters, findings)
    plan = _Compiler(document, findings, source, station, values, frozenset(parameters)).plan()
    return replace(plan, settings=dict(overrides or {}))


@dataclass
class _Compiler(Draft[Sequence]):
    source: Path
    station: Station
    parameters: Values
    given: frozenset[str]

    def plan(self) -> Plan:
        """Return the plan. A draft with mistakes is checked as far as that can be done, so that all come at once."""
        frames = self._frames()
        check_declared(self)
        check_named(self)
        check_limits(self)
        channels = declared_channels(self)
        constants = campaign_channels(self, channels)
        link = next(iter(self.model.frame), "")
        if link in frames:
            check_counted(self, link, frames[link])
        rate_Hz = (frames[link].rate_Hz if link in frames else None) or math.nan
        expander = Expander(self, self.station, channels, rate_Hz, frames)
        root = expander.node(variables=self._variables(expander))
        serial = self._serial(root)
        expander.units = planned_units(root)
        expander.campaign = self._campaign(constants, rate_Hz, serial)
        lengths = self._expand(root)
        campaign = {**expander.campaign, **self._values(root)}
        plan = self._assembled(expander, lengths, frames, link, campaign)
        rules = plan_rules(self, self.station, plan.frames)
        plan = replace(plan, interlocks=rules_of_units(rules, plan.units))
        if self.findings:
            self._check_draft(plan, expander.doubtful)
            raise InputErrors(self.findings.sorted())
        return plan

    def _check_draft(self, draft: Plan, doubtful: Collection[int]) -> None:
        of_steps = Findings()
        check_steps(draft, self.station, of_steps, doubtful)
        short = PurePath(self.document.name).name + ":"
        for error in of_steps.all():
            here = error.where.startswith(short)
            where = self.document.name + error.where[len(short) - 1 :] if here else error.where
            self.findings.extend(InputError(error.code, error.message, where=where, next_step=error.next_step))
        check_station(self.station, self.findings)

    def _assembled(
        self, expander: Expander, lengths: Mapping[str, float], frames: Mapping[str, FrameDefinition], link: str,
        campaign: Values,
    ) -> Plan:  # fmt: skip
        model = self.model
        steps, units = with_bus_time(expander.steps, self.station), expander.units
        of_units = {unit.links[name]: frame for unit in units for name, frame in model.frame.items()}
        of_all = sum(_bytes_s(definition) for definition in frames.values()) * max(1, len(units))
        return Plan(
            name=model.sequence,
            title=model.title,
            steps=steps,
            duration_s=lengths.get("campaign", 0.0),
            prepare_s=lengths.get("prepare", 0.0),
            record_count=_records(steps),
            sha256="" if self.findings else steps_sha256(steps),
            texts=self._texts(frames),
            files=self._files(),
            campaign=campaign,
            station=self.station,
            frames=of_units or dict(model.frame),
            measurement_link=next(iter(of_units), link),
            link_bytes_s=of_all,
            dimensions=tuple(expander.dimensions),
            origins=tuple(expander.origins),
            declared=tuple(expander.declared),
            remarks=self._promised(lengths.get("campaign", 0.0), _records(steps)),
            early=model.early,
            units=units,
        )

    def _frames(self) -> dict[str, FrameDefinition]:
        """Return frame definitions by link, without those that cannot be used."""
        frames = {}
        for link, name in self.model.frame.items():
            path = ("frame", link)
            if self.model.units is None and link not in self.station.links:
                known = suggestion(link, self.station.links)
                self.fail("B-PLAN-046", path, f"station {self.station.name} has no link {link!r}{known}")
            try:
                frames[link] = load_frame(find_beside(self.source, "frames", name))
            except InputErrors as error:
                self.findings.extend(error)
                continue
            except InputError as error:
                self.fail("B-PLAN-045", path, error.message, error.next_step)
                continue
            if frames[link].rate_Hz is None:
                advice = "add 'rate: ... Hz' to the frame"
                self.fail("B-PLAN-048", path, f"frame {name!r} names no rate", advice)
        return frames

    def _serial(self, root: Node) -> str:
        """Return serial number of the unit under test; it becomes part of the session's folder name."""
        uut, node = self.model.uut, root.below("uut", "serial")
        serial = "" if uut is None else str(plain(node.resolve(uut.serial)))
        if uut is not None and not SERIAL.fullmatch(serial):
            node.fail("B-PLAN-025", f"{short(serial)} {NO_SERIAL}")
        return serial

    def _expand(self, root: Node) -> dict[str, float]:
        model, expander = self.model, root.plan
        lengths: dict[str, float] = {}
        phases: list[tuple[Phase, list[Step_], str]] = [
            ("prepare", model.prepare, "prepare"),
            ("campaign", model.steps, "steps"),
            ("finally", model.finally_, "finally"),
        ]
        unroller = Unroller(expander)
        try:
            for phase, steps, key in phases:
                expander.begin(phase)
                unroller.run(steps, root.below(key))
                if phase == "campaign":
                    unroller.timeline(model.timeline, root.below("timeline"))
                lengths[phase] = expander.known.at_s
        except TooManySteps:
            return lengths
        unroller.report_unused()
        return lengths

    def _variables(self, expander: Expander) -> dict[str, Any]:
        variables = {}
        for name, raw in self.parameters.items():
            path = ("parameters", name)
            value = expander.node(*path).resolve(raw)
            if isinstance(value, tuple):
                value = tuple(traced(v, self._origin(f"{name}[{i}]", (*path, i))) for i, v in enumerate(value))
            variables[name] = traced(value, self._origin(name, path))
        return variables

    def _origin(self, shown: str, path: tuple[str | int, ...]) -> str:
        return f"--set {shown}" if path[1] in self.given else f"parameter {shown}, line {self.line(path)}"

    def _promised(self, duration_s: float, records: int) -> tuple[InputError, ...]:
        """Check the length that the file states for itself; with parameters changed by hand it is not asked."""
        model = self.model
        draft = Draft(self.document, Findings())
        if model.duration not in (None, duration_s):
            message = f"the campaign lasts {duration_s:.10g} s by plan, not {model.duration:.10g} s"
            draft.fail("B-PLAN-047", ("duration",), message)
        if model.records not in (None, records):
            message = f"the campaign holds {records} records, not {model.records}"
            draft.fail("B-PLAN-047", ("records",), message)
        return tuple(draft.findings.sorted()) if self.parameters == model.parameters else ()

    def _texts(self, frames: Mapping[str, FrameDefinition]) -> dict[str, str]:
        texts = {name: document.text for name, document in self._documents().items()}
        return texts | {f"frames/{self.model.frame[link]}.yaml": frame.text for link, frame in frames.items()}

    def _files(self) -> dict[str, str]:
        files = {name: document.name for name, document in self._documents().items()}
        return files | {f"frames/{name}.yaml": str(_found(self.source, name)) for name in self.model.frame.values()}

    def _documents(self) -> dict[str, Document[Any]]:
        sequence, station = f"sequences/{self.model.sequence}.yaml", f"stations/{self.station.name}.yaml"
        return {sequence: self.document, station: self.station.document}

    def _campaign(self, channels: list[dict[str, Any]], rate_Hz: float, serial: str) -> dict[str, Any]:
        model = self.model
        campaign: dict[str, Any] = {
            "analysis": model.analysis,
            "reference_temperature_degC": model.reference_temperature,
            "rate_Hz": rate_Hz if model.frame else None,
            "channels": channels,
            "decision": {"rule": model.decision.rule},
        }
        return campaign | unit_constants(model, serial)

    def _values(self, root: Node) -> dict[str, Any]:
        """Return the values that are named and the fits through them, for the manifest; nothing if there are none."""
        check_judged(root.plan)
        values = {"expected": root.plan.expected.entries, "fits": fits_of(root)}
        return {name: entries for name, entries in values.items() if entries}


def _found(source: Path, frame: str) -> Path:
    try:
        return find_beside(source, "frames", frame)
    except InputError:
        return Path()


def _records(steps: list[Step] | tuple[Step, ...]) -> int:
    records = [step for step in steps if isinstance(step, PlannedRecord) and step.phase == "campaign"]
    return sum(not is_other_length(step, before) for before, step in zip([None, *records], records, strict=False))


def _bytes_s(definition: FrameDefinition) -> float:
    longest = max(message.length for message in definition.layout.messages)
    return float(longest or definition.layout.max_length) * (definition.rate_Hz or 0.0)
