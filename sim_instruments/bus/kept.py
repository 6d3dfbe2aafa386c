"""Settings of a SCPI instrument that change nothing in the simulation: kept within their limits, and told again."""

from __future__ import annotations

from dataclasses import dataclass

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


def number(default: float, low: float, high: float, unit: str = "", *, infinite: bool = False) -> Kept:
    """Return a setting that is a number. Source: definition."""
    return Kept(default, low, high, unit, infinite=infinite)


def word(*choices: str) -> Kept:
    """Return a setting that is one of some words, the first after ``*RST``. Source: definition."""
    return Kept("".join(letter for letter in choices[0] if not letter.islower()), choices=choices)


def switch(on: bool) -> Kept:
    """Return a setting that is on or off. Source: definition."""
    return Kept(on)
