"""The roles that columns of a log may play: those of the analysis that the mapping names, so that a wrong one is told
what this analysis takes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError
from pydantic_core import InitErrorDetails

from bench.model.declaration import LogColumn
from bench.model.systems import analysis_declaration

_OF_ANY = ("time", "temperature", "ignore")


def roles_of(analysis: object) -> tuple[str, ...]:
    """Return the roles that columns may play for an analysis of logs; empty where any may."""
    declared = analysis_declaration(analysis) if isinstance(analysis, str) else None
    return () if declared is None or not declared.roles else tuple(dict.fromkeys((*declared.roles, *_OF_ANY)))


def check_roles(analysis: str, values: Mapping[str, LogColumn]) -> None:
    """Refuse a column whose role is one of other analyses only. Raises: ValueError."""
    roles = roles_of(analysis)
    for header, column in values.items():
        if roles and column.role not in roles:
            raise ValueError(
                f"column {header!r}: {column.role!r} is no role of the analysis {analysis!r}; it takes: "
                f"{', '.join(roles)}"
            )


def naming_roles(error: ValidationError, tree: object) -> ValidationError:
    """Return the same mistakes of a mapping; where a role is unknown, the due ones are those of its analysis."""
    roles = roles_of(tree.get("analysis") if isinstance(tree, Mapping) else None)
    details = []
    for item in error.errors(include_url=False):
        context: dict[str, Any] = dict(item.get("ctx", {}))
        if item["type"] == "union_tag_invalid" and roles:
            context["expected_tags"] = ", ".join(map(repr, roles))
        details.append(InitErrorDetails(type=item["type"], loc=item["loc"], input=item["input"], ctx=context))
    return ValidationError.from_exception_data(error.title, details)
