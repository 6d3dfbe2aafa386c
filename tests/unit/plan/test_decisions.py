"""Decisions in a plan: how they are unrolled, what can be compared, and what every way through them must keep."""

import json
from pathlib import Path

import pytest
from plan_sample import changed, make_bench, mistakes
from probe_bench import HEAD, TURNS, WARM_UP, deciding_plan, sequence_file

from bench.plan import HOLD, PlannedDecision, PlannedRecord, compile_sequence, plan_json, steps_of, steps_sha256
from bench.plan.decision import MOST_WAYS, Branch, Followed, walk
from bench.plan.findings import Findings
from bench.plan.plan import Step
from bench.plan.station import driver_actions

pytestmark = pytest.mark.usefixtures("probes")

READ = "  - chamber.measure_air\n"
WHILE = "  - while: {reading: chamber.measure_air, above: 24 degC}LIMIT\n    do: [settle: 1 s]\n"
DECIDES = """\
      - dmm.measure_current
      - settle: 20 s
      - if: {reading: dmm.measure_current, above: 1 A}
        then: [settle: 1 s]
"""


def decisions(steps: tuple[Step, ...]) -> list[PlannedDecision]:
    return [step for step in steps if isinstance(step, PlannedDecision)]


def errors(folder: Path, steps: str) -> list[str]:
    """What is found in a sequence of these steps: code, line and message."""
    text = HEAD.replace("analysis: probe_means\n", "") + steps
    found = mistakes(sequence_file(folder, text))
    return [f"{error.code} {error.where.split(':')[-2]} {error.message}" for error in found]


def test_a_loop_is_unrolled_to_its_bound(tmp_path: Path) -> None:
    """One decision before each turn and one behind the last; each leaves out all that is behind it in the loop."""
    plan = deciding_plan(tmp_path, HEAD + WARM_UP)
    loop = decisions(plan.steps)
    assert [step.number for step in loop] == [4 + 3 * turn for turn in range(TURNS + 1)]
    end = len(plan.steps)
    assert [step.left_out("done") for step in loop[:-1]] == [(range(step.number + 1, end),) for step in loop[:-1]]
    assert (loop[0].left_out("turn"), loop[-1].left_out("done")) == ((), ())
    assert (loop[0].outcomes(), loop[-1].outcomes()) == (("turn", "done"), ("done",))
    assert [step.outcome(34.9) for step in (loop[0], loop[-1])] == ["turn", "fail"]
    assert [step.outcome(35.0) for step in (loop[0], loop[-1])] == ["done", "done"]
    records = [step for step in plan.steps if isinstance(step, PlannedRecord)]
    assert [step.conditions["turn"] for step in records] == list(range(1, TURNS + 1))
    assert plan.duration_s == 10.0 + TURNS * 120.0
    plan = compile_sequence(sequence_file(tmp_path), None, {"limit": "30 degC"})
    assert decisions(plan.steps)[0].branches[0].values == (30.0,)


def test_branches_begin_together_and_end_with_the_longest(tmp_path: Path) -> None:
    """Planned times are the latest ones: 30 min of 'then' against 2 min of 'else', 1 h of a case against 2 min."""
    plan = deciding_plan(tmp_path)
    condition, choice = decisions(plan.steps)[-2:]
    begin_s = 10.0 + TURNS * 120.0
    then, otherwise = condition.branches
    assert [plan.steps[branch.first].at_s for branch in (then, otherwise)] == [begin_s, begin_s]
    assert choice.at_s == begin_s + 1800.0
    assert [branch.outcome for branch in choice.branches] == ["case 1", "case 2", "else"]
    assert plan.duration_s == begin_s + 1800.0 + 3600.0 + 10.0
    assert choice.left_out("case 2") == (range(choice.branches[0].first, choice.branches[0].stop),)
    assert [choice.outcome(ohm) for ohm in (109.9, 110.0, 120.0, 120.1)] == ["case 1", "case 2", "case 2", "else"]
    assert (choice.role, choice.name, dict(choice.arguments)) == ("meter", "measure_resistance", {"range": 1000.0})
    assert (choice.missing, condition.missing) == (HOLD, "else")


@pytest.mark.parametrize(
    ("comparison", "values", "fits", "fails"),
    [
        ("above", (1.0,), [1.1], [1.0, 0.9]),
        ("below", (1.0,), [0.9], [1.0, 1.1]),
        ("within", (1.0, 2.0), [1.0, 1.5, 2.0], [0.9, 2.1]),
        ("equals", (0.3,), [0.3, 0.1 + 0.2], [0.301]),
    ],
)
def test_comparisons(comparison: str, values: tuple[float, ...], fits: list[float], fails: list[float]) -> None:
    branch = Branch("then", 1, 2, comparison, values)
    assert all(branch.fits(value) for value in fits)
    assert not any(branch.fits(value) for value in fails)


def test_a_plan_is_read_back_from_its_session(tmp_path: Path) -> None:
    plan = deciding_plan(tmp_path)
    text = plan_json(plan.steps)
    assert steps_of(text) == plan.steps
    assert steps_sha256(steps_of(text)) == plan.sha256
    row = next(row for row in json.loads(text) if row["kind"] == "decide")
    assert row["arguments"]["branches"][0] == {
        "outcome": "turn", "first": 5, "stop": 65, "comparison": "below", "values": [35.0],
    }  # fmt: skip


def test_what_a_hold_goes_back_to(tmp_path: Path) -> None:
    """To the reading before it, of a loop the newest; in a procedure to its beginning, where its relays are set."""
    plan = deciding_plan(tmp_path, HEAD + WARM_UP)
    assert [step.retry_step for step in decisions(plan.steps)[:3]] == [3, 6, 9]
    inside = changed("duration: 660 s\n", "", changed("      - settle: 20 s\n", DECIDES))
    plan = compile_sequence(make_bench(tmp_path / "procedure", inside))
    point = next(step for step in plan.steps if isinstance(step, PlannedRecord)).retry_step
    assert decisions(plan.steps)[0].retry_step == point


def if_(test: str) -> str:
    return f"  - if: {{reading: chamber.{test}}}\n    then: [settle: 1 s]\n"


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        (if_("measure_ai, above: 24 degC"), "B-PLAN-110 7 nothing before this step reads chamber.measure_ai"),
        (
            READ + if_("measure_ai, above: 24 degC"),
            "B-PLAN-110 8 nothing before this step reads chamber.measure_ai; did",
        ),
        (READ + if_("measure_air, above: 24 V"), "B-PLAN-111 8 chamber.measure_air is read in degC; 24 V cannot be"),
        (
            READ + if_("measure_air, within: [30 degC, 20 degC]"),
            "B-PLAN-111 8 no reading is within 30 degC and 20 degC",
        ),
        (READ + WHILE.replace("LIMIT", "\n    at_most: 3"), "B-PLAN-110 8 the loop goes by chamber.measure_air, and"),
        (READ + WHILE.replace("LIMIT", ""), "at_most"),
        (READ + if_("measure_air"), "none found"),
        (READ + if_("measure_air, above: 1 V, below: 2 V"), "above and below"),
        (READ + f"finally:\n{if_('measure_air, above: 24 degC')}", "B-PLAN-037 9 a decide step"),
    ],
)
def test_what_cannot_be_decided(tmp_path: Path, steps: str, expected: str) -> None:
    found = errors(tmp_path, steps)
    wanted = ("B-YAML", expected) if not expected.startswith("B-") else (expected, "")
    assert any(line.startswith(wanted[0]) and wanted[1] in line for line in found), found


POINT = """\
      - calibrator.standby
      - switch.route: {channel: "{channel}", polarity: "{polarity}"}
"""
UNSAFE = """\
      - calibrator.standby
      - switch.open_all
      - settle: 20 s
      - dmm.measure_current
      - if: {reading: dmm.measure_current, above: 1 uA}
        then:
          - settle: 10 s
        else:
          - switch.route: {channel: "{channel}", polarity: "{polarity}"}
          - settle: 10 s
"""


def line_of(text: str, word: str) -> int:
    return 1 + next(index for index, line in enumerate(text.splitlines()) if word in line)


def test_an_unsafe_step_in_a_branch_or_behind_it_is_refused_with_its_line(tmp_path: Path) -> None:
    """Only 'else' closes the route: behind 'then' the output would go on into an open circuit."""
    text = changed(POINT, UNSAFE)
    found = [error for error in mistakes(make_bench(tmp_path, text)) if error.code == "B-PLAN-072"]
    (error,) = found
    assert error.where.split(":")[-2] == str(line_of(text, "- calibrator.operate"))
    decided = line_of(text, "- if: {reading: dmm.measure_current")
    assert error.message.endswith(f"without a closed route, where 'if' in line {decided} takes 'then'")
    text = changed(
        POINT,
        UNSAFE.replace("          - settle: 10 s\n        else", "          - calibrator.operate\n        else", 1),
    )
    lines = {error.where.split(":")[-2] for error in mistakes(make_bench(tmp_path, text)) if error.code == "B-PLAN-072"}
    assert str(line_of(text, "          - calibrator.operate")) in lines
    safe = UNSAFE.replace(
        "        then:\n", '        then:\n          - switch.route: {channel: "{channel}", polarity: "{polarity}"}\n'
    )
    text = changed("duration: 660 s\nrecords: 3\n", "", changed(POINT, safe))
    assert [str(error) for error in mistakes(make_bench(tmp_path, text))] == []


def test_a_level_that_only_one_branch_sets_has_no_range(tmp_path: Path) -> None:
    """What the compiler fills in behind a decision must be the same on every way."""
    level = '      - calibrator.output: {current: "{current}", range: lowest_that_holds}\n'
    branch = UNSAFE + '      - switch.route: {channel: "{channel}", polarity: "{polarity}"}\n'
    branch = branch.replace("        then:\n", "        then:\n    " + level)
    text = changed(POINT, branch, changed(level, ""))
    assert any("not the same on every way" in error.message for error in mistakes(make_bench(tmp_path, text)))


def test_the_chamber_of_a_record_is_where_every_way_has_sent_it(tmp_path: Path) -> None:
    warmer = READ + (
        "  - if: {reading: chamber.measure_air, below: 24 degC}\n    then:\n"
        "      - chamber.set_temperature: {temperature: 40 degC, ramp: 5 degC/min}\n"
        "  - settle: 10 s\n"
        "  - record: {seconds: 60 s, readings: [chamber.measure_air], conditions: {temperature: 40 degC}}\n"
    )
    cold = "  - chamber.set_temperature: {temperature: 23 degC, ramp: 5 degC/min}\n  - settle: 10 s\n"
    (found,) = errors(tmp_path, cold + warmer)
    assert found.startswith("B-PLAN-076 14")
    assert found.endswith("the chamber is at 23 degC, where 'if' in line 10 takes 'else'")


def test_a_record_does_not_follow_one_across_a_decision(tmp_path: Path) -> None:
    record = '{seconds: 10 s, follows: true, conditions: {current: "{current}", polarity: "{polarity}"}}'
    branch = "      - dmm.measure_current\n      - if: {reading: dmm.measure_current, above: 1 A}\n"
    branch += f"        then: [record: {record}]\n"
    text = changed("      - verify: calibrator.operating\n", branch)
    assert any(error.code == "B-PLAN-067" for error in mistakes(make_bench(tmp_path, text)))


class Sum(Followed):
    """A state that two branches may or may not leave the same."""

    total = 0

    def key(self) -> int:
        return self.total


def test_ways_are_joined_where_nothing_differs(tmp_path: Path) -> None:
    """A loop of twenty turns that counts them has twenty-one ends by another way of counting, one if nothing counts."""
    plan = deciding_plan(tmp_path, HEAD + WARM_UP)

    class Count(Sum):
        def take(self, step: Step) -> None:
            self.total += step.kind == "record"

    class Nothing(Sum):
        most = 0

        def take(self, step: Step) -> None:
            Nothing.most += step.number == plan.steps[-1].number

    ends = walk(plan.steps, Findings(), Count(), Nothing())
    assert [{state.key() for state in states} for states in ends] == [set(range(TURNS + 1)), {0}]
    assert Nothing.most <= 2


NESTED = """\
  - while: {reading: chamber.measure_air, above: 24 degC}
    at_most: 200
    do:
      - chamber.measure_air
      - if: {reading: chamber.measure_air, above: 30 degC}
        then:
          - meter.measure_resistance: {range: 1 kohm, cycles: 1}
          - while: {reading: meter.measure_resistance, above: 100 ohm}
            at_most: 3
            do: [meter.measure_resistance: {range: 1 kohm, cycles: 1}]
        else:
          - chamber.set_temperature: {temperature: 25 degC, ramp: 1 degC/min}
          - chamber.run
  - settle: SETTLE
"""


def test_a_long_loop_is_proved_without_a_state_for_each_turn(tmp_path: Path) -> None:
    """Only the bus time grows with the turns, and of it the longest counts: that of 'then' with all of its turns."""
    assert errors(tmp_path, READ + "  - settle: 10 s\n" + NESTED.replace("SETTLE", "61 min")) == []
    (found,) = errors(tmp_path, READ + "  - settle: 10 s\n" + NESTED.replace("SETTLE", "1 min"))
    air_s, meter_s = 0.1, driver_actions("agilent_34401a")["measure_resistance"].bus_s
    assert f"B-PLAN-060 22 the calls before it take up to {200 * (air_s + 4 * meter_s):g} s; it lasts 60 s" in found


def test_too_many_ways_are_refused(tmp_path: Path) -> None:
    fork = "  - if: {{reading: chamber.measure_air, above: {} degC}}\n    then: [settle: 1 s]\n"
    text = HEAD.replace("analysis: probe_means\n", "") + READ + "".join(fork.format(20 + index) for index in range(7))
    plan = compile_sequence(sequence_file(tmp_path, text))

    class Binary(Sum):
        def take(self, step: Step) -> None:
            self.total += (step.kind == "settle") << step.number

    findings = Findings()
    walk(plan.steps, findings, Binary())
    assert MOST_WAYS < 2**7
    (error,) = findings.all()
    assert (error.code, error.where.split(":")[-2]) == ("B-PLAN-112", str(8 + 2 * 6))
