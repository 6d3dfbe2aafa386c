"""Static check of what the analysis will ask of the records and of the data sheet: it asks when the campaign is over.

The analyses themselves live floors above; what they ask stands in the declarations of the systems.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches

from bench.model.declaration import AnalysisDeclaration, Limit
from bench.model.lab import lab_here, own_code_names
from bench.model.systems import analyses, analysis_declaration, declared_by, system_of_analysis, try_analysis
from bench.model.units import parse_quantity
from bench.plan.findings import Draft, Findings, suggestion
from bench.plan.language.sequence import Sequence
from bench.plan.plan import Plan, Step
from bench.plan.step_kinds import MEASUREMENT, PlannedCall, PlannedCommand, PlannedRecord

NONE = "none"


def names_made_of_logs(logs: bool) -> list[str]:
    """Return the names of the analyses that are made of imported logs, or of all others; a lab's own are of these."""
    lab = lab_here()
    own = [] if lab is None or logs else own_code_names("analyses", lab)
    return [*own, *(name for name, entry in analyses().items() if (entry.analysis.made_of == "logs") == logs)]


def check_named(draft: Draft[Sequence]) -> None:
    """Note an analysis that does not exist or is not made of records (B-PLAN-077)."""
    name = draft.model.analysis
    declared = None if name == NONE else analysis_declaration(name)
    if name != NONE and (declared is None or declared.made_of == "logs"):
        known = names_made_of_logs(False)
        if declared is not None:
            message = f"the analysis {name!r} is made of imported logs, not of records"
        else:
            message = f"there is no analysis {name!r}{suggestion(name, (NONE, *known))}"
        draft.fail("B-PLAN-077", ("analysis",), message, f"write one of: {', '.join((*known, NONE))}")


def check_limits(draft: Draft[Sequence]) -> None:
    """Note limits that no analysis knows, with the unit of something else, or of errors not above 0 (B-PLAN-093)."""
    uut, declared = draft.model.uut, analysis_declaration(draft.model.analysis)
    system = system_of_analysis(draft.model.analysis)
    shared: Mapping[str, Limit] = {} if system is None else system.limits
    known: Mapping[str, Limit] = declared.limits if declared is not None and declared.limits else shared
    _check_rule(draft)
    for name, text in ({} if uut is None else uut.limits).items():
        path = ("uut", "limits", name)
        if not known:
            message = f"nothing judges the limit {name!r}: the analysis {draft.model.analysis!r} has no such limits"
            draft.fail("B-PLAN-093", path, message, "remove it, or name the analysis that judges it")
            continue
        if name not in known:
            message = f"no analysis knows the limit {name!r}{suggestion(name, known)}"
            if declared is not None and declared.limits:
                message = f"the analysis {declared.name} knows no limit {name!r}{suggestion(name, known)}"
            draft.fail("B-PLAN-093", path, message, f"use one of: {', '.join(known)}")
            continue
        try:
            value = parse_quantity(text, known[name].dimension)
        except ValueError as error:
            draft.fail("B-PLAN-093", path, f"limit {name}: {error}")
            continue
        if known[name].above_zero and not value > 0.0:
            draft.fail("B-PLAN-093", path, f"limit {name}: {text} is not above zero")


def _check_rule(draft: Draft[Sequence]) -> None:
    """Note a decision rule of a sequence that has no analysis (B-PLAN-098)."""
    if draft.model.analysis == NONE and "decision" in draft.model.model_fields_set:
        message = "nothing is judged by this decision rule: the sequence asks for no analysis"
        draft.fail("B-PLAN-098", ("decision",), message, "remove it, or name an analysis")


def check_asked(plan: Plan, findings: Findings) -> None:
    """Note what an analysis would leave out or take for something else (B-PLAN-078)."""
    asked = declared_by(plan.campaign)
    if asked is not None and asked.made_of != "logs":
        _Asked(asked, plan, findings).check()
        try_analysis(asked.name)


@dataclass(frozen=True)
class _Asked:
    """What an analysis asks of a plan."""

    asked: AnalysisDeclaration
    plan: Plan
    findings: Findings

    def check(self) -> None:
        """Note what the plan does not have of it."""
        asked, plan = self.asked, self.plan
        records = [step for step in plan.phase("campaign") if isinstance(step, PlannedRecord)]
        first = plan.steps[0]
        for step in records:
            if step.conditions.get("purpose", MEASUREMENT) == MEASUREMENT:
                self._conditions(step)
        if asked.made_of not in ("readings", "values") and not plan.frames:
            message = "is made of frames of a unit, and the sequence names no link"
            self._fail(first, message, "name the link under 'frame', or another analysis")
        if asked.reading:
            self._reading(records)
        if asked.made_of == "tests":
            self._tests()
        elif asked.made_of == "values":
            if not plan.campaign.get("expected"):
                message = "is made of values, and no step reads or asks for one"
                self._fail(first, message, "add an action that returns a value")
        elif not records:
            message = "is made of records, and there is none"
            self._fail(first, message, "add 'record' steps, or name another analysis")
        for step in records if asked.made_of == "samples" else ():
            if not step.samples:
                self._fail(step, "needs the samples of each record", "write 'samples: true'")
        if asked.beside and records and asked.beside not in {*plan.frames} - {plan.measurement_link}:
            message = f"needs the link {asked.beside!r} beside the one that is recorded, the first one"
            self._fail(records[0], message, "name both links in 'frame', the recorded one first")

    def _fail(self, step: Step, what: str, cure: str) -> None:
        self.findings.add("B-PLAN-078", step.where, f"the analysis {self.asked.name} {what}", cure)

    def _reading(self, records: list[PlannedRecord]) -> None:
        reading, campaign = self.asked.reading, self.plan.phase("campaign")
        read = any(isinstance(step, PlannedCall) and step.name == reading for step in campaign)
        if records and not read:
            message = f"needs readings of the meter, and no step calls {reading}"
            self._fail(records[0], message, "read the meter before each record with a closed route")

    def _tests(self) -> None:
        items = self.asked.items
        tests = [step for step in self.plan.steps if isinstance(step, PlannedCommand) and step.item]
        if not tests:
            message = "is made of 'test' steps, and there is none"
            self._fail(self.plan.steps[0], message, f"add 'test' steps; {self.asked.page} describes them")
        for step in tests:
            if step.item not in items and get_close_matches(step.item, items, n=1):  # a slip of the pen
                message = f"does not judge the item {step.item!r}{suggestion(step.item, items)}"
                self._fail(step, message, "use that name, or one that is not nearly the same")

    def _conditions(self, step: Step) -> None:
        asked, stated = self.asked, step.conditions
        conditions, rule = asked.conditions, asked.rule
        if asked.conditions_of_open is not None and stated.get("route") == "open":
            conditions = asked.conditions_of_open
        if missing := [name for name in conditions if name not in stated]:
            message = f"asks for the condition {', '.join(missing)}, which the record does not have"
            self._fail(step, message, "docs/analyses.md says what each analysis asks for")
            return
        for name, words in asked.words.items():
            if stated[name] not in words:
                message = f"knows no {name} {stated[name]!r}{suggestion(str(stated[name]), words)}"
                self._fail(step, message, f"write one of: {', '.join(words)}")
                return
        if rule is not None:
            kept = all(stated[name] == value for name, value in rule.fixed.items())
            if not kept or any(name in stated for name in rule.absent):
                self._fail(step, f"asks for {rule.asks}", rule.cure)
