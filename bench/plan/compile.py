"""From a sequence file to a Plan, and the fits that it asks for: names as the values have them, in base units."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import Any

from bench.frame import FrameDefinition, load_frame
from bench.model.declaration import stated
from bench.model.errors import InputError, InputErrors
from bench.model.quantities import Values
from bench.model.shipped import find_beside, find_shipped
from bench.model.yamlio import Document
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
from bench.plan.expected import bound_in, check_judged, limits_in, takes_all
from bench.plan.findings import Draft, Findings, suggestion
from bench.plan.language.expect import LOG, NONLINEARITY, RECIPROCAL, Fit, variable_of
from bench.plan.language.sequence import Sequence
from bench.plan.language.steps import Step_
from bench.plan.loading import apply_parameters, load_both, split_overrides
from bench.plan.plan import Phase, Plan, Step, steps_sha256
from bench.plan.station import Station
from bench.plan.step_kinds import PlannedRecord
from bench.plan.unroll import Unroller
from bench.plan.values import plain, traced

TIME = "time"


def fits_of(outer: Node) -> list[dict[str, Any]]:
    """Return the fits for the manifest (B-PLAN-120, B-PLAN-121, B-PLAN-123)."""
    fits: list[dict[str, Any]] = []
    plan = outer.plan
    for index, fit in enumerate(plan.model.fits if takes_all(plan) else ()):
        node = outer.below("fits", index)
        of, function = variable_of(fit.of)
        unit = plan.expected.unit_of(of)
        if unit is None:
            _unknown(node.below("of"), of)
            continue
        y_unit, against = _unit_of(node.below("of"), fit.of, unit), _against(node, fit)
        per = [_per(node.below("per", place), name) for place, name in enumerate(fit.per)]
        if against is None or y_unit is None or None in per:
            continue
        x_unit = _unit_of(node.below("against"), fit.against, against["unit"])
        if x_unit is None:
            continue
        units = {**coefficient_units(y_unit, x_unit, fit.orders), NONLINEARITY: unit}
        expected = {
            result: limits_in(node.below("expect", result), bounds, units[result])
            for result, bounds in fit.expect.items()
        }
        asked = {"name": fit.name, "of": of, "powers": list(fit.orders), "per": per, "units": units,
                 "against": against, "expected": expected}  # fmt: skip
        asked |= {"function": function} if function else {}
        read_back = _read_back(node, fit, unit, against["unit"])
        fits.append(asked | ({"read_back": read_back} if read_back else {}))
    return fits


def coefficient_units(of: str, against: str, orders: Iterable[int]) -> dict[str, str]:
    """Return the units of the coefficients c0, c1, ... that a polynomial has."""
    units = {}
    for order in orders:
        power = against if order == 1 else f"{against}{order}"
        units[f"c{order}"] = of if against == "1" or not order else f"1/{power}" if of == "1" else f"{of}/{power}"
        if of == against and order:
            units[f"c{order}"] = "1" if order == 1 else f"1/{against}{'' if order == 2 else order - 1}"
    return units


def _unit_of(node: Node, variable: str, unit: str) -> str | None:
    """Return the unit of a function of a quantity (B-PLAN-123 for a logarithm of degrees)."""
    _, function = variable_of(variable)
    if function == LOG:
        if unit == "degC":
            message = f"{variable}: a temperature in degC has no logarithm, because its zero is arbitrary"
            node.fail("B-PLAN-123", message, "fit the temperature itself, or 1/x of it, which is in kelvin")
            return None
        return "1"
    if function == RECIPROCAL and unit != "1":
        return "1/K" if unit == "degC" else f"1/{unit}"
    return unit


def _against(node: Node, fit: Fit) -> dict[str, Any] | None:
    if fit.against == TIME:
        return {"time": True, "unit": "s"}
    name, function = variable_of(fit.against)
    plan = node.plan
    unit, condition = plan.expected.unit_of(name), plan.expected.condition(name)
    more = {"function": function} if function else {}
    if unit is not None:
        return {"quantity": name, "unit": unit, **more}
    if condition is None:
        _unknown(node.below("against"), name)
        return None
    against: dict[str, Any] = {"condition": condition[0], "unit": condition[1], **more}
    value = bound_in(plan.node(*node.path, "against_uncertainty"), fit.against_uncertainty, condition[1])
    return against | stated({"uncertainty": value})


def _read_back(node: Node, fit: Fit, unit: str, against: str) -> list[dict[str, Any]]:
    """Return the values of the curve that have a name, in the units of the quantities themselves."""
    entries = []
    for index, asked in enumerate(fit.read_back):
        here = node.below("read_back", index)
        at = bound_in(here.below("at"), asked.at, against)
        if asked.name in node.plan.expected.names:
            message = f"{asked.name!r} is read, and cannot be the name of a value of a fit"
            here.below("name").fail("B-PLAN-121", message, "give it a name of its own")
        elif at is not None:
            limits = limits_in(here, asked, unit)
            entries.append({"quantity": asked.name, "at": at, "unit": unit, **limits})
    return entries


def _per(node: Node, name: str) -> str | None:
    condition = node.plan.expected.condition(name)
    if condition is None:
        _unknown(node, name)
    return None if condition is None else condition[0]


def _unknown(node: Node, name: str) -> None:
    known = ", ".join(node.plan.expected.names) or "nothing"
    message = f"no value and no condition of one is called {name!r}"
    node.fail("B-PLAN-123", message, f"what is read: {known}; write 'expect: {{name: ...}}' beside a reading")


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
                lengths[phase] = expander.at_s
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
