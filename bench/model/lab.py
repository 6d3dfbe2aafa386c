"""A laboratory's own folder: ``bench.toml`` at its top, sequences, stations, frames and code of its own below."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

from bench.model.errors import InputError

FILE = "bench.toml"
_NEXT = 'it needs one line "[lab]" and below it one line such as: name = "Our laboratory"'


@dataclass(frozen=True)
class Lab:
    """The folder, and what the laboratory calls it."""

    folder: Path
    name: str

    @property
    def sessions(self) -> Path:
        """Where sessions go that name no other folder."""
        return self.folder / "sessions"

    def holds(self, path: Path) -> bool:
        """Return whether a file lies in the folder, links followed."""
        return path.resolve().is_relative_to(self.folder)


def lab_here() -> Lab | None:
    """Return the lab folder that the working directory is or lies in, the nearest one; None if there is none.

    Raises: InputError B-LAB-001 if its ``bench.toml`` is not as it should be.
    """
    try:
        here = Path.cwd()
    except FileNotFoundError:  # somebody removed it
        return None
    folder = next((folder for folder in (here, *here.parents) if (folder / FILE).is_file()), None)
    return None if folder is None else Lab(folder.resolve(), _name(folder / FILE))


def _name(file: Path) -> str:
    try:
        content = tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError("B-LAB-001", f"cannot be read as TOML: {error}", where=str(file), next_step=_NEXT) from error
    lab = content.pop("lab", None)
    unknown = [*content, *(key for key in lab if key != "name")] if isinstance(lab, dict) else []
    if unknown:
        raise InputError("B-LAB-001", f"unknown key {unknown[0]!r}", where=str(file), next_step=_NEXT)
    name = lab.get("name") if isinstance(lab, dict) else None
    if not isinstance(name, str) or not name.strip():
        raise InputError("B-LAB-001", "does not name the laboratory", where=str(file), next_step=_NEXT)
    return name.strip()
