"""Settings of a SCPI instrument, from a table of text.

A row: header | attribute | after ``*RST`` | what it may be | how a question tells it.

- An attribute holds the setting; with ``!`` behind it the instrument acts on it at once. Without an attribute it
  changes nothing in the simulation: it is kept within its limits, and told again.
- After ``*RST``: ON or OFF, a number (told as whole as it is here), a word, a text in quotes; ``-``: it is left alone.
- What it may be: two limits (numbers, or attributes of the instrument), its unit, INF if it may be infinite; or words
  between commas, their short forms in capitals; or ``by`` the method that makes its value of a parameter; or
  ``switch``. Without anything it is a switch where ``*RST`` says ON or OFF, any number where it says one, else any
  text.
- How: the format of the value, ``-`` if nobody can ask. A header with a question mark is only asked.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from functools import lru_cache
from operator import attrgetter
from typing import Any, NamedTuple

INFINITE = 9.9e37
_NAMES = dict.fromkeys(("INF", "INFINITY", "INFINITE"), INFINITE)

Reader = Callable[[Any, str], Any]


class Setting(NamedTuple):
    """One row; ``read`` makes its value of a parameter, for an instrument.

    ``limited``: a number whose limits can be asked for.   ``more``: a column behind those of all.
    """

    header: str
    attribute: str
    default: Any
    read: Reader
    form: str
    applied: bool
    limited: bool
    more: str

    def tell(self, owner: Any) -> str:
        """Return the value that its owner holds as a question tells it."""
        return self.form.format(attrgetter(self.attribute)(owner))

    def hold(self, owner: Any, value: Any) -> None:
        """Give its owner a value."""
        place, _, name = self.attribute.rpartition(".")
        setattr(attrgetter(place)(owner) if place else owner, name, value)


@lru_cache
def settings_of(table: str) -> tuple[Setting, ...]:
    """Return the rows of a table."""
    return tuple(_setting(*map(str.strip, f"{row}|||||".split("|"))) for row in table.strip().splitlines())


def _setting(header: str, attribute: str, after: str, allowed: str, form: str, more: str, *_: str) -> Setting:
    default = None if after == "-" else after.strip('"') if allowed[:1].isupper() else _value(after)
    if not form:
        form = "d" if isinstance(default, int) else "+.13E" if isinstance(default, float) else ""
    told = form if form == "-" else f'"{{:{form}}}"' if after.startswith('"') else f"{{:{form}}}"
    name = attribute.removesuffix("!")
    limited = type(default) in (int, float) and allowed[:1] not in ("", "b")
    return Setting(header, name or header, default, _reader(default, allowed), told, name != attribute, limited, more)


def _value(text: str) -> Any:
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return kind(text)
    return {"ON": True, "OFF": False}.get(text, text.strip('"'))


def _reader(default: Any, allowed: str) -> Reader:
    first, *more = allowed.split() or [""]
    if first == "by":
        return lambda device, text: getattr(device, more[0])(text)
    if first[:1].isupper():
        words = allowed.split(", ")
        return lambda device, text: device.word(text, *words)
    if first == "switch" or isinstance(default, bool):
        return lambda device, text: device.boolean(text)
    if not first and type(default) not in (int, float):
        return lambda device, text: text.strip("\"'")
    first, *more = (first, *more) if first else ("-inf", "inf")
    names = _NAMES if "INF" in more else {}
    names = names if default is None else {**names, "DEF": default}
    unit = more[1] if more[1:] and more[1] != "INF" else ""
    low, high = _value(first), _value(more[0])

    def number(device: Any, text: str) -> float:
        limits = (attrgetter(limit)(device) if isinstance(limit, str) else limit for limit in (low, high))
        value: float = device.number(text, *limits, unit, **names)
        return round(value) if isinstance(default, int) else value

    return number
