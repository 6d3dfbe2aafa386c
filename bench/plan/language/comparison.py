"""What a decision asks of a reading: one comparison, written with its unit."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from bench.model.yamlio import StrictModel
from bench.plan.values import Scalar

WORDS = ("above", "below", "within", "equals")


class Comparison(StrictModel):
    """One comparison of a reading. ``within`` includes both of its limits, ``above`` and ``below`` exclude theirs."""

    above: Scalar | None = None
    below: Scalar | None = None
    within: Annotated[list[Scalar], Field(min_length=2, max_length=2)] | None = None
    equals: Scalar | None = None

    @model_validator(mode="after")
    def _single(self) -> Comparison:
        given = [word for word in WORDS if getattr(self, word) is not None]
        if len(given) != 1:
            found = f"{' and '.join(given)} found" if given else "none found"
            raise ValueError(f"one comparison is due, of {', '.join(WORDS)}; {found}")
        return self

    @property
    def word(self) -> str:
        """Return which comparison it is."""
        return next(word for word in WORDS if getattr(self, word) is not None)
