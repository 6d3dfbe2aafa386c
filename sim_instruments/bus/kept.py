"""Settings of a SCPI instrument: those an attribute holds, and those that change nothing in the simulation.

What changes nothing is kept within its limits, and told again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

INFINITE = 9.9e37


@dataclass(frozen=True)
class Kept:
    """``default``: after ``*RST``.

    A number, told as whole as its default, has ``low``, ``high`` and perhaps a ``unit``, or may be ``infinite``; a word
    its ``choices``, the short form in capitals; neither is on or off. ``text``: a string in quotes.
    """

    default: float | str | bool
    low: float = 0.0
    high: float = 0.0
    unit: str = ""
    choices: tuple[str, ...] = ()
    text: bool = False
    infinite: bool = False

    @property
    def names(self) -> dict[str, float]:
        """The numbers that have a word."""
        names = {"DEF": float(self.default)}
        return names | {"INF": INFINITE, "INFINITY": INFINITE, "INFINITE": INFINITE} if self.infinite else names

    @property
    def told(self) -> str:
        """The default as it is told."""
        return self.form(self.default)

    def form(self, value: float | str | bool) -> str:
        """Return a value as a question tells it."""
        if isinstance(value, bool):
            return str(int(value))
        if isinstance(self.default, int) and not isinstance(value, str):
            return str(round(value))
        if isinstance(value, str):
            return f'"{value}"' if self.text else value
        return f"{value:+.13E}"


def word(*choices: str) -> Kept:
    """Return a setting that is one of some words, the first after ``*RST``. Source: definition."""
    return Kept("".join(letter for letter in choices[0] if not letter.islower()), choices=choices)


KeptSettings = Mapping[str, Kept]  # by header


@dataclass(frozen=True)
class Held:
    """A setting that an attribute of the instrument holds.

    ``read``: makes its value of a parameter.   ``form``: how a question tells it, None if nobody can ask.
    ``applied``: the instrument acts on it at once.
    """

    attribute: str
    read: Callable[[Any, str], Any]
    form: str | None
    applied: bool = False


HeldSettings = Mapping[str, Held]  # by header


def held_number(
    attribute: str, low: float, high: float, unit: str = "", form: str | None = None, *, applied: bool = False
) -> Held:
    """Return a number within limits. Source: definition."""
    return Held(attribute, lambda device, text: device.number(text, low, high, unit), form, applied)


def held_count(attribute: str, low: int, high: int, form: str | None = None) -> Held:
    """Return a whole number within limits. Source: definition."""
    return Held(attribute, lambda device, text: int(device.number(text, low, high)), form)


def held_word(attribute: str, *choices: str, form: str | None = "") -> Held:
    """Return one of some words. Source: definition."""
    return Held(attribute, lambda device, text: device.word(text, *choices), form)


def held_switch(attribute: str, form: str | None = "d", *, applied: bool = False) -> Held:
    """Return what is on or off. Source: definition."""
    return Held(attribute, lambda device, text: device.boolean(text), form, applied)
