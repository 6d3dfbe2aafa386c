"""Units that are out of limits before power: they fail, whoever comes next is tested, and no way leads round it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from gnc_exchanges import exchanges, material
from rehearsal import SEED, Watched, go_on

from bench.analysis import Analysis, GivenValue
from bench.model.clock import VirtualClock
from bench.model.errors import OperatorStop
from bench.plan import compile_sequence
from bench.record import SessionReader
from bench.run.control.asking import _judged
from bench.run.control.operator import Answer, Question, SimulatedOperator
from bench.run.session import Conducted, conduct
from bench.session.service import read_view
from bench.session.view import analyse_view
from bench.systems.gnc.unit_test.analysis import analyse


class Gauge(SimulatedOperator):
    """Answers like the simulated operator, but for some questions."""

    def __init__(self, values: dict[str, float]) -> None:
        self._values = values

    def ask(self, question: Question) -> Answer:
        found = [value for text, value in self._values.items() if text in question.text]
        return Answer("somebody", found[0]) if found else super().ask(question)


def run_units(out: Path, values: dict[str, float], *units: str) -> tuple[Conducted, Analysis]:
    plan = compile_sequence("gnc_unit_test", None, {"units": ",".join(units)})
    done = conduct(
        plan, clock=VirtualClock(), seed=SEED, out=out, operator=Gauge(values),
        listener=Watched(lambda world, step: None, worlds=[None]),  # type: ignore[list-item]
    )  # fmt: skip
    return done, analyse_view(read_view(done.folder))[1]


def verdicts_of(analysis: Analysis) -> dict[str, str]:
    return {row[0]: row[-1] for row in analysis.tables[0].rows}


def test_a_unit_that_is_too_wide_fails_and_the_batch_goes_on(tmp_path: Path) -> None:
    done, analysis = run_units(tmp_path, {"GNC-01: width": 0.027}, "GNC-01", "GNC-02")
    assert done.outcome.error is None
    assert verdicts_of(analysis) == {"GNC-01": "FAIL", "GNC-02": "PASS"}
    found = {(one["quantity"], one["conditions"]["unit"]): one for one in analysis.estimates}
    assert found["width", "GNC-01"]["value"] == 0.027
    assert found["width_beyond_limits", "GNC-01"]["value"] == pytest.approx(0.001)
    assert found["width_beyond_limits", "GNC-01"]["verdict"] == "fail"
    assert found["width_beyond_limits", "GNC-02"]["verdict"] == "pass"
    (size, *_) = next(table.rows for table in analysis.tables if table.title.startswith("Table 3"))
    assert size[4:] == ["GNC-01", "FAIL"]
    assert found["cpu_wrong", "GNC-01"]["verdict"] == "pass"
    (prompt,) = [one for _, _, one in SessionReader(done.folder).events("prompt") if "GNC-01: width" in one["text"]]
    assert (prompt["quantity"], prompt["conditions"]["unit"]) == ("width", "GNC-01")


def given(quantity: str, value: float | None, low: float | None, high: float | None, unit: str = "ohm") -> GivenValue:
    return GivenValue(80.0, 0, quantity, value, unit, low, high, {"unit": "GNC-01"})


@pytest.mark.parametrize(
    ("check", "fails"),
    [
        (given("width", 0.026, 0.020, 0.026, "m"), False),
        (given("width", 0.0260001, 0.020, 0.026, "m"), True),
        (given("width", 0.019, 0.020, 0.026, "m"), True),
        (given("width", 0.027, 0.020, 0.028, "m"), True),  # the specification says 26 mm, whatever the question says
        (given("insulation_resistance", 1e7, 1e7, None), False),
        (given("insulation_resistance", 9.9e6, 1e7, None), True),
        (given("continuity_resistance", 1.5, 1e-3, 1.0), True),
        (given("insulation_resistance", None, 1e7, None), True),
        (given("insulation_resistance", math.nan, 1e7, None), True),
    ],
)
def test_each_check_is_judged_by_its_limits(check: GivenValue, fails: bool) -> None:
    analysis = analyse_given([check])
    assert analysis.tables[0].rows[0][-1] == ("FAIL" if fails else "PASS")
    (wrong,) = [one for one in analysis.estimates if one["quantity"] == "static_wrong"]
    assert (wrong["value"], wrong["verdict"]) == ((1.0, "fail") if fails else (0.0, "pass"))


def analyse_given(values: list[GivenValue], **more: Any) -> Analysis:
    return analyse(replace(material(exchanges(), **more), given=values))


def test_a_unit_without_the_checks_of_the_others_does_not_pass() -> None:
    both = [*exchanges("GNC-01"), *exchanges("GNC-02", 100)]
    analysis = analyse(replace(material(both), given=[given("width", 0.025, 0.02, 0.026, "m")]))
    assert "unit GNC-02: static check was not tested" in analysis.missing
    assert verdicts_of(analysis)["GNC-02"] == "not tested"


def test_whoever_answers_is_not_refused_a_value_out_of_limits() -> None:
    asked = Question("width", unit="m", low=0.02, high=0.026, quantity="width")
    assert _judged(asked, "27 mm", "somebody").value == 0.027


@pytest.mark.parametrize(
    ("text", "value"), [("GNC-01: smallest insulation", 1e5), ("GNC-01: resistance from 5 V", 0.5)]
)
def test_a_unit_with_a_short_is_never_powered(tmp_path: Path, text: str, value: float) -> None:
    done, analysis = run_units(tmp_path, {text: value}, "GNC-01", "GNC-02")
    assert done.outcome.error is None
    assert verdicts_of(analysis) == {"GNC-01": "FAIL", "GNC-02": "PASS"}
    items = dict(zip(analysis.tables[1].headers, analysis.tables[1].rows[0], strict=True))
    assert items.pop("static check") == "FAIL"
    assert {verdict for name, verdict in items.items() if name not in ("unit", "identity")} == {"not tested"}
    # off for the first unit, on and off for the second, then the end of every run
    assert switched(done.folder)[:3] == ["OUTP OFF", "OUTP ON", "OUTP OFF"]
    assert switched(done.folder).count("OUTP ON") == 1
    units = {fields["conditions"]["unit"] for _, _, fields in SessionReader(done.folder).events("exchange")}
    assert units == {"GNC-02"}
    (skip,) = [fields for _, _, fields in SessionReader(done.folder).events("skip")]
    plan = compile_sequence("gnc_unit_test", None, {"units": "GNC-01,GNC-02"})
    left_out = plan.steps[skip["first"] : skip["stop"]]
    assert {step.conditions["unit"] for step in left_out} == {"GNC-01"}
    assert plan.steps[skip["stop"]].conditions["unit"] == "GNC-02"


class Leaver(Gauge):
    """Ends the run at the first question about the second unit."""

    def ask(self, question: Question) -> Answer:
        if "GNC-02" in question.text:
            raise OperatorStop("B-CLI-006", "the operator refused a prompt", where="prompt")
        return super().ask(question)


def test_a_run_that_is_gone_on_with_does_not_power_the_unit_either(tmp_path: Path) -> None:
    plan = compile_sequence("gnc_unit_test", None, {"units": "GNC-01,GNC-02"})
    done = conduct(
        plan, clock=VirtualClock(), seed=SEED, out=tmp_path, operator=Leaver({"GNC-01: resistance from 5 V": 0.5}),
        listener=Watched(lambda world, step: None, worlds=[None]),  # type: ignore[list-item]
    )  # fmt: skip
    assert done.outcome.error is not None
    run = go_on(done.folder, Watched(lambda world, step: None, worlds=[None]))  # type: ignore[list-item]
    assert run.outcome.error is None
    analysis = analyse_view(read_view(done.folder))[1]
    assert verdicts_of(analysis) == {"GNC-01": "FAIL", "GNC-02": "PASS"}
    assert switched(done.folder).count("OUTP ON") == 1


def switched(folder: Path) -> list[str]:
    """Commands that switched the supply, from the first static check on."""
    found = [one.document() for one in SessionReader(folder).messages() if one.topic.endswith("/supply")]
    sent = [str(one["text"]) for one in found if one["direction"] == "tx"]
    begun = max(number for number, text in enumerate(sent) if text.startswith("VOLT "))
    return [text for text in sent[begun:] if text in ("OUTP ON", "OUTP OFF")]
