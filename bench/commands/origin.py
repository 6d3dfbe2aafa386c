"""Files that a word of the command line means, and a line where a lab's own one stands in for an installed one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from bench.commands.console import warn
from bench.model.shipped import KINDS, Kind, find_shipped, replaced_by_lab


def named_file(kind: Kind, name_or_path: str) -> Path:
    """Return the file; say on standard error if a lab's own one is taken. Raises: InputError B-SHIP-001, B-LAB-001."""
    path = find_shipped(kind, name_or_path)
    _say(replaced_by_lab(kind, path))
    return path


def say_origins(files: Mapping[str, str]) -> None:
    """Say of the files of a plan, by their names in a session, which are a lab's own instead of installed ones."""
    for kind in KINDS:
        for path in (path for name, path in files.items() if name.startswith(f"{kind}/")):
            _say(replaced_by_lab(kind, Path(path)))


def _say(sentence: str) -> None:
    if sentence:
        warn(sentence)
