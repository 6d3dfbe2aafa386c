"""The page of all commands, from the command line itself: usage, arguments, options, examples."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import typer
from typer.core import TyperArgument

from bench.cli import app
from bench.commands.usage import GROUPS


def commands_page() -> str:
    """Return the page as Markdown, in the groups of ``bench --help``."""
    top = typer.main.get_command(app)
    lines = ["# Commands", "", f"{top.help}", "", _sentence(top.epilog), ""]
    context = typer.Context(top, info_name="bench")
    for heading, names in GROUPS.items():
        lines += [f"## {heading}", ""]
        for name in names:
            for word, command, parent in _with_subcommands(name, top.commands[name], context):
                lines += _section(word, command, parent)
    return "\n".join(lines)


def _with_subcommands(name: str, command: Any, parent: Any) -> Iterator[tuple[str, Any, Any]]:
    """Yield a command, and what it is a group of: name, command, the context it stands in."""
    yield name, command, parent
    context = typer.Context(command, info_name=name, parent=parent)
    for word, other in getattr(command, "commands", {}).items():
        yield from _with_subcommands(word, other, context)


def _section(name: str, command: Any, parent: Any) -> list[str]:
    context = typer.Context(command, info_name=name, parent=parent)
    usage = " ".join([context.command_path, *command.collect_usage_pieces(context)])
    lines = [f"### {context.command_path}", "", (command.help or "").replace("\n", " "), "", f"    {usage}", ""]
    rows = [_row(param, context) for param in command.get_params(context) if param.name != "help"]
    if rows:
        lines += ["| argument or option | meaning |", "|---|---|", *rows, ""]
    return [*lines, _sentence(command.epilog), ""]


def _row(param: Any, context: Any) -> str:
    if isinstance(param, TyperArgument):
        name = param.metavar or param.name.upper() + ("..." if param.nargs != 1 else "")
        words = (name if param.required else f"[{name}]", param.help or "")
    else:
        words = param.get_help_record(context) or ("", "")
    name, meaning = (word.replace("|", r"\|") for word in words)
    return f"| `{name}` | {meaning.replace('<', '&lt;')} |"


def _sentence(epilog: str | None) -> str:
    """Return an epilog; the command in ``Example: bench ...`` as code."""
    heading, separator, example = (epilog or "").partition("Example: ")
    return f"{heading}Example: `{example}`" if separator else heading
