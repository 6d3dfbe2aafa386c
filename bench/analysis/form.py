"""The forms of JSON documents: closed, of plain finite values, checked when they are written and when they are read."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from bench.model.errors import InputError

Document = Mapping[str, Any]  # a part of a plan, a manifest or results.json, as it is read


class Closed(BaseModel):
    """A document without any other field than those it names, of plain finite values."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


def check_form(form: type[BaseModel], document: object, code: str, where: str, next_step: str) -> None:
    """Check a document against its form. Raises InputError with the given code, naming the first wrong field."""
    try:
        form.model_validate(document)
    except ValidationError as error:
        raise wrong_form(error, code, where, next_step) from error


def wrong_form(error: ValidationError, code: str, where: str, next_step: str) -> InputError:
    """Return the error of a document that has not its form, which names the first wrong field."""
    first = error.errors(include_url=False)[0]
    place = ".".join(str(part) for part in first["loc"])
    message = f"{place}: {first['msg'][:1].lower()}{first['msg'][1:]} (found {str(first['input'])[:60]})"
    return InputError(code, message, where=where, next_step=next_step)


def schema_of(form: type[BaseModel]) -> dict[str, Any]:
    """Return the JSON Schema of a document from its form."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **form.model_json_schema(by_alias=True)}
