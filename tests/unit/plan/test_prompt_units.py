"""The value of a prompt takes every unit of the product: plan, question, answer and what a person is shown."""

from __future__ import annotations

from pathlib import Path

import pytest
from plan_sample import changed, make_bench, mistakes

from bench.model.events import Prompt
from bench.model.units import parse_quantity
from bench.plan import PlannedPrompt, compile_sequence
from bench.run.control.asking import Refused, _judged
from bench.run.control.operator import Question, limits_of

ASKED = "value: {unit: ohm, high: 0.5 ohm}"


def prompt_of(folder: Path, value: str) -> PlannedPrompt:
    plan = compile_sequence(make_bench(folder, changed(ASKED, f"value: {value}")))
    return next(step for step in plan.steps if isinstance(step, PlannedPrompt))


def question_of(step: PlannedPrompt) -> Question:
    return Question(step.text, step.confirm, step.unit, step.low, step.high)


@pytest.mark.parametrize(
    ("unit", "written", "base", "high"),
    [
        ('"%"', "80 %", "1", 0.8),
        ("ppm", "20 ppm", "1", 20e-6),
        ("mA", "5 mA", "A", 5e-3),
        ("V", "230 mV", "V", 0.23),
        ("Hz", "10 MHz", "Hz", 1e7),
        ("min", "2 min", "s", 120.0),
        ("uC", "1.25 uC", "C", 1.25e-6),
        ("kohm", "0.5 Mohm", "ohm", 5e5),
        ("W", "1 kW", "W", 1e3),
        ("nF", "10 nF", "F", 1e-8),
        ("degC", "23 °C", "degC", 23.0),
        ("degC/min", "0.5 degC/min", "degC/min", 0.5),
        ("arcmin", "30 arcmin", "deg", 0.5),
        ("deg/h", "3600 deg/h", "deg/s", 1.0),
        ("deg/s2", "2 deg/s2", "deg/s2", 2.0),
        ("mg", "1 g", "g", 1.0),
        ("m/s", "3 m/s", "m/s", 3.0),
        ("m/s2", "9.81 m/s²", "m/s2", 9.81),
        ("gauss", "500 mgauss", "gauss", 0.5),
        ("mm", "26 mm", "m", 0.026),
        ("ppm/degC", "5 ppm/degC", "1/degC", 5e-6),
        ("ppm/degC2", "5 ppm/degC2", "1/degC2", 5e-6),
    ],
)
def test_every_kind_of_unit(tmp_path: Path, unit: str, written: str, base: str, high: float) -> None:
    step = prompt_of(tmp_path, f"{{unit: {unit}, high: {written}}}")
    assert step.unit == base
    assert step.high == pytest.approx(high, rel=1e-15)
    answer = _judged(question_of(step), written, "somebody")
    assert answer.value == step.high


def test_a_ratio_is_asked_for_and_told_in_percent(tmp_path: Path) -> None:
    """Humidity of the room, for example: 45 % is 0.45 in session and results."""
    step = prompt_of(tmp_path, '{unit: "%", low: 20 %, high: 60 %, quantity: humidity}')
    question = question_of(step)
    assert (step.low, step.high, limits_of(question)) == (0.2, 0.6, "20 % to 60 %")
    assert _judged(question, "45 %", "somebody").value == parse_quantity("45 %", "1") == 0.45
    assert limits_of(Question("humidity", unit="1")) == "%"
    with pytest.raises(Refused, match="70 % is outside the limits"):
        _judged(question, "70 %", "somebody")
    with pytest.raises(Refused, match="a value in % is due"):
        _judged(question, "", "somebody")
    told = Prompt(step=0, text="humidity", confirm="operator", by="somebody", value=0.45, unit="1", low=0.2, high=0.6)
    assert told.sentence == "humidity 45 % (somebody)"


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ("{unit: MM, high: 1 mm}", "'MM' is no unit; did you mean 'mm'?"),
        ("{unit: furlong, high: 1 m}", "'furlong' is no unit; use one of: %, "),
        ('{unit: "%", high: 1 mm}', "'1 mm' is in m; a ratio is due"),
    ],
)
def test_a_unit_that_is_none(tmp_path: Path, value: str, expected: str) -> None:
    found = mistakes(make_bench(tmp_path, changed(ASKED, f"value: {value}")))
    assert any(expected in error.message for error in found), [str(error) for error in found]
