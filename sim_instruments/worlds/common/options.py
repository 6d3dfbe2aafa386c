"""Options of simulated worlds: texts from the station file or the command line, checked."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from bench.model.errors import InputError
from sim_instruments.faults.fault import plain_number

Check = Callable[[str], object]  # raises InputError B-SIM-002 if the text cannot be


def unknown_option(key: str, known: Sequence[str]) -> InputError:
    """Return the error of an option that a world does not have, B-SIM-002."""
    return InputError("B-SIM-002", f"no world option is called {key!r}", next_step=f"use one of: {', '.join(known)}")


def switch_of(key: str, value: str) -> bool:
    """Return whether an option is on. Raises: InputError B-SIM-002 if it is neither on nor off."""
    if value not in ("on", "off"):
        raise InputError("B-SIM-002", f"world option {key} is {value!r}", next_step=f"write {key}=on or {key}=off")
    return value == "on"


def number_of(key: str, value: str, least: float, most: float) -> float:
    """Return the number of an option. Raises: InputError B-SIM-002: no number, or not within ``least`` to ``most``."""
    number = plain_number(value)
    if not least <= number <= most:
        raise InputError(
            "B-SIM-002", f"world option {key} is {value!r}", next_step=f"write a number from {least:g} to {most:g}"
        )
    return number


def text_of(key: str, value: str, possible: Sequence[str] | Check) -> str:
    """Return the text of an option. Raises: InputError B-SIM-002 if it is not one of the words, or cannot be."""
    if callable(possible):
        possible(value)
    elif value not in possible:
        raise InputError(
            "B-SIM-002", f"world option {key} is {value!r}", next_step=f"write one of: {', '.join(possible)}"
        )
    return value


def any_text(value: str) -> None:
    """Take any text: whoever uses it checks it."""
    del value
