"""From a sequence file to a Plan."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import Any

from bench.frame import FrameDefinition, load_frame
from bench.model.errors import InputError, InputErrors
from bench.model.quantities import Values
from bench.model.shipped import find_beside, find_shipped
from bench.model.yamlio import Document
from bench.plan.channels import campaign_channels, check_counted, check_declared, declared_channels, unit_constants
from bench.plan.check.analysis import check_limits, check_named
from bench.plan.check.everything import NO_SERIAL, SERIAL, check_steps, short
from bench.plan.check.stations import check_station, plan_rules
from bench.plan.drivers import with_bus_time
from bench.plan.expand import Expander, Node, TooManySteps
from bench.plan.expected import check_judged
from bench.plan.findings import Draft, Findings, suggestion
from bench.plan.fits import fits_of
from bench.plan.language.sequence import Sequence
from bench.plan.language.steps import Step_
from bench.plan.loading import apply_parameters, load_both, split_overrides
from bench.plan.plan import Phase, Plan, Step, steps_sha256
from bench.plan.slots import planned_units, rules_of_units
from bench.plan.station import Station
from bench.plan.step_kinds import PlannedRecord
from bench.plan.stopping import is_other_length
from bench.plan.unroll import Unroller
from bench.plan.values import plain, traced


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
