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
from bench.model.errors import InputError, InstallationError
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
from bench.model.systems import analyses, system_refusals
from bench.model.yamlio import load_yaml

WORDS = (*KINDS, "instruments", "analyses")


@dataclass(frozen=True)
class Entry:
    """One thing that a sequence or a command can name."""

    kind: str
    name: str
    title: str
    origin: str


def print_list(kind: str | None, as_json: bool) -> None:
    """Print sequences, stations, frames, instruments and analyses, or those of one kind, each with its origin.

    Raises: InputError B-CLI-011 for another kind, B-LAB-001; InstallationError.
    """
    if kind is not None and kind not in WORDS:
        raise InputError("B-CLI-011", f"{kind!r} is no kind", next_step=f"use one of: {', '.join(WORDS)}")
    lab = lab_here()
    entries = [entry for entry in _entries(lab) if kind in (None, entry.kind)]
    if as_json:
        print_json([asdict(entry) for entry in entries])
        return
    for word in WORDS:
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
