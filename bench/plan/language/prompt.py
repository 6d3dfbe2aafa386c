"""What a person is asked for: a confirmation, a value with its unit and limits, an act on the bench."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from bench.model.units import dimension_of
from bench.model.yamlio import Name, StrictModel, characters
from bench.plan.values import Scalar

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
