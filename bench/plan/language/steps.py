"""The kinds of step a sequence can hold. A step is one word, or a mapping whose key says what it is."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    GetJsonSchemaHandler,
    RootModel,
    Tag,
    WithJsonSchema,
    model_validator,
)

from bench.model.units import dimension_of, parse_quantity
from bench.model.yamlio import NAME_PATTERN, Name, StrictModel, characters
from bench.plan.language.expect import Comparison, ReadingExpect, ReplyExpect, SignalExpect, with_expect
from bench.plan.values import ACTION_PATTERN, ActionName, Scalar, templated, within

Arguments = dict[Name, Scalar]
Text = Annotated[str, characters(2000)]


def _with_unit(value: object) -> object:
    if isinstance(value, int | float):
        raise ValueError(f"{value} has no unit; write a quantity, for example '26 mm'")
    return value


class PromptValue(StrictModel):
    """A value the operator must give, inside limits.

    With a ``quantity`` it is a measurement of the unit: the run goes on with any value, and the analysis judges it. If
    one that is ``required`` is outside its limits, what follows under the same conditions is left out.
    """

    unit: Annotated[str, AfterValidator(dimension_of)] = Field(description="any unit, '%' among them")
    low: Annotated[Text | None, BeforeValidator(_with_unit)] = None
    high: Annotated[Text | None, BeforeValidator(_with_unit)] = None
    quantity: Name | None = None
    uncertainty: Annotated[Text | None, BeforeValidator(_with_unit)] = Field(
        None, description="95 %, of the gauge that a person measures with"
    )
    required: bool = False

    @model_validator(mode="after")
    def _measured(self) -> PromptValue:
        if self.required and self.quantity is None:
            raise ValueError("'required' is for a value with a 'quantity'; any other must be inside its limits anyway")
        if self.uncertainty is not None and self.quantity is None:
            raise ValueError("'uncertainty' is for a value with a 'quantity', which the analysis judges")
        return self


class Prompt(StrictModel):
    """Something only a person can do; waits for the confirmation. ``{name}`` in the text is that variable.

    ``sets`` says what the person's act changes on the bench, for example which unit sits on the test board.
    ``presence: anywhere`` is for what needs no hands, wiring, doors or mounting: it may be answered from elsewhere.
    """

    text: Text
    confirm: Literal["operator"] = "operator"
    value: PromptValue | None = None
    sets: Arguments = Field(default_factory=dict)
    presence: Literal["bench", "anywhere"] = Field("bench", description="where whoever answers has to be")

    @model_validator(mode="after")
    def _hands(self) -> Prompt:
        if self.sets and self.presence == "anywhere":
            raise ValueError("what a person changes ('sets') is done at the bench; leave 'presence: anywhere' out")
        return self


Duration = Annotated[Any, *templated("s", 0.0, 1e7)]
_CLOCK = re.compile(r"(\d{1,3}):([0-5]\d):([0-5]\d)")
VERBS = ("for", "if", "while", "choose", "settle", "record", "soak", "prompt", "verify", "unit", "test", "send")
EXPECT = "expect"


def _one_entry(value: dict[Any, Any]) -> dict[Any, Any]:
    if len(value) != 1:
        raise ValueError(f"one entry is due, {len(value)} found")
    return value


class _OrText:
    """JSON Schema of a field that may also be written as one text."""

    def __get_pydantic_json_schema__(self, core: Any, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"anyOf": [{"type": "string"}, handler(core)]}


def _or_text(key: str) -> tuple[BeforeValidator, _OrText]:
    """Pydantic annotation: a mapping, or a text that is the value of this key of it."""
    return BeforeValidator(lambda value: {key: value} if isinstance(value, str) else value), _OrText()


def _clock_time(value: object) -> float:
    match = _CLOCK.fullmatch(value) if isinstance(value, str) else None
    if match is None:
        return within(parse_quantity(value, "s"), "s", 0.0, 1e7)
    hours, minutes, seconds = (int(part) for part in match.groups())
    return 3600.0 * hours + 60.0 * minutes + seconds


class Stable(StrictModel):
    """When the temperature counts as reached: inside ``within`` of the target during the last ``for``."""

    within: Annotated[Any, *templated("degC", 0.0, 100.0)]
    for_: Duration = Field(alias="for")
    sensor: Literal["unit", "air"] = "unit"


class Done(StrictModel):
    """When a soak is over before its slot is: by the unit's thermal lag, but not before ``least``."""

    residual: Annotated[Any, *templated("degC", 0.0, 100.0)] = Field(
        description="how far from where it is going the unit is at most"
    )
    least: Duration


class Soak(StrictModel):
    """A slot of fixed length, or with ``done`` of that length at most: ramp the chamber to a temperature and wait."""

    chamber: Name = "chamber"
    temperature: Annotated[Any, *templated("degC")]
    ramp: Annotated[Any, *templated("degC/min", 0.0)]
    slot: Duration
    stable: Stable
    late: Literal["hold", "abort", "skip"] = "hold"
    hold_limit: Duration | None = None
    done: Done | None = None


def _call_form(pattern: str) -> tuple[BeforeValidator, AfterValidator, WithJsonSchema]:
    """Pydantic annotation: one name with its arguments, or the name alone."""
    values = {"type": ["string", "number", "boolean"]}
    arguments = {"anyOf": [{"type": "object", "additionalProperties": values}, {"type": "null"}]}
    named = {"type": "object", "patternProperties": {pattern: arguments}, "additionalProperties": False}
    schema = {"anyOf": [{"type": "string", "pattern": pattern}, {**named, "maxProperties": 1}]}
    named_alone = BeforeValidator(lambda value: {value: None} if isinstance(value, str) else value)
    return named_alone, AfterValidator(_one_entry), WithJsonSchema(schema)


class CallStep(RootModel[Annotated[dict[ActionName, Arguments | None], *_call_form(f"^{ACTION_PATTERN}$")]]):
    """An action of an instrument: ``calibrator.standby`` or ``switch.route: {channel: 1, polarity: +}``."""


class ReadStep(StrictModel):
    """An action that reads, and what is expected of it: ``meter.measure_voltage``, beside it ``expect``."""

    call: CallStep
    expect: ReadingExpect

    @model_validator(mode="before")
    @classmethod
    def _split(cls, value: object) -> object:
        if not isinstance(value, dict) or EXPECT not in value:
            return value
        return {"call": {name: given for name, given in value.items() if name != EXPECT}, EXPECT: value[EXPECT]}

    @classmethod
    def __get_pydantic_json_schema__(cls, core: Any, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        fields = handler.resolve_ref_schema(handler(core))["properties"]
        call = handler.resolve_ref_schema(fields["call"])
        return with_expect(call, fields[EXPECT])


def _reading_tag(value: object) -> str:
    return "<read>" if isinstance(value, ReadStep) or (isinstance(value, dict) and EXPECT in value) else "<call>"


Reading_ = Annotated[
    Annotated[CallStep, Tag("<call>")] | Annotated[ReadStep, Tag("<read>")], Discriminator(_reading_tag)
]


class Until(StrictModel):
    """End a point when its mean is known well enough: it lasts ``least`` to ``most`` times the length of a record."""

    random: Scalar = Field(description="standard uncertainty of the mean by noise and quantisation: '2 ppm', '5 nA'")
    most: int = Field(strict=True, ge=1, le=1000)
    least: int | None = Field(None, strict=True, ge=1, le=1000, description="1 if left out, by scatter 10")
    by: Literal["noise", "scatter"] = Field("noise", description="noise as declared, or scatter of the least records")


class Record(StrictModel):
    """Take a record of the counted link, or of readings where there is no link.

    It is taken again up to ``retry`` times when more than ``max_lost`` of its frames or readings is lost.
    """

    seconds: Duration
    readings: list[Reading_] = Field(default_factory=list, description="actions that measure, read one after another")
    every: Duration | None = Field(None, description="all of 'readings' are taken again after this time")
    expect: list[SignalExpect] = Field(default_factory=list, description="of numbers that the unit streams meanwhile")
    windows: int | None = Field(None, strict=True, ge=1, le=10_000, description="this many records without a gap")
    follows: bool = Field(False, strict=True, description="begins with the frame behind the record before it")
    pulse_timing: bool = Field(False, strict=True, description="keep when in the record the pulses came")
    samples: bool = Field(False, strict=True, description="keep every sample of the record, not only its sums")
    until: Until | None = Field(None, description="when the measurement of a point may end early")
    retry: int = Field(0, ge=0, le=10)
    max_lost: Annotated[Any, *templated("1", 0.0, 1.0)] = 0.0
    purpose: Name = "measurement"
    label: Name | None = None
    conditions: Arguments = Field(default_factory=dict)


RecordOrText = Annotated[Record, *_or_text("seconds")]
PromptOrText = Annotated[Prompt, *_or_text("text")]


class SettleStep(StrictModel):
    """Wait until this much planned time has passed; bus time of the calls before it is included."""

    settle: Duration


class SoakStep(StrictModel):
    """Change the temperature of the unit."""

    soak: Soak


class RecordStep(StrictModel):
    """Take data."""

    record: RecordOrText


class PromptStep(StrictModel):
    """Ask the operator."""

    prompt: PromptOrText


class VerifyStep(StrictModel):
    """The named action must answer true."""

    verify: ActionName


UnitCall = dict[Name, Name | dict[Name, Arguments | None]]


class UnitStep(StrictModel):
    """A command to the unit under test over a link: ``{port_b: start_stream}``.

    The command is one of ``unit_commands``, or one that the frame of the link declares; that one takes arguments:
    ``{rs422: {stream_start: {rate: 200 Hz}}}``.
    """

    unit: UnitCall
    expect: ReplyExpect | None = Field(None, description="of the answer, as text")

    @model_validator(mode="after")
    def _single(self) -> UnitStep:
        _one_entry(self.unit)
        called = next(iter(self.unit.values()))
        if isinstance(called, dict):
            _one_entry(called)
        return self


class Test(StrictModel):
    """A command whose outcome is judged when the session is analysed; whatever comes back, the run goes on."""

    link: Name | None = Field(None, description="the first link, if left out")
    item: Name = Field(description="the test item it belongs to, for example memory")
    command: Name = Field(description="a command that the frame of the link declares")
    arguments: Arguments = Field(default_factory=dict)
    takes: Duration | None = Field(None, description="time from command to answer as planned; 0.1 s if left out")


class TestStep(StrictModel):
    """Test one thing of the unit under test."""

    test: Test


class SendStep(StrictModel):
    """Raw text to an instrument, as it is. The static check cannot see what it does."""

    send: dict[Name, Text]
    expect: ReplyExpect | None = Field(None, description="of the reply to a question")

    @model_validator(mode="after")
    def _single(self) -> SendStep:
        _one_entry(self.send)
        return self


class ChannelPick(StrictModel):
    """Some of the declared channels, in this order."""

    channels: int | str | list[int | str]


class ForStep(StrictModel):
    """Repeat ``do`` for each value; ``{name}`` is the value and ``{name_index}`` counts from 0."""

    for_: Name = Field(alias="for")
    in_: str | ChannelPick | list[Scalar] = Field(alias="in")
    do: list[Step_] = Field(min_length=1)


def _before_tag(value: object) -> str:
    return "<quantity>" if isinstance(value, str) and "." not in value else "<call>"


ReadBefore = Annotated[
    Annotated[Name, Tag("<quantity>")] | Annotated[CallStep, Tag("<call>")], Discriminator(_before_tag)
]


class Condition(Comparison):
    """A comparison of what was read last: by an action of an instrument, or the quantity of a prompt."""

    reading: ReadBefore


class IfStep(StrictModel):
    """Do ``then`` if the condition holds, ``else`` if it does not or the reading is missing."""

    if_: Condition = Field(alias="if")
    then: list[Step_] = Field(min_length=1)
    else_: list[Step_] | None = Field(None, alias="else")


class WhileStep(StrictModel):
    """Repeat ``do`` while the condition holds, ``at_most`` so many times; ``{turn}`` counts from 1.

    ``else`` says what happens if it holds even then, or if the reading is missing.
    """

    while_: Condition = Field(alias="while")
    at_most: int = Field(strict=True, ge=1, le=1000)
    do: list[Step_] = Field(min_length=1)
    else_: Literal["fail", "hold", "go_on"] | None = Field(None, alias="else")


class Case(Comparison):
    """What is done if the reading compares so."""

    do: list[Step_] = Field(min_length=1)


class ChooseStep(StrictModel):
    """Do the first of the cases that fits the reading, ``else`` if none fits or the reading is missing."""

    choose: ReadBefore
    cases: list[Case] = Field(min_length=1)
    else_: list[Step_] | None = Field(None, alias="else")


_PROCEDURE = f"^(?!(?:{'|'.join(VERBS)})$){NAME_PATTERN}$"


class ProcedureStep(RootModel[Annotated[dict[Name, Arguments | None], *_call_form(_PROCEDURE)]]):
    """A procedure by its name: ``point: {current: 1 mA, polarity: +}``."""


def step_tag(value: object) -> str | None:
    """Return which kind of step a value is (the tag never stands in a file, hence the brackets)."""
    if isinstance(value, str):
        return "<call>" if "." in value else "<procedure>"
    if isinstance(value, dict):
        verb = next((verb for verb in VERBS if verb in value), None)
        if verb is not None:
            return f"<{verb}>"
        if len(value) == 1:
            name, given = next(iter(value.items()))
            return step_tag(name) if "." in name or given is None or isinstance(given, dict) else None
        if len(value) == 2 and EXPECT in value:
            return "<read>" if "." in next(str(name) for name in value if name != EXPECT) else None
    return None


_MESSAGE = f"not a step; write role.action, a procedure, or one mapping with one of: {', '.join(VERBS)}"
Step_ = Annotated[
    Annotated[ForStep, Tag("<for>")]
    | Annotated[IfStep, Tag("<if>")]
    | Annotated[WhileStep, Tag("<while>")]
    | Annotated[ChooseStep, Tag("<choose>")]
    | Annotated[SettleStep, Tag("<settle>")]
    | Annotated[RecordStep, Tag("<record>")]
    | Annotated[SoakStep, Tag("<soak>")]
    | Annotated[PromptStep, Tag("<prompt>")]
    | Annotated[VerifyStep, Tag("<verify>")]
    | Annotated[UnitStep, Tag("<unit>")]
    | Annotated[TestStep, Tag("<test>")]
    | Annotated[SendStep, Tag("<send>")]
    | Annotated[CallStep, Tag("<call>")]
    | Annotated[ReadStep, Tag("<read>")]
    | Annotated[ProcedureStep, Tag("<procedure>")],
    Discriminator(step_tag, custom_error_type="step", custom_error_message=_MESSAGE),
]
for _holder in (ForStep, IfStep, WhileStep, Case, ChooseStep):
    _holder.model_rebuild()


class TimelineEntry(StrictModel):
    """One line of the flat form: at a time, do one thing."""

    at: Annotated[float, BeforeValidator(_clock_time), WithJsonSchema({"type": "string"})] = Field(
        description="'HH:MM:SS' or a duration such as '20 s'"
    )
    send: dict[Name, Text] | None = None
    call: Reading_ | None = None
    unit: UnitCall | None = None
    record: RecordOrText | None = None
    soak: Soak | None = None
    prompt: PromptOrText | None = None
    verify: ActionName | None = None
    expect: ReplyExpect | None = Field(None, description="of the reply to 'send' or 'unit'")

    @model_validator(mode="after")
    def _one_thing(self) -> TimelineEntry:
        if self.expect is not None and self.send is None and self.unit is None:
            raise ValueError("'expect' stands beside 'send' and 'unit', and inside of 'call' and 'record'")
        if len(self.model_fields_set - {"at", "expect"}) != 1:
            raise ValueError("one thing to do is due: send, call, unit, record, soak, prompt or verify")
        for entry in (self.send, self.unit):
            if entry is not None:
                _one_entry(entry)
        return self
