"""The valid, missing and invalid records of a campaign, and why: those a make-up session has to take again."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bench.analysis import count_problem, flag_problem
from bench.model.events import Skip
from bench.model.installed import named
from bench.model.systems import declared_by
from bench.plan import MEASUREMENT, PlannedRecord, Step, left_out_by
from bench.record import SHORTER, RecordRow
from bench.replay import Replayed

VALID, MISSING, INVALID = "valid", "missing", "invalid"


@dataclass(frozen=True)
class RecordState:
    """One planned record: its step, its number if it was taken, and what became of it."""

    step: PlannedRecord
    number: int | None
    state: str
    why: str = ""

    def as_json(self) -> dict[str, Any]:
        """Return the state as JSON values."""
        document = {"step": self.step.number, "number": self.number, "state": self.state, "why": self.why}
        return {**document, "conditions": dict(self.step.conditions)}


def record_states(steps: Sequence[Step], replayed: Replayed) -> list[RecordState]:
    """Return state of every measuring record of the campaign phase, in the order of the plan.

    One that a decision has left out is none that is due.
    """
    rows = {row.window.step: row for row in replayed.rows}
    skips = [event for _, event in replayed.events if isinstance(event, Skip)]
    is_shorter = any(place.what == SHORTER for place in replayed.damage)
    reached = len(steps) if is_shorter else max(rows, default=-1)
    problems = {row.window.step: problem for row, problem in _problems(replayed)}
    left_out = {n for stretch in left_out_by(steps, (event for _, event in replayed.events)) for n in stretch}
    records = [record for record in measuring(steps) if record.number not in left_out]
    sampled = {record.number for record in records if record.samples}
    problems |= {number: sample_problem(row) for number, row in rows.items() if number in sampled}
    return [
        _state(record, rows.get(record.number), problems.get(record.number, ""), skips, reached) for record in records
    ]


def _problems(replayed: Replayed) -> Iterator[tuple[RecordRow, str]]:
    """Yield why the analysis of the session leaves each record out, "" if it does not."""
    asked = declared_by(replayed.manifest.get("campaign", {}))
    if asked is None or not asked.problems:
        yield from ((row, row_problem(row)) for row in replayed.rows)
    else:
        yield from zip(replayed.rows, named(asked.problems)(replayed.rows, replayed.measurement_rows), strict=True)


def measuring(steps: Iterable[Step]) -> list[PlannedRecord]:
    """Return the records of the campaign that an analysis sees."""
    records = (step for step in steps if isinstance(step, PlannedRecord))
    return [record for record in records if record.phase == "campaign" and record.purpose == MEASUREMENT]


def _state(
    step: PlannedRecord, row: RecordRow | None, problem: str, skips: Iterable[Skip], reached: int
) -> RecordState:
    if row is None:
        skip = next((skip for skip in skips if skip.first <= step.number < skip.stop), None)
        if skip is not None:
            return RecordState(step, None, MISSING, f"skipped: {skip.reason}")
        lost = "its record is lost" if step.number < reached else "the run stopped before"
        return RecordState(step, None, MISSING, lost)
    return RecordState(step, row.window.number, INVALID if problem else VALID, problem)


def sample_problem(row: RecordRow) -> str:
    """Return why no analysis of samples can use a record, "" if it can; lost frames are seen from the counter."""
    return flag_problem(row) or ("" if row.frames else "no frames")


def row_problem(row: RecordRow) -> str:
    """Return why every analysis leaves a record out, "" if its counts are good, or if something was read."""
    return count_problem(row) if row.window.link else flag_problem(row)


def summary_lines(states: Sequence[RecordState]) -> list[str]:
    """Return the states for a person: counts, and each record that is not valid."""
    counts = Counter(state.state for state in states)
    said = [", ".join(f"{counts[state]} {state}" for state in (VALID, MISSING, INVALID)) + f" of {len(states)} records"]
    said += [
        f"  record {state.number} (step {state.step.number}): invalid, {state.why}: {_where(state.step)}"
        for state in states
        if state.state == INVALID
    ]
    missing = Counter(state.why for state in states if state.state == MISSING)
    said += [f"  {count} missing: {why}" for why, count in missing.items()]
    return said


def condition_key(conditions: Mapping[str, Any]) -> str:
    """The same for two records of one point, whichever session they are of."""
    return json.dumps({name: value for name, value in conditions.items() if name != "settled"}, sort_keys=True)


def _where(step: Step) -> str:
    names = ("channel", "temperature_degC", "current_A", "polarity", "route")
    return ", ".join(f"{name} {step.conditions[name]}" for name in names if name in step.conditions)
