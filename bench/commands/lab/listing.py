"""``bench list``: what is there, and where it comes from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pydantic import RootModel
from rich import box
from rich.table import Table

from bench.commands.console import console, print_json, say
from bench.model.drivers import driver_class
from bench.model.errors import BenchError, InputError, InstallationError
from bench.model.installed import Refusal, driver_packages, driver_refusals
from bench.model.lab import (
    KINDS,
    CodeKind,
    Kind,
    Lab,
    lab_here,
    own_code_names,
    own_names,
    refused_twice,
    sha256_of,
    shipped_folder,
    shipped_names,
)
from bench.model.ports import Effect, Parameter, actions_of
from bench.model.systems import analyses, system_refusals
from bench.model.units import format_quantity
from bench.model.yamlio import load_yaml

WORDS = (*KINDS, "instruments", "analyses")
_MOST_WORDS = 10
ACTIONS = "actions"  # asked for by name: each driver is loaded


@dataclass(frozen=True)
class Entry:
    """One thing that a sequence or a command can name."""

    kind: str
    name: str
    title: str
    origin: str


def print_list(kind: str | None, as_json: bool) -> None:
    """Print sequences, stations, frames, instruments and analyses, or those of one kind, each with its origin.

    The kind ``actions``: what a sequence may call of each driver, with arguments, limits and effect on the bench.

    Raises: InputError B-CLI-011 for another kind, B-LAB-001; InstallationError.
    """
    if kind is not None and kind not in (*WORDS, ACTIONS):
        raise InputError("B-CLI-011", f"{kind!r} is no kind", next_step=f"use one of: {', '.join((*WORDS, ACTIONS))}")
    lab = lab_here()
    entries = [entry for entry in _entries(lab) if kind in (None, entry.kind)]
    if kind == ACTIONS:
        entries = [action for entry in _entries(lab) if entry.kind == "instruments" for action in _actions(entry)]
    if as_json:
        print_json([asdict(entry) for entry in entries])
        return
    for word in (*WORDS, ACTIONS):
        rows = [entry for entry in entries if entry.kind == word]
        table = Table("name", "title", "from", box=box.SIMPLE_HEAD, title=word, title_justify="left")
        for entry in rows:
            table.add_row(entry.name, entry.title, entry.origin)
        if rows:
            console().print(table)
    where = "no lab folder here (bench init)" if lab is None else f"lab folder: {lab.name}, {lab.folder}"
    say(where)


def _entries(lab: Lab | None) -> Iterator[Entry]:
    for kind in KINDS:
        own = [] if lab is None else own_names(kind, lab)
        for name in own:
            assert lab is not None
            yield Entry(kind, name, _title(lab.folder / kind / f"{name}.yaml"), f"{lab.name}, {kind}/{name}.yaml")
        yield from (_shipped(kind, name, name in own) for name in shipped_names(kind))
    drivers = {name: package.offer for package in driver_packages() for name in package.drivers()}
    yield from _own_code("instruments", lab, {name: offer.release for name, offer in drivers.items()})
    for name, offer in drivers.items():
        yield Entry("instruments", name, "", offer.release)
    yield from _refused("instruments", driver_refusals())
    installed = analyses()
    yield from _own_code("analyses", lab, {name: entry.offer.release for name, entry in installed.items()})
    for name, entry in installed.items():
        yield Entry("analyses", name, entry.system.name, entry.offer.release)
    yield from _refused("analyses", system_refusals())


def _actions(driver: Entry) -> Iterator[Entry]:
    """Yield what a sequence may call of a driver; why it cannot be loaded otherwise."""
    try:
        declared = actions_of(driver_class(driver.name))
    except BenchError as error:
        yield Entry(ACTIONS, driver.name, f"refused: {error.message}", driver.origin)
        return
    for action in declared.values():
        arguments = ", ".join(map(_argument, action.parameters))
        ends = [f"returns {action.returns}"] if action.returns else []
        ends += [action.effect.value] if action.effect is not Effect.NONE else []
        yield Entry(ACTIONS, f"{driver.name}.{action.name}", "; ".join(filter(None, [arguments, *ends])), driver.origin)


def _argument(parameter: Parameter) -> str:
    """Return an argument with what it may be; in brackets if it may be left out."""
    words = [str(choice) for choice in parameter.choices] or [
        format_quantity(value, parameter.dimension).removesuffix(" 1") for value in parameter.values or _ends(parameter)
    ]
    if parameter.low is not None and not parameter.values:
        limits = " to ".join(words)
    else:
        limits = "|".join(words if len(words) <= _MOST_WORDS else [*words[:2], "...", words[-1]])
    told = f"{parameter.name} {limits}"
    return told if parameter.required else f"[{told}]"


def _ends(parameter: Parameter) -> list[float]:
    return [value for value in (parameter.low, parameter.high) if value is not None]


def _refused(kind: str, refusals: Sequence[Refusal]) -> Iterator[Entry]:
    """Yield what is installed and cannot be used, with the reason as its title."""
    for offer, error in refusals:
        yield Entry(kind, offer.name, f"refused: {error}", offer.release)


def _own_code(kind: CodeKind, lab: Lab | None, installed: Mapping[str, str]) -> Iterator[Entry]:
    """Yield the lab's own drivers or analyses; nothing of them is executed, so why one is refused is their title."""
    for name in [] if lab is None else own_code_names(kind, lab):
        assert lab is not None
        title = ""
        try:
            if name in installed:
                raise refused_twice(kind, name, installed[name])
            sha256_of(kind, name)
        except InstallationError as error:
            title = f"refused: {error.message}"
        yield Entry(kind, name, title, f"{lab.name}, {kind}/{name}.py")


def _shipped(kind: Kind, name: str, replaced: bool) -> Entry:
    origin = "installed" + (", replaced by the lab's" if replaced else "")
    return Entry(kind, name, _title(shipped_folder(kind) / f"{name}.yaml"), origin)


def _title(path: Path) -> str:
    """Return the title that a YAML file states, or that it cannot be read."""
    try:
        tree: Any = load_yaml(path, RootModel[Any]).model.root
    except InputError:
        return "cannot be read"
    return str(tree.get("title") or "") if isinstance(tree, dict) else ""
