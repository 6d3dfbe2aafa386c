"""``bench list``: what is there, and where it comes from."""

from __future__ import annotations

from collections import ChainMap
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
from bench.model.installed import Refusal, driver_packages, driver_refusals, named, offers, world_parts
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
from bench.model.units import format_quantity, units_by_dimension
from bench.model.yamlio import load_yaml

WORDS = (*KINDS, "instruments", "analyses")
_MOST_WORDS = 10
ACTIONS, UNITS, WORLDS = "actions", "units", "worlds"
ASKED = (ACTIONS, UNITS, WORLDS)  # by name alone: parts are loaded for them


@dataclass(frozen=True)
class Entry:
    """One thing that a sequence or a command can name."""

    kind: str
    name: str
    title: str
    origin: str


def print_list(kind: str | None, name: str | None, as_json: bool) -> None:
    """Print sequences, stations, frames, instruments and analyses, or those of one kind, each with its origin.

    ``actions``: what a sequence may call of each driver, with arguments, limits and effect on the bench; ``units`` by
    dimension; ``worlds``: options of the simulated benches. ``name``: only what begins with it.

    Raises: InputError B-CLI-011 for another kind, or if nothing has the name, B-LAB-001; InstallationError.
    """
    if kind is not None and kind not in (*WORDS, *ASKED):
        raise InputError("B-CLI-011", f"{kind!r} is no kind", next_step=f"use one of: {', '.join((*WORDS, *ASKED))}")
    lab = lab_here()
    entries = list(_asked(kind, lab) if kind in ASKED else _entries(lab))
    entries = [entry for entry in entries if kind in (None, entry.kind) and entry.name.startswith(name or "")]
    if name and not entries:
        raise InputError("B-CLI-011", f"none of the {kind} is {name!r}", next_step=f"'bench list {kind}' shows all")
    if as_json:
        print_json([asdict(entry) for entry in entries])
        return
    for word in (*WORDS, *ASKED):
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
        asks = {"conditions": entry.analysis.conditions, "fields": entry.analysis.fields, "roles": entry.analysis.roles}
        told = [f"{word} {', '.join(of)}" for word, of in {"methods": entry.analysis.methods, **asks}.items() if of]
        yield Entry("analyses", name, f"{entry.system.name}; {'; '.join(told)}", entry.offer.release)
    yield from _refused("analyses", system_refusals())


def _asked(kind: str | None, lab: Lab | None) -> Iterator[Entry]:
    """Yield what is listed only if it is asked for."""
    if kind == ACTIONS:
        for entry in _entries(lab):
            yield from _actions(entry) if entry.kind == "instruments" else ()
    elif kind == UNITS:
        for dimension, units in units_by_dimension().items():
            yield Entry(UNITS, dimension, ", ".join(units), "installed")
    else:
        for offer in offers("worlds"):
            try:
                options = ChainMap(*(named(group) for group in world_parts(offer)[1:]))
            except BenchError as error:
                yield Entry(WORLDS, offer.name, f"refused: {error.message}", offer.release)
                continue
            for option, told in options.items():
                yield Entry(WORLDS, f"{offer.name}.{option}", told if isinstance(told, str) else told[0], offer.release)


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
