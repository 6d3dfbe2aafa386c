"""The command line as people read it: usage lines, options and groups of commands in 80 columns, and completion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import wraps
from importlib import import_module
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Any, ClassVar, NoReturn, Protocol

import typer
from typer.core import TyperArgument, TyperCommand, TyperGroup, TyperOption

from bench.model.lab import Kind, shipped_names

GROUPS: dict[str, dict[str, str]] = {
    "Run a campaign": {
        "check": "load, compile and check a sequence; touch no instrument",
        "plan": "the shortest sequence that reaches an uncertainty",
        "run": "run a campaign, on the bench or rehearsed in virtual time",
        "resume": "go on with a run that stopped, or let a paused one go on",
        "pause": "let a living run stand still",
        "abort": "end a living run safely",
        "shelve": "call nobody because of an alarm for a while",
        "answer": "answer the prompt that a living run waits at",
        "top": "watch a living run in the terminal",
        "serve": "serve the live page of a folder of sessions",
    },
    "Results": {
        "fit": "results of a session, by a method of your choice",
        "report": "write or verify the report of a session",
        "certificate": "write a Digital Calibration Certificate",
        "coefficients": "compensation of a unit for its software",
        "replay": "decode a session again; is every number identical?",
        "recover": "what a session holds, what is damaged or missing",
        "export": "tables of a session for other tools",
        "batch": "fit many sessions and compare their units",
        "history": "earlier calibrations: drift, due dates, approvals",
        "archive": "all sessions: whole? what would they give today?",
        "study": "repeat a published simulation study",
    },
    "Files of others": {
        "decode": "decode a raw capture with a frame definition",
        "frame": "begin or check a frame definition",
        "import": "turn a log of another system into a session",
    },
    "The bench": {
        "talk": "reach an instrument by hand, recorded",
        "commission": "first contact with a real instrument",
        "drill": "prove that the guard makes the bench safe",
        "sim": "serve a simulated bench, switch its faults",
        "doctor": "is this machine fit for a run?",
    },
    "This laboratory": {
        "init": "make a folder for own sequences, stations, frames",
        "copy": "take a shipped sequence, station or frame into it",
        "list": "what can be named, and where it comes from",
    },
    "This software": {
        "explain": "what an error means; the pages of the documentation",
        "schema": "write JSON Schemas for editors",
        "version": "print the version",
    },
}
MORE = "More"
_NAMES = {"int": "N", "float": "X", "PosixPath": "PATH", "WindowsPath": "PATH", "Path": "PATH"}


class _Formatter(Protocol):
    def section(self, name: str) -> Any: ...

    def write_dl(self, rows: list[tuple[str, str]]) -> None: ...


def _argument_name(argument: TyperArgument) -> str:
    """Return it as the usage line has it: ``SEQUENCE``, ``[COMMAND]``, ``SESSION...``."""
    name = argument.metavar or argument.name.upper() + ("..." if argument.nargs != 1 else "")
    return name if argument.required else f"[{name}]"


def _named(params: list[Any]) -> None:
    """Let an option that takes a value say what it is: its own name, or N, X, PATH."""
    for option in params:
        if isinstance(option, TyperOption) and option.metavar is None and not option.is_flag:
            kind = getattr(option.type_descriptor.annotation, "__name__", "")
            option.metavar = _NAMES.get(kind, option.opts[-1].strip("-").replace("-", "_").upper())


class Command(TyperCommand):
    """A command that returns its exit status.

    Its help has a line for each argument and option, without the types of the programming language.
    """

    def __init__(self, *words: Any, **settings: Any) -> None:
        super().__init__(*words, **settings)
        _named(self.params)

    def invoke(self, ctx: Any) -> NoReturn:
        """Carry it out, and end with the status that it returns."""
        raise typer.Exit(super().invoke(ctx) or 0)

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Return what stands behind the name of the command."""
        arguments = [param for param in self.get_params(ctx) if isinstance(param, TyperArgument)]
        return ["[OPTIONS]", *(_argument_name(argument) for argument in arguments)]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments and options."""
        arguments = [param for param in self.get_params(ctx) if isinstance(param, TyperArgument)]
        _write(formatter, "Arguments", [(_argument_name(argument), argument.help or "") for argument in arguments])
        _write(formatter, "Options", _options_of(self, ctx))


class Group(TyperGroup):
    """A group of commands; the commands of ``bench`` itself stand under headings."""

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Return what stands behind the name of the group."""
        del ctx
        return ["[OPTIONS]", "COMMAND"]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the options, then the commands."""
        _write(formatter, "Options", _options_of(self, ctx))
        self.format_commands(ctx, formatter)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write every command with one line, under the heading where people look for it."""
        there = {name: self.get_command(ctx, name) for name in self.list_commands(ctx)}
        left = {name: command for name, command in there.items() if command is not None and not command.hidden}
        if ctx.parent is None:
            for heading, lines in GROUPS.items():
                _write(formatter, heading, [(name, line) for name, line in lines.items() if left.pop(name, None)])
        rows = [(name, command.get_short_help_str(60)) for name, command in left.items()]
        _write(formatter, MORE if ctx.parent is None else "Commands", rows)


def _options_of(command: Any, ctx: Any) -> list[tuple[str, str]]:
    options = [param for param in command.get_params(ctx) if isinstance(param, TyperOption)]
    return [record for option in options if (record := option.get_help_record(ctx)) is not None]


def _write(formatter: _Formatter, heading: str, rows: list[tuple[str, str]]) -> None:
    if rows:
        with formatter.section(heading):
            formatter.write_dl(rows)


class App(typer.Typer):
    """A command line in this form; ``-h`` is ``--help`` everywhere."""

    settings: ClassVar[dict[str, Any]] = {
        "cls": Group,
        "no_args_is_help": True,
        "rich_markup_mode": None,
        "pretty_exceptions_enable": False,
        "context_settings": {"help_option_names": ["-h", "--help"], "max_content_width": 80},
    }

    def __init__(self, **settings: Any) -> None:
        super().__init__(**{**self.settings, **settings})

    def command(self, name: str | None = None, work: str = "", **settings: Any) -> Callable[[Any], Any]:
        """Register a command, as ``typer.Typer.command`` does.

        ``work``: the module of ``bench.commands`` whose function of the same name carries it out; "" where it does so
        itself.
        """
        register = super().command(name, **{"cls": Command, **settings})
        return lambda function: register(spread(carried_out(function, work) if work else function))


def carried_out(function: Callable[..., Any], work: str) -> Callable[..., Any]:
    """Return a command with the arguments of a function; its work is loaded once the command is given."""

    @wraps(function)
    def command(**values: Any) -> Any:
        return getattr(import_module(f"bench.commands.{work}"), function.__name__)(**values)

    return command


def spread(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a command that takes the fields of its dataclasses one by one, each an option or argument of its own."""
    given = signature(function, eval_str=True).parameters
    kinds: dict[str, Any] = {name: taken.annotation for name, taken in given.items() if is_dataclass(taken.annotation)}

    @wraps(function)
    def command(**values: Any) -> Any:
        for name, kind in kinds.items():
            values[name] = kind(**{field.name: values.pop(field.name) for field in fields(kind)})
        return function(**values)

    parameters: list[Parameter] = []
    for name, taken in given.items():
        parameters += signature(kinds[name], eval_str=True).parameters.values() if name in kinds else [taken]
    named = [taken.replace(kind=Parameter.KEYWORD_ONLY) for taken in parameters]
    command.__signature__ = Signature(named)  # type: ignore[attr-defined]  # what typer looks at
    return command


def completing(kind: Kind) -> Callable[[str], list[str]]:
    """Return what completes the names of shipped files, and paths."""

    def complete(incomplete: str) -> list[str]:
        names = [name for name in shipped_names(kind) if name.startswith(incomplete)]
        folder = Path(incomplete) if incomplete.endswith("/") else Path(incomplete).parent
        try:
            files = sorted(path for path in folder.iterdir() if path.is_dir() or path.suffix == ".yaml")
        except OSError:
            files = []
        paths = [f"{path}/" if path.is_dir() else str(path) for path in files if not path.name.startswith(".")]
        return names + [path for path in paths if path.startswith(incomplete)]

    return complete
