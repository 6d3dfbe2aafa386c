"""Measuring points that end early: pulses of a converter at DC by the physics alone, and what the product makes of it.

The charge of a current with white noise is a random walk with a slope; pulses are whole quanta of it, and the AF clock
is counted in whole periods. Nothing of bench is used to make them. The product decides how long a point lasts, makes
one reading of its records, and says how well its mean is known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from bench.maths.verdict import coverage_factor
from bench.model.ports import RecordWindow
from bench.model.stopping import UNTIL
from bench.plan import Plan, PlannedDecision, PlannedRecord
from bench.record import UNIT_TEMPERATURE, RecordRow
from bench.run.steps.first_stage import looked_at
from bench.systems.af_converter.constants import read_campaign
from bench.systems.af_converter.estimators.readings import noise_parts, pulse_currents_A
from bench.systems.af_converter.groups import group_rows

F_AF_Hz, RATE_Hz, K0_C, DECLARED_A_rtHz = 256e3, 100.0, 1.25e-6, 2e-9
GAP_s = 0.02  # between a decision and the next record: two frames
MOST_OFF = 1e-3  # of the level: no current is a whole number of pulses
CLOCK_OFF = 10e-6, 30e-6  # of the AF clock: no record is a whole number of its periods


@dataclass(frozen=True)
class Measured:
    """What came of a point, ampere: error of the mean, its standard and expanded uncertainty; seconds it has lasted."""

    error_A: float
    std_A: float
    expanded_A: float
    seconds: float
    due: int = 0

    @property
    def inside(self) -> bool:
        return abs(self.error_A) <= self.expanded_A


class Charge:
    """Charge of one current since the beginning, in quanta, and the time that has passed."""

    def __init__(self, rng: np.random.Generator, current_A: float, white_A_rtHz: float) -> None:
        self._rng, self._current_A, self._white_A_rtHz = rng, current_A, white_A_rtHz
        self._quanta, self._clocks, self._frames = rng.uniform(), rng.uniform(), int(rng.integers(1, 10**6))
        self._fast = 1.0 + rng.uniform(*CLOCK_OFF)  # a faster clock makes a pulse of less charge

    def pass_s(self, seconds: float) -> tuple[int, int]:
        """Return pulses and AF clocks that are counted in the next seconds."""
        noise_C = self._white_A_rtHz * math.sqrt(seconds / 2.0) * self._rng.standard_normal()
        before = math.floor(self._quanta), math.floor(self._clocks)
        self._quanta += (self._current_A * seconds + noise_C) / K0_C * self._fast
        self._clocks += F_AF_Hz * self._fast * seconds
        self._frames += round(seconds * RATE_Hz)
        return math.floor(self._quanta) - before[0], math.floor(self._clocks) - before[1]

    def record(self, step: PlannedRecord) -> RecordRow:
        """Return the record of a step from now on."""
        number, first = step.number, self._frames
        pulses, clocks = self.pass_s(step.seconds)
        counts = {True: np.array([pulses]), False: np.array([0])}
        positive = step.conditions["polarity"] > 0
        frames = round(step.seconds * RATE_Hz)
        begin_ns = round(first / RATE_Hz * 1e9)
        window = RecordWindow(
            number, "port_a", first, frames, begin_ns, begin_ns + round(step.seconds * 1e9), step.conditions, number
        )
        master = round(step.seconds * 1e7)
        sums = {"npp": counts[positive], "ppp": counts[not positive], "af_clock": np.array(clocks)}
        sums |= {"master_count": np.array(master), "fg_count": np.array(master)}
        return RecordRow(window, sums, frames, 0, 0, 0, {UNIT_TEMPERATURE: 23.0})


def by_noise(plan: Plan, rng: np.random.Generator, points: int) -> Iterator[Measured]:
    """Points of which the declared noise has fixed the length; the noise is as declared."""
    records = [step for step in plan.phase("campaign") if isinstance(step, PlannedRecord) and step.longest_s]
    for _ in range(points):
        step = records[int(rng.integers(len(records)))]
        current_A = step.conditions["current_A"] * (1.0 + rng.uniform(-MOST_OFF, MOST_OFF))
        row = Charge(rng, current_A, DECLARED_A_rtHz).record(step)
        yield _measured(plan, [row], current_A)


def by_scatter(
    plan: Plan, rng: np.random.Generator, points: int, white_A_rtHz: Callable[[np.random.Generator], float]
) -> Iterator[Measured]:
    """Points that end by the scatter of their first stage; nobody has declared the noise that they have."""
    decisions = [step for step in plan.steps if isinstance(step, PlannedDecision) and step.word == UNTIL]
    for _ in range(points):
        decision = decisions[int(rng.integers(len(decisions)))]
        current_A = decision_level_A(plan, decision) * (1.0 + rng.uniform(-MOST_OFF, MOST_OFF))
        charge = Charge(rng, current_A, white_A_rtHz(rng))
        rows = [charge.record(_record(plan, number)) for number in decision.arguments["first"]]
        more, readings = looked_at(rows, decision, plan.campaign)
        taken = next(branch for branch in decision.branches if branch.outcome == decision.outcome(more))
        charge.pass_s(GAP_s)
        rows += [charge.record(_record(plan, number)) for number in range(taken.first, taken.stop)]
        yield replace(_measured(plan, rows, current_A), due=readings[1]["value"])


def by_running_scatter(
    plan: Plan, rng: np.random.Generator, points: int, white_A_rtHz: Callable[[np.random.Generator], float]
) -> Iterator[Measured]:
    """What the product never does: look after each record from the third on, and stop where the scatter is small."""
    decision = next(step for step in plan.steps if isinstance(step, PlannedDecision) and step.word == UNTIL)
    step = _record(plan, decision.arguments["first"][0])
    allowed_A = coverage_factor(math.inf) * decision.arguments["target"]
    for _ in range(points):
        current_A = decision_level_A(plan, decision) * (1.0 + rng.uniform(-MOST_OFF, MOST_OFF))
        charge, means_A = Charge(rng, current_A, white_A_rtHz(rng)), []
        while True:
            pulses, clocks = charge.pass_s(step.seconds)
            means_A.append(K0_C * F_AF_Hz * pulses / clocks)
            if len(means_A) < 3:
                continue
            std_A = float(np.std(means_A, ddof=1)) / math.sqrt(len(means_A))
            expanded_A = coverage_factor(len(means_A) - 1) * std_A
            if expanded_A <= allowed_A or len(means_A) == 60:
                break
        error_A = float(np.mean(means_A)) - current_A
        yield Measured(error_A, std_A, expanded_A, len(means_A) * step.seconds)


def decision_level_A(plan: Plan, decision: PlannedDecision) -> float:
    return float(_record(plan, decision.arguments["first"][0]).conditions["current_A"])


def _record(plan: Plan, number: int) -> PlannedRecord:
    step = plan.steps[number]
    assert isinstance(step, PlannedRecord)
    return step


def _measured(plan: Plan, rows: list[RecordRow], current_A: float) -> Measured:
    """Return what the analysis makes of the records of a point: one reading, its noise, its degrees of freedom."""
    (group,) = group_rows(rows, 1e7)
    reading, converter = group.closed, read_campaign(plan.campaign).converter(1)
    assert reading.gate_s.size == 1
    n_A, p_A = pulse_currents_A(reading, converter)
    parts = noise_parts(reading, replace(converter, walk_A_rth=0.0))
    std_A = math.sqrt(sum(float(part[0, 0]) for part in parts.values()))
    factor = coverage_factor(float(reading.scatter_dof[0]) or math.inf)
    return Measured(abs(float(n_A[0] - p_A[0])) - current_A, std_A, factor * std_A, float(reading.gate_s[0]))
