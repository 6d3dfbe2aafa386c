"""Sequences, frames and stations by path or name: those of a lab folder first, then those that come with the bench.

Folders of this user and names of folders stand here too.
"""

from __future__ import annotations

import difflib
import os
import re
from pathlib import Path
from typing import Literal

from bench.model.errors import InputError
from bench.model.lab import Lab, lab_here


def cache_folder() -> Path:
    """Return where the bench keeps what it can compute again; nobody made it yet.

    Source: XDG Base Directory Specification: XDG_CACHE_HOME if it is absolute, else ~/.cache.
    """
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if Path(base).is_absolute() else Path.home() / ".cache") / "inertial-bench"


def folder_name(serial: str) -> str:
    """Return a serial number as the name of a folder: letters, digits, dot, dash and underscore, no dot at its ends."""
    return re.sub(r"[^A-Za-z0-9._-]", "_", serial).strip(".") or "_"


Kind = Literal["sequences", "frames", "stations"]
KINDS: tuple[Kind, ...] = ("sequences", "stations", "frames")

_KINDS = {  # what a file is, the keys at its top of which it has all and no other kind has, which command takes it
    "sequences": ("sequence", {"sequence", "station"}, "'bench check {name}' and 'bench run {name}' take it"),
    "mappings": ("mapping", {"mapping", "columns"}, "'bench import {name} FILE' takes it"),
    "frames": ("frame", {"frame", "crc"}, "'bench decode {name} FILE' takes it; a sequence names it under 'frame'"),
    "stations": ("station", {"station", "instruments"}, "--station {name} of 'bench check' and 'bench run' takes it"),
}
_KEYS = re.compile(rb"^([a-z]+)[ ]*:", re.MULTILINE)
_MOST_BYTES = 1_000_000  # of a YAML file
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*")
_PACKAGE = Path(__file__).resolve().parent.parent


def shipped_folder(kind: Kind) -> Path:
    """Return the folder of shipped files: inside the installed package, or at the top of a checkout."""
    installed = _PACKAGE / "shipped" / kind
    return installed if installed.is_dir() else _PACKAGE.parent / kind


def shipped_names(kind: Kind) -> list[str]:
    """Return names of the shipped files of a kind, sorted, without ``.yaml``."""
    return sorted(path.stem for path in shipped_folder(kind).glob("*.yaml"))


def own_names(kind: Kind, lab: Lab) -> list[str]:
    """Return names of a lab folder's own files of a kind, sorted, without ``.yaml``."""
    return sorted(path.stem for path in (lab.folder / kind).glob("*.yaml"))


def find_shipped(kind: Kind, name_or_path: str | Path) -> Path:
    """Return the file meant by a path, or by the plain name, with or without ``.yaml``, of a lab's or a shipped file.

    Raises: InputError B-SHIP-001 if there is none, B-SHIP-002 if it is a file of another kind; a name never leaves
    these folders. B-LAB-001.
    """
    text = str(name_or_path)
    path = Path(text)
    if _is_file(path):
        refuse_other_kinds(kind, path)
        return path
    lab = lab_here()
    if _NAME.fullmatch(text):
        for folder in (*([] if lab is None else [lab.folder / kind]), shipped_folder(kind)):
            named = folder / f"{text.removesuffix('.yaml')}.yaml"
            if _is_file(named):
                return named
    for other in KINDS:
        if path.name == text and path.stem in shipped_names(other):
            raise _another(kind, other, path.stem)
    names = [*([] if lab is None else own_names(kind, lab)), *shipped_names(kind)]
    text = text[:80]
    near = difflib.get_close_matches(path.stem, names, n=1)
    meant = f"did you mean {near[0]!r}? " if near else ""
    raise InputError(
        "B-SHIP-001",
        f"there is no file {text!r} and no shipped {kind[:-1]} of that name",
        where=text,
        next_step=f"{meant}give the path of a YAML file or one of: {', '.join(names) or 'none shipped'}",
    )


def refuse_other_kinds(kind: str, path: Path) -> None:
    """Raise InputError B-SHIP-002 if the keys at the top of a file are those of another kind of file."""
    try:
        with path.open("rb") as file:
            keys = {found.decode() for found in _KEYS.findall(file.read(_MOST_BYTES))}
    except OSError:  # whoever reads the file says why it cannot be read
        return
    other = next((name for name, (_, own, _) in _KINDS.items() if own <= keys), None)
    if other is not None and other != kind and not _KINDS[kind][1] <= keys:
        raise _another(kind, other, str(path))


def _another(kind: str, other: str, text: str) -> InputError:
    is_a, _, taken = _KINDS[other]
    taken = taken.format(name=text)
    return InputError("B-SHIP-002", f"this is a {is_a}, and a {kind[:-1]} is due", where=text, next_step=taken)


def _is_file(path: Path) -> bool:
    """Return False also for what no file system can hold: a name that is too long, or with a zero byte."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def find_beside(source: Path, kind: Kind, name: str) -> Path:
    """Return a file that a source names: beside the source's folder, unless that is shipped, else as ``find_shipped``.

    A path begins at the source's own folder. Raises: InputError B-SHIP-001, B-SHIP-002, B-LAB-001.
    """
    if name.endswith(".yaml"):
        return find_shipped(kind, source.parent / name)
    beside = source.parent.parent / kind / f"{name}.yaml"
    is_shipped = beside.parent.resolve() == shipped_folder(kind).resolve()
    return beside if beside.is_file() and not is_shipped else find_shipped(kind, name)


def replaced_by_lab(kind: Kind, path: Path) -> str:
    """Return, where a file is a lab's own and a shipped one has the same name, a sentence that says so; else ""."""
    lab = lab_here()
    if lab is None or not lab.holds(path) or path.stem not in shipped_names(kind):
        return ""
    return f"{kind[:-1]} {path.stem}: {path} of {lab.name}, not the installed one"
