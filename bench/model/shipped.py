"""The sequences, frames and stations that come with the bench: looked for by path first, then by name."""

from __future__ import annotations

import difflib
import re
from pathlib import Path
from typing import Literal

from bench.model.errors import InputError

Kind = Literal["sequences", "frames", "stations"]

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*")
_PACKAGE = Path(__file__).resolve().parent.parent


def shipped_folder(kind: Kind) -> Path:
    """Return the folder of shipped files: inside the installed package, or at the top of a checkout."""
    installed = _PACKAGE / "shipped" / kind
    return installed if installed.is_dir() else _PACKAGE.parent / kind


def shipped_names(kind: Kind) -> list[str]:
    """Return names of the shipped files of a kind, sorted, without ``.yaml``."""
    return sorted(path.stem for path in shipped_folder(kind).glob("*.yaml"))


def find_shipped(kind: Kind, name_or_path: str | Path) -> Path:
    """Return the file meant by a path, or by the plain name of a shipped file with or without ``.yaml``.

    Raises: InputError B-SHIP-001 if there is neither; a name never leaves the shipped folder.
    """
    text = str(name_or_path)
    path = Path(text)
    if _is_file(path):
        return path
    if _NAME.fullmatch(text):
        shipped = shipped_folder(kind) / f"{text.removesuffix('.yaml')}.yaml"
        if _is_file(shipped):
            return shipped
    names = shipped_names(kind)
    text = text[:80]
    near = difflib.get_close_matches(path.stem, names, n=1)
    meant = f"did you mean {near[0]!r}? " if near else ""
    raise InputError(
        "B-SHIP-001",
        f"there is no file {text!r} and no shipped {kind[:-1]} of that name",
        where=text,
        next_step=f"{meant}give the path of a YAML file or one of: {', '.join(names) or 'none shipped'}",
    )


def _is_file(path: Path) -> bool:
    """Return False also for what no file system can hold: a name that is too long, or with a zero byte."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def find_beside(source: Path, kind: Kind, name: str) -> Path:
    """A file beside the source's folder wins over a shipped one of the same name. Raises InputError."""
    beside = source.parent.parent / kind / f"{name}.yaml"
    return beside if beside.is_file() else find_shipped(kind, name)
