"""Errors that a technician reads: where, the value, the limit and what to do next.

Every error has a stable code ``B-AREA-NNN``, which maps to one exit status of the contract. What happened and what
to do about each stands in errors.json, from which ``bench explain`` and the site have it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from enum import IntEnum
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

MAX_LISTED = 100
_ADVISES = re.compile("did you mean |; (write|use) ")  # a message with this says itself what to do


class ExitStatus(IntEnum):
    """Exit status of the ``bench`` command."""

    PASS = 0
    VERDICT_FAIL = 1
    BAD_INPUT = 2
    SAFE_AFTER_FAULT = 3
    SAFE_BY_OPERATOR = 4
    SESSION_DAMAGED = 5
    INTERNAL = 70


class BenchError(Exception):
    """Base of every error the bench raises on purpose.

    Args:
        code: stable code, ``B-AREA-NNN``.
        message: what is wrong, with the value and the limit, in one sentence.
        where: ``file:line:column``, resource or role of an instrument, or ``byte N`` of a stream.
        next_step: what the reader can do about it.
    """

    exit_status = ExitStatus.INTERNAL

    def __init__(self, code: str, message: str, *, where: str | Path = "", next_step: str = "") -> None:
        super().__init__(message)
        self.code = code
        self.message = message
        self.where = str(where)
        self.next_step = next_step

    def __str__(self) -> str:
        place = f"{self.where}: " if self.where else ""
        stop = "" if self.message.endswith((".", "!", "?")) else "."
        advice = f"{stop} Next: {self.next_step}" if self.next_step else ""
        return f"error {self.code}: {place}{self.message}{advice}"


@cache
def words_in(table: str) -> Any:
    """Return a table of words that stands beside this file, by its name; ``errors.json`` by the codes."""
    return json.loads((files("bench.model") / table).read_text(encoding="utf-8"))


class InputError(BenchError):
    """A file or an argument is wrong; nothing was started."""

    exit_status = ExitStatus.BAD_INPUT

    def __str__(self) -> str:
        """Return it with the next step of its code, if neither it nor its message names one."""
        line, row = super().__str__(), words_in("errors.json").get(self.code)
        if row is None or self.next_step or _ADVISES.search(line):
            return line
        return f"{line.rstrip('.')}. Next: {row['next']}".replace("`", "'")


NEXT_FORM = "go on with the version of the bench that wrote it; nothing was changed"


def unknown_form(document: Mapping[str, Any], key: str = "v") -> str:
    """Return what a document is whose form this software does not know, in words; "" for the first form.

    ``key``: names the form; old documents of the first one have none.
    """
    form = document.get(key, 1)
    return "" if form == 1 else f"of form {form}, and this software knows form 1"


class InputErrors(InputError):
    """All mistakes found in one reading of the input, sorted by position."""

    def __init__(self, errors: Iterable[InputError]) -> None:
        self.errors = list(errors)
        first = self.errors[0]
        super().__init__(first.code, first.message, where=first.where, next_step=first.next_step)

    def __str__(self) -> str:
        return "\n".join(str(error) for error in self.errors)


def listed(mistakes: Sequence[InputError]) -> list[InputError]:
    """Return the first MAX_LISTED of mistakes in order, and how many more there are (B-YAML-017)."""
    more = mistakes[MAX_LISTED:]
    note = f"{len(more)} more mistakes are not listed"
    return [*mistakes[:MAX_LISTED], *(InputError("B-YAML-017", note, where=first.where) for first in more[:1])]


class InstallationError(BenchError):
    """A package that the bench needs is missing, foreign, damaged or offered twice; where = its file."""

    exit_status = ExitStatus.BAD_INPUT


class InstrumentError(BenchError):
    """An instrument refused, failed, timed out or is not the one expected; where = role and resource."""

    exit_status = ExitStatus.SAFE_AFTER_FAULT


class LinkError(BenchError):
    """A serial link to the unit under test failed."""

    exit_status = ExitStatus.SAFE_AFTER_FAULT


class RunError(BenchError):
    """The run cannot go on (soak not reached, verify failed ...); the bench was left safe."""

    exit_status = ExitStatus.SAFE_AFTER_FAULT


class OperatorStop(BenchError):
    """The operator ended the run."""

    exit_status = ExitStatus.SAFE_BY_OPERATOR


class SessionDamaged(BenchError):
    """A recorded session is damaged or does not reproduce; where = segment and byte."""

    exit_status = ExitStatus.SESSION_DAMAGED


class FitError(BenchError):
    """The rows do not determine what was asked for, or are not usable."""

    exit_status = ExitStatus.BAD_INPUT
