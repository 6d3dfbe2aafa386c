"""Walks over all drivers: what every one of them must declare and do; numbers sent with every digit."""

import importlib
import inspect
import math
import pkgutil
import re
from pathlib import Path
from typing import Any

import pytest
from exchanges import CONTROLS, IDENTIFY, MAKE_SAFE, exchange, said
from hypothesis import given
from hypothesis import strategies as st
from scripted import CLEAR, SILENT, TIMEOUT, make, refused, scripted

import instruments
from bench.model.drivers import Manual, manual_of
from bench.model.errors import InputError, InstrumentError
from bench.model.ports import Effect, Parameter, actions_of
from bench.model.units import parse_quantity
from instruments.values import (
    OverloadReadingError,
    check_argument,
    exponent_form,
    plain_form,
    read_integer,
    read_number,
    read_text,
)

MODULES = [module.name for module in pkgutil.iter_modules(instruments.__path__)]
DRIVERS = [name for name in MODULES if hasattr(importlib.import_module(f"instruments.{name}"), "DRIVER")]
SHARED = {"acutrol_axis", "base", "bus", "commands", "ladder", "scpi", "transport", "values", "wire"}
TOP = Path(__file__).parents[2]
VERBS = ("Set", "Get", "Control", "Measure")
QUESTIONS = ("*IDN?", "IDEN?", "END ALWAYS;QFORMAT NORM", "ID?", "OUTX 1;*IDN?", "V", "N1C1 RB D")  # who is there
LATER = ("hp_3458a",)  # its question is the third thing that is sent


def driver_class(name: str) -> Any:
    return importlib.import_module(f"instruments.{name}").DRIVER


def wrong_values(parameter: Parameter) -> list[object]:
    """Values the parameter must refuse."""
    wrong: list[object] = [math.nan, math.inf, -math.inf, None, "x", True]
    if parameter.low is not None:
        wrong.append(math.nextafter(parameter.low, -math.inf))
    if parameter.high is not None:
        wrong.append(math.nextafter(parameter.high, math.inf))
    return wrong


def good_value(parameter: Parameter) -> Any:
    return parameter.choices[0] if parameter.choices else parameter.high


CASES = [
    (name, action.name, parameter.name)
    for name in DRIVERS
    for action in actions_of(driver_class(name)).values()
    for parameter in action.parameters
]


def test_every_driver_is_known_to_the_walk_and_listed() -> None:
    assert set(MODULES) - SHARED == set(DRIVERS) == set(IDENTIFY) == set(MAKE_SAFE)
    listed = (TOP / "docs" / "instruments.md").read_text(encoding="utf-8")
    assert [name for name in DRIVERS if f"| [`{name}`](" not in listed] == []


def test_every_code_of_an_instrument_is_asserted() -> None:
    raised, asserted = (
        {code for path in (TOP / folder).glob(names) for code in re.findall(pattern, path.read_text("utf-8"))}
        for folder, names, pattern in (
            ("instruments", "*.py", r"B-INST-\d{3}"),
            ("tests/protocol", "test_*.py", r'(?:code == |refuse[ds]\(|, )"(B-INST-\d{3})"'),
        )
    )
    assert raised
    assert raised - asserted == set()


@pytest.mark.parametrize("name", DRIVERS)
def test_declarations(name: str) -> None:
    driver = driver_class(name)
    assert re.fullmatch("[a-z0-9_]+", name)
    re.compile(driver.identity_pattern)
    assert driver.safe_state
    assert "Source:" in importlib.import_module(f"instruments.{name}").__doc__
    actions = actions_of(driver)
    assert actions
    for action in actions.values():
        assert isinstance(action.effect, Effect)
        assert 0 < action.bus_s <= 15
        method = getattr(driver, action.name)
        assert inspect.getdoc(method).split()[0] in VERBS, action.name
        arguments = list(inspect.signature(method).parameters.values())[1:]
        assert [argument.name for argument in arguments] == [parameter.name for parameter in action.parameters]
        for argument, parameter in zip(arguments, action.parameters, strict=True):
            assert parameter.required is (argument.default is inspect.Parameter.empty)
            if parameter.choices:
                assert parameter.dimension == ""
            else:
                parse_quantity(f"1 {parameter.dimension}", parameter.dimension)
                assert parameter.low is not None
                assert parameter.high is not None
                assert parameter.low < parameter.high
    effects = {action.effect for action in actions_of(driver_class(name)).values()}
    if Effect.STIMULUS_ON in effects:
        assert Effect.STIMULUS_OFF in effects
    if Effect.ROUTE in effects:
        assert Effect.ROUTES_OPEN in effects
    if Effect.MOTION_ON in effects:
        assert Effect.MOTION_OFF in effects


@pytest.mark.parametrize(("name", "action", "wrong"), CASES)
def test_wrong_arguments_are_rejected_before_anything_is_sent(name: str, action: str, wrong: str) -> None:
    driver = make(name, [])
    parameters = actions_of(driver_class(name))[action].parameters
    left_out = inspect.signature(getattr(driver, action)).parameters[wrong].default
    for value in wrong_values(next(parameter for parameter in parameters if parameter.name == wrong)):
        if value is None and left_out is None:
            continue
        arguments = {parameter.name: good_value(parameter) for parameter in parameters} | {wrong: value}
        with refused("B-INST-008", f"{action}: {wrong}") as caught:
            getattr(driver, action)(**arguments)
        assert caught.value.where == "unit_of_test (GPIB0::4::INSTR)"
        assert repr(value) in str(caught.value)


@pytest.mark.parametrize("name", DRIVERS)
def test_safe_state_is_reached_twice_in_a_row(name: str) -> None:
    """Before it is prepared, and behind it."""
    with scripted(name, exchange(name, "<who> | <safe> | <start> | <safe> | <safe>")) as driver:
        driver.make_safe()
        driver.identify()
        driver.make_safe()
        driver.make_safe()


@pytest.mark.parametrize("name", DRIVERS)
def test_identity_is_checked_first_and_a_stranger_gets_no_other_command(name: str) -> None:
    questions = [pair for pair in IDENTIFY[name] if isinstance(pair[0], bytes) and said(pair[0]) in QUESTIONS]
    once = [*questions[:-1], (questions[-1][0], b"ACME,9999,0,1" + driver_class(name).reply_end.encode())]
    strange = [*once, (CLEAR, None), *once]
    for method, arguments in (("make_safe", ()), ("identify", ()), ("raw", ("*RST",)), ("set", ("OUTP ON",))):
        with scripted(name, strange) as driver, refused("B-INST-002", "9999"):
            getattr(driver, method)(*arguments)
        assert driver.identity is None


@pytest.mark.parametrize("name", DRIVERS)
def test_every_action_identifies_first(name: str) -> None:
    """On a mute bus no action gets further than the question who is there."""
    first = IDENTIFY[name][0][0]
    for action in actions_of(driver_class(name)).values():
        driver = make(name, [])
        sent: list[str] = []
        driver.test_resource.write = sent.append
        driver.test_resource.read = driver.test_resource.clear = lambda: (_ for _ in ()).throw(OSError("mute"))
        with pytest.raises(InstrumentError) as caught:
            getattr(driver, action.name)(**{parameter.name: good_value(parameter) for parameter in action.parameters})
        refused_unset = caught.value.code == "B-INST-010" and sent == []
        refused_limits = caught.value.code == "B-INST-008" and sent == []
        asked = caught.value.code == "B-INST-003" and sent[0].strip(CONTROLS) == said(first)
        assert refused_unset or refused_limits or asked, (action.name, caught.value, sent)
        assert {text.strip(CONTROLS) for text in sent} <= set(QUESTIONS)


@pytest.mark.parametrize("name", DRIVERS)
def test_a_mute_instrument_times_out(name: str) -> None:
    question = IDENTIFY[name][2 if name in LATER else 0][0]
    driver = make(name, [])
    resource = driver.test_resource
    resource.write = lambda command: resource.events.append(("read", TIMEOUT))
    resource.clear, resource.read_stb = resource.events.clear, lambda: 0
    with refused("B-INST-001", re.escape(said(question))):
        driver.identify()


@pytest.mark.parametrize("name", DRIVERS)
def test_by_hand_a_command_goes_out_once(name: str) -> None:
    reply = b"1 2 3" + driver_class(name).reply_end.encode()
    with scripted(name, [*IDENTIFY[name], (b"XYZ?\n", reply), (b"XYZ 1\n", None)]) as driver:
        assert driver.raw("XYZ?") == "1 2 3"
        assert driver.raw("XYZ 1") is None
    with scripted(name, [*IDENTIFY[name], (b"XYZ?\n", TIMEOUT), *SILENT]) as driver, refused("B-INST-001", "XYZ"):
        driver.raw("XYZ?")


@pytest.mark.parametrize("name", DRIVERS)
def test_options_that_are_unknown_or_impossible_are_told(name: str) -> None:
    """The defaults are right, no word is right everywhere, and whatever a YAML file may hold is judged."""
    driver = driver_class(name)
    assert driver.wrong_option(driver.default_options) is None
    for option in driver.default_options:
        option_is_wrong = [
            driver.wrong_option({**driver.default_options, option: value})
            for value in ("nonsense", ["x"], [True], True, -1e9, 1e9, math.nan, math.inf)
        ]
        assert all(wrong is not None and wrong[0] == option and option in wrong[1] for wrong in option_is_wrong)
    with pytest.raises(InputError, match=r"B-INST-020: .*unknown option 'colour'"):
        make(name, [], colour="red")


@pytest.mark.parametrize("name", DRIVERS)
def test_a_model_that_can_be_on_says_by_which_replies(name: str) -> None:
    manual, tells = manual_of(name), driver_class(name).tells
    can_be_on = any(command.touch in ("energises", "moves") for command in manual.commands.values())
    assert can_be_on == (tells is not None)
    if tells is not None:
        forms = {question: manual.find(question) for question in (*tells.on, *tells.figures)}
        assert {question for question, form in forms.items() if form is None} == set()
        assert {manual.commands[form].touch for form in forms.values() if form is not None} == {"asks"}


@pytest.mark.parametrize("name", DRIVERS)
def test_rows_of_the_state_table_name_what_there_is(name: str) -> None:
    manual, driver = manual_of(name), make(name, [])
    for row, one in manual.states.items():
        assert set(one.when) <= {"prepare", "make_safe", *driver.actions}, row
        assert set(one.words) <= set(driver.station_words), row


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ({"source": "nowhere", "set": "A"}, "cites none of the sources: guide"),
        ({"source": "guide", "by": ["B"]}, "names 'B', which is none of the commands"),
        ({"source": "guide", "ask": "A?"}, "write what is right, or the bits of it"),
        ({"source": "guide"}, "neither set nor asked: write why"),
        ({"source": "guide", "ask": "A?", "right": "1"}, "write why, and what a person does"),
    ],
)
def test_a_row_that_says_too_little_is_refused(row: dict[str, Any], said: str) -> None:
    commands = {"A": {"source": "guide", "touch": "sets"}, "A?": {"source": "guide", "reply": "1"}}
    with pytest.raises(ValueError, match=re.escape(said)):
        Manual(instrument="X", sources={"guide": "a guide"}, commands=commands, states={"one": row})


FINITE = st.floats(allow_nan=False, allow_infinity=False)


@given(FINITE)
def test_what_is_written_loses_nothing(value: float) -> None:
    assert float(exponent_form(value)) == value
    text = plain_form(value)
    assert float(text) == value
    assert "e" not in text.lower()


@pytest.mark.parametrize(("value", "text"), [(-10.0, "-10"), (0.5, "0.5"), (100.0, "100"), (0.0, "0"), (-0.0, "0")])
def test_plain_form(value: float, text: str) -> None:
    assert plain_form(value) == text


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_non_finite_is_never_written(value: float) -> None:
    for form in (exponent_form, plain_form):
        with pytest.raises(ValueError, match="not finite"):
            form(value)


@pytest.mark.parametrize("reply", ["ERROR", "", "1.2.3", "nan", "inf", "-Infinity", "1_000", "0x10", "1,2", "1E400"])
def test_garbage_is_no_number(reply: str) -> None:
    with pytest.raises(ValueError, match="number is due"):
        read_number(reply)


@pytest.mark.parametrize("reply", ["9.9E37", "-9.90000000E+37", "9.91E37", "1E+38", "-1e38"])
def test_overload_sentinels(reply: str) -> None:
    with pytest.raises(OverloadReadingError):
        read_number(reply)


def test_numbers() -> None:
    assert read_number("+1.00000000E+07") == 1e7
    assert read_integer("+4097") == 4097
    assert read_text("x") == "x"
    with pytest.raises(ValueError, match="integer"):
        read_integer("1.5")
    with pytest.raises(ValueError, match="empty"):
        read_text("")


@pytest.mark.parametrize("value", [True, "1", None, math.nan, math.inf, 2.3, -0.1, [1]])
def test_quantity_arguments_are_rejected_not_clipped(value: object) -> None:
    with pytest.raises(ValueError, match="current"):
        check_argument(Parameter("current", "A", 0.0, 2.2), value)


@pytest.mark.parametrize("value", [True, 11, "1", 1.5, math.nan, None])
def test_choices(value: object) -> None:
    parameter = Parameter("channel", choices=tuple(range(1, 11)))
    with pytest.raises(ValueError, match="channel"):
        check_argument(parameter, value)
    assert repr(check_argument(parameter, 10.0)) == "10"


def test_limits_are_inside() -> None:
    parameter = Parameter("current", "A", 0.0, 2.2)
    assert check_argument(parameter, 2.2) == 2.2
    assert check_argument(parameter, 0) == 0.0
    with pytest.raises(ValueError, match=r"2\.2000000000000006 A is above 2\.2"):
        check_argument(parameter, math.nextafter(2.2, 3))
