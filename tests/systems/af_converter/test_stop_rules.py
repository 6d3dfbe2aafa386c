"""Points that end early: whether their intervals are true; a campaign of them is killed and gone on with."""

import math
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rehearsal import SEED, Crashes, contents, crashed_at, go_on, nobody, nobody_in
from units_campaign import BY_NOISE, BY_SCATTER, stopping_plan

from bench.maths.budget import combine_all
from bench.maths.verdict import clopper_pearson, coverage_factor
from bench.model.clock import VirtualClock
from bench.model.ports import RecordWindow
from bench.model.stopping import STAGE, UNTIL
from bench.plan import Plan, PlannedDecision, PlannedRecord, decisions_of
from bench.record import UNIT_TEMPERATURE, RecordRow, SessionReader
from bench.replay.parts import recorded_windows
from bench.run.operator import SimulatedOperator
from bench.run.position import in_point, point_start, point_stop
from bench.run.session import conduct
from bench.run.steps.dispatch import looked_at
from bench.session.service import read_view
from bench.session.view import analyse_view, material_of
from bench.systems.af_converter.constants import read_campaign
from bench.systems.af_converter.estimators.readings import noise_parts, pulse_currents_A
from bench.systems.af_converter.groups import group_rows
from bench.systems.af_converter.scale_factor.budgets import components_of
from bench.systems.af_converter.scale_factor.estimates import determine
from bench.web.recorded.past import Past

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


def by_scatter(plan: Plan, rng: np.random.Generator, points: int) -> Iterator[Measured]:
    """Points that end by the scatter of their first stage; nobody has declared the noise that they have."""
    decisions = [step for step in plan.steps if isinstance(step, PlannedDecision) and step.word == UNTIL]
    for _ in range(points):
        decision = decisions[int(rng.integers(len(decisions)))]
        current_A = decision_level_A(plan, decision) * (1.0 + rng.uniform(-MOST_OFF, MOST_OFF))
        charge = Charge(rng, current_A, noisy(rng))
        rows = [charge.record(_record(plan, number)) for number in decision.arguments["first"]]
        more, readings = looked_at(rows, decision, plan.campaign)
        taken = next(branch for branch in decision.branches if branch.outcome == decision.outcome(more))
        charge.pass_s(GAP_s)
        rows += [charge.record(_record(plan, number)) for number in range(taken.first, taken.stop)]
        yield replace(_measured(plan, rows, current_A), due=readings[1]["value"])


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


BLOCK, SURE, STATED = 100, 0.999, 0.95
POINTS = [300, pytest.param(2000, marks=pytest.mark.sweep)]
LEVELS = "1 mA, 10 mA, 100 mA, 200 mA"
Recorded = Callable[[str, object], None]


def noisy(rng: np.random.Generator) -> float:
    """White noise of a record of a second 3 to 30 times the fractions of a pulse at its ends, A/rtHz."""
    return float(10 ** rng.uniform(0.5, 1.5) * K0_C / math.sqrt(6.0) * math.sqrt(2.0))


@pytest.fixture(scope="module")
def scattered(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    """The target is reached by the quieter points, and by others not before the longest."""
    until = BY_SCATTER.replace("10 ppm", "600 nA")
    return stopping_plan(tmp_path_factory.mktemp("scattered"), until, "1 s", LEVELS)


def coverage(name: str, points: Sequence[Measured], most_s: float) -> tuple[float, float]:
    """Print what came of points; return the exact interval of their coverage."""
    inside = sum(point.inside for point in points)
    low, high = clopper_pearson(inside, len(points), SURE)
    hours = sum(point.seconds for point in points) / 3600.0
    print(
        f"{name}: {inside} of {len(points)} inside, {low:.4f} to {high:.4f}; {hours:.2f} h, of "
        f"{len(points) * most_s / 3600.0:.2f} h at most"
    )
    return low, high


def share_inside(points: Sequence[Measured]) -> str:
    return f"{100.0 * float(np.mean([point.inside for point in points])):.1f} % of {len(points)} inside"


def unbiased(points: Sequence[Measured]) -> bool:
    """Print the mean error over U; return whether it is small. Of few points as small as their mean can show."""
    errors = np.array([point.error_A / point.expanded_A for point in points])
    seen = 3.29 * float(errors.std(ddof=1)) / math.sqrt(errors.size) if errors.size < 2000 else 0.0
    print(f"mean error {errors.mean():+.4f} U")
    return bool(abs(errors.mean()) < 0.05 + seen)


@pytest.mark.validates(
    "random component of a point that ends by declared noise",
    against="the currents behind 2,000 simulated points, in the short form 300",
)
@pytest.mark.parametrize("count", POINTS)
def test_points_that_end_by_declared_noise_are_covered(tmp_path: Path, count: int, record_property: Recorded) -> None:
    plan = stopping_plan(tmp_path, "{random: 40 nA, most: 50}", "2 s", LEVELS)
    points = [one for seed in range(count // BLOCK) for one in by_noise(plan, np.random.default_rng(seed), BLOCK)]
    low, high = coverage("declared noise", points, 100.0)
    record_property("obtained", share_inside(points))
    assert low <= STATED <= high
    assert unbiased(points)
    assert max(point.std_A for point in points) <= 40e-9 * (1.0 + 1e-3)  # currents are not quite their levels


@pytest.mark.validates(
    "random component of a point that ends by the scatter of its first stage",
    against="the currents behind 2,000 simulated points, in the short form 300",
)
@pytest.mark.parametrize("count", POINTS)
def test_points_that_end_by_their_first_stage_are_covered(
    scattered: Plan, count: int, record_property: Recorded
) -> None:
    blocks = range(count // BLOCK)
    points = [one for seed in blocks for one in by_scatter(scattered, np.random.default_rng(seed), BLOCK)]
    low, high = coverage("first stage", points, 60.0)
    record_property("obtained", share_inside(points))
    assert low <= STATED <= high
    assert unbiased(points)
    reached = [point for point in points if point.due <= 60]
    print(f"{len(reached)} reach the target")
    assert 0.2 * count < len(reached) < 0.8 * count
    assert max(point.expanded_A for point in reached) <= 1.96 * 600e-9 * (1.0 + 1e-5)


def test_records_that_do_not_count_are_taken_again(scattered: Plan) -> None:
    """Of a first stage of 20 records 8 are damaged: the mean rests on the other 12 and those that come behind."""
    rng = np.random.default_rng(1)
    decision = next(step for step in scattered.steps if isinstance(step, PlannedDecision) and step.word == UNTIL)
    record = scattered.steps[decision.arguments["first"][0]]
    charge = Charge(rng, decision_level_A(scattered, decision), noisy(rng))
    rows = [charge.record(record) for _ in range(20)]
    damaged = [replace(row, lost=row.window.frames) if k < 8 else row for k, row in enumerate(rows)]
    twenty = replace(decision, arguments={**decision.arguments, "first": tuple(range(20)), "least": 20})
    more, (_, due) = looked_at(damaged, twenty, scattered.campaign)
    assert more == due["value"] - 12 >= 8


PLACES = ("first stage", "decision", "second stage", "behind the second stage")


def rules(crashes: Crashes) -> list[PlannedDecision]:
    return [decision for decision in decisions_of(crashes.plan.steps) if decision.word == UNTIL]


def decided(folder: Path) -> dict[int, dict[str, Any]]:
    return {fields["step"]: dict(fields) for _, _, fields in SessionReader(folder).events("decision")}


def steps_of(folder: Path) -> list[int]:
    """Return the steps of all records."""
    windows = recorded_windows(SessionReader(folder).select(frozenset({"/event"})))
    return list({item.window.number: item.window.step for item in windows}.values())


@pytest.fixture(scope="module")
def crashes(tmp_path_factory: pytest.TempPathFactory) -> Crashes:
    """The run is copied wherever a step of the first point may begin."""
    folder = tmp_path_factory.mktemp("stopping")
    plan = stopping_plan(folder, BY_SCATTER, "1 s")
    decision = decisions_of(plan.steps)[0]
    return crashed_at(plan, folder, set(range(decision.arguments["first"][0], decision.branches[-1].stop + 1)))


def place(crashes: Crashes, name: str) -> int:
    """Number of a step of the first point; of the second stage that which was decided for."""
    decision = rules(crashes)[0]
    outcome = decided(crashes.whole)[decision.number]["outcome"]
    taken = next(branch for branch in decision.branches if branch.outcome == outcome)
    assert taken.first < taken.stop, "the first point has a second stage"
    numbers = decision.arguments["first"][4], decision.number, taken.first, decision.branches[-1].stop
    return int(dict(zip(PLACES, numbers, strict=True))[name])


def test_each_decision_is_an_event_that_its_records_bear_out(crashes: Crashes) -> None:
    """What was decided is decided again from what the session holds, and the records are those that it asks for."""
    rows, events = list(read_view(crashes.whole).rows), decided(crashes.whole)
    taken = {row.window.step for row in rows}
    assert [fields["word"] for fields in events.values()] == [UNTIL] * 4
    for decision in rules(crashes):
        first = [row for row in rows if row.window.step in decision.arguments["first"]]
        more, readings = looked_at(first, decision, crashes.plan.campaign)
        event = events[decision.number]
        assert (event["readings"], event["outcome"]) == (readings, decision.outcome(more))
        assert all(
            later.window.first_counter == row.window.first_counter + row.window.frames for row, later in pairwise(first)
        )
        for branch in decision.branches:
            asked = set(range(branch.first, branch.stop))
            assert (asked <= taken) if branch.outcome == event["outcome"] else not asked & taken


@pytest.mark.parametrize(
    "name", [*PLACES[1::2], *(pytest.param(name, marks=pytest.mark.sweep) for name in PLACES[::2])]
)
def test_killed_in_the_middle_of_a_point_it_goes_on_to_the_same_bytes(
    crashes: Crashes, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The point is taken again from its beginning; what was decided stands; twice the same, and a replay too."""
    source = crashes.at(place(crashes, name))
    before = decided(source)
    folders = [Path(shutil.copytree(source, tmp_path / half / source.name)) for half in ("first", "second")]
    for folder in folders:
        assert go_on(folder, nobody_in(monkeypatch)).outcome.error is None
    first, second = folders
    after = decided(first)
    assert {step: after[step] for step in before} == before
    assert (rules(crashes)[0].number in before) == (name == PLACES[-1])  # before, it is in the second that is lost
    assert after.keys() == decided(crashes.whole).keys()
    assert contents(first) == contents(second)
    steps = steps_of(first)
    assert len(set(steps)) == len(steps), "a record twice"
    assert {step for rule in rules(crashes) for step in rule.arguments["first"]} <= set(steps)
    results = [analyse_view(read_view(folder))[0] for folder in folders]
    assert results[0] == results[1]


def test_one_record_is_counted_of_all_second_stages(crashes: Crashes) -> None:
    """Before the first decision, and at the end: those that were taken, and the page says the same."""
    points = 4 * (10 + 1) + 10  # levels; zeros, open inputs and the closing repeat
    assert crashes.plan.record_count == points
    taken = sum(step >= crashes.plan.phase("campaign")[0].number for step in steps_of(crashes.whole))
    records = Past().final(crashes.whole)["records"]
    assert (records["done"], records["planned"]) == (taken, taken)
    more = [fields["outcome"] for fields in decided(crashes.whole).values()]
    assert taken == points - more.count("0 more")


def test_a_point_in_stages_begins_and_ends_as_one(crashes: Crashes) -> None:
    """A hold goes back to where its route is set, a skip goes on behind its verification, wherever it is."""
    steps = crashes.plan.phase("campaign")
    decision, offset = rules(crashes)[0], steps[0].number
    begin = next(at for at in range(decision.number - offset, 0, -1) if steps[at].name == "standby")
    verify = next(at for at in range(decision.number - offset, len(steps)) if steps[at].kind == "verify")
    for at in range(decision.arguments["first"][0] - offset, verify + 1):
        assert point_start(steps, at) == begin
        assert point_stop(steps, at) == verify + 1
        assert in_point(steps, at) == (steps[at] is not decision)


def test_a_point_is_one_reading_with_the_freedom_of_its_first_stage(crashes: Crashes) -> None:
    results, _ = analyse_view(read_view(crashes.whole))
    entries = {entry["quantity"]: entry for entry in results["estimates"]}
    assert entries["dsf_n"]["n"] == 2 + 4  # zeros and levels
    known = determine(material_of(read_view(crashes.whole)), "gls")
    for index, quantity in enumerate(("dsf_n", "dsf_p")):
        parts = components_of(known.fitted.groups[0], index, known.fitted, known.constants, known.standards)
        budget = combine_all({"": parts}).budgets[""]
        assert budget.std_uncertainty == pytest.approx(entries[quantity]["std_uncertainty"], rel=1e-9)
        assert budget.dof == pytest.approx(entries[quantity]["dof"], rel=1e-6)
    asymmetry = entries["dsf_asymmetry"]
    assert 4 * 9 > asymmetry["dof"] > 9  # of four points with nine each
    assert asymmetry["coverage_factor"] > 2.0


def test_by_declared_noise_there_is_no_look(tmp_path: Path) -> None:
    """Lengths are fixed in advance: zeros and the closing repeat have the longest, and nothing is decided."""
    plan = stopping_plan(tmp_path, BY_NOISE, "5 s")
    records = [step for step in plan.phase("campaign") if isinstance(step, PlannedRecord)]
    assert not any(STAGE in record.conditions for record in records)
    driven = [record for record in records if record.conditions["route"] == "closed"]
    for record in driven:
        ends = record.conditions["current_A"] > 0 and not record.conditions["repeat"]
        assert (record.seconds, record.longest_s) == ((30.0, 100.0) if ends else (100.0, 0.0))
    done = conduct(
        plan, clock=VirtualClock(), seed=SEED, out=tmp_path / "out", operator=SimulatedOperator(), listener=nobody()
    )
    assert done.outcome.error is None
    assert decided(done.folder) == {}
    entries = {entry["quantity"]: entry for entry in analyse_view(read_view(done.folder))[0]["estimates"]}
    assert entries["dsf_asymmetry"].get("dof", math.inf) == math.inf
