"""What a sequence expects of the values it reads, and the lines and curves that are laid through them."""

from __future__ import annotations

import re
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field, StringConstraints, model_validator

from bench.model.units import known_unit, likely
from bench.model.yamlio import NAME_PATTERN, Name, StrictModel, characters
from bench.plan.values import Scalar, as_reference

MOST_DEGREE = 6
NONLINEARITY = "nonlinearity"
COMPARISONS = ("above", "below", "within", "equals")


def _bound(value: object) -> object:
    text = isinstance(value, str)
    if not text or (as_reference(value) is None and len(str(value).split(maxsplit=1)) != 2):
        raise ValueError(f"{value!r} is not a quantity with its unit, such as '4.9 V' or '{{level}}'{likely(value)}")
    return value


Bound = Annotated[str, BeforeValidator(_bound), StringConstraints(max_length=80)]


class Bounds(StrictModel):
    """Where a value must lie: ``within`` two limits, above ``min``, below ``max``, or ``equals`` within a tolerance."""

    within: tuple[Bound, Bound] | None = Field(None, description="[lowest, highest]")
    min: Bound | None = None
    max: Bound | None = None
    equals: Bound | None = None
    tolerance: Bound | None = Field(None, description="of 'equals': in its unit, or in % or ppm of it")

    @model_validator(mode="after")
    def _checked(self) -> Bounds:
        self._one_form()
        return self

    def _one_form(self) -> None:
        forms = (self.within, self.min or self.max, self.equals)
        if sum(form is not None for form in forms) > 1:
            raise ValueError("one of: within; min, max or both; equals with its tolerance")
        if (self.equals is None) != (self.tolerance is None):
            raise ValueError("'equals' and 'tolerance' belong together: no measured value is exactly another one")


class Expect(Bounds):
    """What a reading is called in the results, and what is expected of it; with a name alone it is not judged."""

    name: Name
    stable: Bound | None = Field(None, description="the readings of one condition lie within this of each other")


class ReadingExpect(Expect):
    """Limits for the readings of an instrument, and how much one of them scatters."""

    scatter: Bound | None = Field(None, description="standard deviation of one reading, for a prediction")


class SignalExpect(Expect):
    """What is expected of the mean over a record of a number that the unit streams, ``port_b.unit_temperature[1]``."""

    signal: Annotated[str, StringConstraints(max_length=200)] = Field(description="link.field, or link.field[element]")


def _pattern(text: str) -> str:
    try:
        groups = re.compile(text).groups
    except re.error as error:
        raise ValueError(f"{text!r} is no regular expression: {error}") from error
    if groups > 1:
        raise ValueError(f"{text!r} has {groups} groups; one at most says which part counts, (?:...) is none")
    return text


class ReplyExpect(Expect):
    """What is expected of the text of a reply: with a ``unit`` of a number in it, without of the text itself.

    ``pattern`` finds what counts: its group, or all that it matches. Without one it is the first number, or the whole
    text.
    """

    pattern: Annotated[str, characters(200), AfterValidator(_pattern)] | None = None
    unit: Annotated[str, AfterValidator(known_unit)] | None = Field(None, description="of the number in the reply")
    equals: Annotated[str, characters(200)] | None = None
    uncertainty: Bound | None = Field(None, description="95 %, of whatever measured the number")

    def _one_form(self) -> None:
        if self.unit is not None:
            super()._one_form()
            if self.equals is not None:
                _bound(self.equals)
        elif self.equals is None or self.model_fields_set - {"name", "pattern", "equals"}:
            raise ValueError("a number has a 'unit' and limits; a text has 'equals' and neither unit nor limits")


_VARIABLE = re.compile(rf"(?:log\(({NAME_PATTERN})\)|1/({NAME_PATTERN})|({NAME_PATTERN}))")
LOG, RECIPROCAL = "log", "reciprocal"
Variable = Annotated[str, StringConstraints(pattern=f"^{_VARIABLE.pattern}$")]


def variable_of(text: str) -> tuple[str, str]:
    """Return the name in a variable of a fit, and its function: LOG, RECIPROCAL or ""."""
    match = _VARIABLE.fullmatch(text)
    assert match is not None
    return (match[1], LOG) if match[1] else (match[2], RECIPROCAL) if match[2] else (match[3], "")


class ReadBack(Bounds):
    """The value that the curve of a fit has at one place, in the unit of the quantity itself."""

    name: Name
    at: Bound


class Fit(StrictModel):
    """A polynomial of one quantity against another one, a condition, or the ``time`` of the readings.

    Either may be a quantity ``x``, ``log(x)``, the natural logarithm of its number in the base unit, or ``1/x``, of a
    temperature in kelvin.
    """

    name: Name
    of: Variable
    against: Variable
    against_uncertainty: Annotated[str, BeforeValidator(_bound)] | None = Field(
        None, description="95 %; of a condition, which is a set-point and not a reading"
    )
    degree: int = Field(1, strict=True, ge=1, le=MOST_DEGREE)
    powers: list[Annotated[int, Field(strict=True, ge=0, le=MOST_DEGREE)]] | None = Field(
        None, min_length=1, description="in place of 'degree', those that the polynomial has: [0, 1, 3]"
    )
    per: list[Name] = Field(default_factory=list, description="conditions: a fit for each of their values")
    expect: dict[Name, Bounds] = Field(
        default_factory=dict, description="by result: c0, c1, ... of the polynomial, and nonlinearity"
    )

    read_back: list[ReadBack] = Field(default_factory=list, description="values of the curve, each with a name")

    @property
    def orders(self) -> tuple[int, ...]:
        """Powers that the polynomial has."""
        return tuple(range(self.degree + 1) if self.powers is None else self.powers)

    @model_validator(mode="after")
    def _known_results(self) -> Fit:
        if self.powers is not None:
            if "degree" in self.model_fields_set:
                raise ValueError("'degree' or 'powers', not both: a degree means all powers up to it")
            if sorted(set(self.powers)) != self.powers:
                raise ValueError(f"powers {self.powers} do not rise one by one")
        known = (*(f"c{order}" for order in self.orders), NONLINEARITY)
        if unknown := [result for result in self.expect if result not in known]:
            raise ValueError(f"the fit has no result {unknown[0]!r}; it has {', '.join(known)}")
        return self


class Comparison(StrictModel):
    """One comparison of a reading. ``within`` includes both of its limits, ``above`` and ``below`` exclude theirs."""

    above: Scalar | None = None
    below: Scalar | None = None
    within: Annotated[list[Scalar], Field(min_length=2, max_length=2)] | None = None
    equals: Scalar | None = None

    @model_validator(mode="after")
    def _single(self) -> Comparison:
        given = [word for word in COMPARISONS if getattr(self, word) is not None]
        if len(given) != 1:
            found = f"{' and '.join(given)} found" if given else "none found"
            raise ValueError(f"one comparison is due, of {', '.join(COMPARISONS)}; {found}")
        return self

    @property
    def word(self) -> str:
        """Return which comparison it is."""
        return next(word for word in COMPARISONS if getattr(self, word) is not None)


def with_expect(schema: dict[str, Any], expect: dict[str, Any]) -> dict[str, Any]:
    """Return the JSON Schema of a step of one entry with ``expect`` beside that entry."""
    named = next(form for form in schema["anyOf"] if form.get("type") == "object")
    beside = {"properties": {"expect": expect}, "required": ["expect"], "minProperties": 2, "maxProperties": 2}
    return {**named, **beside}
