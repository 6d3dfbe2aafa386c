"""The page of the Python interface, from the signatures and docstrings of ``bench.api``, ``bench.tables``."""

from __future__ import annotations

import inspect
import re
from typing import Any

import bench.api
import bench.tables

_SECTIONS = re.compile(r"^(Args|Returns|Raises|Source):\s*", re.MULTILINE)
_ARGS = re.compile(r"\*\*Args:\*\* .*?(?=\n\n|\Z)", re.DOTALL)
_ARGUMENT = re.compile(r"(?:(?<=\*\*) |\s{2,})(?=[a-z_]+(?:, [a-z_]+)*: )")  # where the next argument begins
_QUOTED = re.compile(r"(: |-> )'([^']*)'")  # annotations are text


def api_page() -> str:
    """Return the page as Markdown: every public name with its signature and what it says of itself."""
    lines = ["# Python interface", "", *_said_of(bench.api)]
    lines += ["Names and arguments are stable: they gain some, they lose none. [Interfaces for code](../api.md)"]
    lines += ["shows them in use.", ""]
    for name in bench.api.__all__:
        lines += _entry(f"bench.{name}", getattr(bench.api, name))
    others = [name for name in bench.tables.__all__ if name not in bench.api.__all__]
    lines += ["## bench.tables", "", *_said_of(bench.tables)]
    for name in others:
        lines += _entry(f"bench.tables.{name}", getattr(bench.tables, name), level=3)
    return "\n".join(lines)


def _entry(name: str, thing: Any, level: int = 2) -> list[str]:
    if not callable(thing):
        return [f"{'#' * level} {name}", "", f"`{thing!r}`", ""]
    lines = [f"{'#' * level} {name}", "", *_signature(name, thing), *_said_of(thing)]
    for word, member in vars(thing).items() if inspect.isclass(thing) else ():
        if not word.startswith("_") and _documented(member):
            lines += _member(name.rpartition(".")[2].lower(), word, member)
    return lines


def _member(owner: str, word: str, member: Any) -> list[str]:
    if inspect.isfunction(member):
        return [f"### {owner}.{word}", "", *_signature(f"{owner}.{word}", member), *_said_of(member)]
    return [f"### {owner}.{word}", "", *_said_of(member)]


def _documented(member: Any) -> bool:
    """Return whether it is a method or property; plain attributes stand in the signature of their class."""
    return inspect.isfunction(member) or isinstance(member, property) or hasattr(member, "attrname")


def _signature(name: str, thing: Any) -> list[str]:
    """Return the signature as code, an argument to a line where there are many."""
    signature = inspect.signature(thing)
    kept = [parameter for parameter in signature.parameters.values() if parameter.name != "self"]
    text = _QUOTED.sub(r"\1\2", str(signature.replace(parameters=kept)))
    if len(name + text) > 88:
        inner, end = text[1:].rsplit(")", 1)
        text = "(\n    " + re.sub(r", (?=[\w*]+(?::|,|$))", ",\n    ", inner) + ",\n)" + end
    return ["```python", name + text, "```", ""]


def _said_of(thing: Any) -> list[str]:
    """Return a docstring as Markdown: sections begin with a bold word, arguments are a list."""
    text = _SECTIONS.sub(r"\n**\1:** ", inspect.getdoc(thing) or "").replace("\n\n\n", "\n\n")
    return [_ARGS.sub(lambda args: _ARGUMENT.sub("\n- ", args[0]).replace("\n- ", "\n\n- ", 1), text), ""]
