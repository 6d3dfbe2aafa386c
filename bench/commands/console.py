"""The console of the command line: plain text where there is no terminal.

Files that a word of the command line means, and a line where a lab's own one stands in for an installed one.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Container, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from bench.model.clock import NS, WallClock
from bench.model.lab import KINDS, Kind, find_shipped, replaced_by_lab
from bench.model.units import hours

PLAIN_COLUMNS = 110


def console(stderr: bool = False) -> Console:
    """Return the console of the command line; it falls back to plain text where there is no terminal.

    A terminal that is narrower than the tables breaks their lines; a table made to fit it would cut numbers off.
    """
    terminal = Console(stderr=stderr, highlight=False, soft_wrap=True, markup=False, emoji=False)
    if not terminal.is_terminal:
        terminal.width = PLAIN_COLUMNS
    elif not stderr:
        terminal.width = max(terminal.width, PLAIN_COLUMNS)
    return terminal


def say(text: str | Path | Exception) -> None:
    """Print a line on standard output."""
    console().print(str(text))


def warn(text: str | Path | Exception) -> None:
    """Print a line on standard error."""
    console(stderr=True).print(str(text))


def headed_table(
    title: str,
    heads: Sequence[str],
    rows: Iterable[Sequence[str]] = (),
    *,
    whole: Container[str] = (),
    left: Container[str] | None = None,
) -> Table:
    """Return a table with folding columns; ``whole``: heads of those that do not fold, ``left``: not of
    numbers, None for all."""
    table = plain_table(title)
    for name in heads:
        table.add_column(
            name, justify="left" if left is None or name in left else "right", overflow="fold", no_wrap=name in whole
        )
    for row in rows:
        table.add_row(*row)
    return table


class TaskLines:
    """A line on standard error for each task that is done; the time left is that of those done since it began."""

    def __init__(self, total: int = 0) -> None:
        self._clock = WallClock()
        self._out = console(stderr=True)
        self.begin(total, 0)

    def begin(self, total: int, done: int) -> None:
        """Tell how many of how many tasks are done already."""
        self._total, self._count, self._before, self._began_ns = total, done, done, self._clock.now_ns()
        if done:
            self._out.print(f"{done}/{total}  done before")

    def done(self, name: str) -> None:
        """Tell of one more."""
        self._count += 1
        spent_s = (self._clock.now_ns() - self._began_ns) / NS
        left = self._total - self._count
        eta = f"  {hours(spent_s * left / (self._count - self._before))} left" if left > 0 else ""
        of = f"/{self._total}" if self._total else ""
        self._out.print(f"{self._count}{of}  {name}{eta}")


def plain_table(title: str) -> Table:
    """Return an empty table in the form of all tables of the command line; ``title``: "" for none."""
    return Table(title=title or None, box=box.SIMPLE, title_justify="left", collapse_padding=True, pad_edge=False)


def print_json(document: Any, **form: Any) -> None:
    """Print one JSON document on standard output. ``form``: further settings of the writer."""
    sys.stdout.write(json.dumps(document, indent=1, **form) + "\n")


def print_sorted_json(document: Any) -> None:
    """Print a JSON document with its keys in order, and no number that JSON does not have."""
    print_json(document, sort_keys=True, ensure_ascii=False, allow_nan=False)


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
