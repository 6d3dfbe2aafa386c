"""Declarations of a driver on its replies: which of them say that something is on, and how far.

The state of the bench that people see is made of replies alone (bench.run.feed.outputs), so that a recording gives it
too: no instrument is believed to be off because it was told so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Figure:
    """What a reply gives to read: ``name`` for people ("current"), its base unit, and how it is read.

    ``read`` raises ValueError for a reply of another form. Closed crosspoints have no unit: it returns their names.
    """

    name: str
    unit: str
    read: Callable[[str], float | tuple[str, ...]]


@dataclass(frozen=True)
class Tells:
    """What the replies of one model tell, by question as the driver sends it.

    ``on``: questions of which each says whether something is on, closed or turning (True); it is off when all say so.
    ``figures``: questions that say how far.
    """

    on: Mapping[str, Callable[[str], bool]]
    figures: Mapping[str, Figure] = field(default_factory=dict)


def is_one(reply: str) -> bool:
    """Return whether a switch reads back on. Raises: ValueError unless it is 0 or 1."""
    value = float(reply)
    if value not in (0.0, 1.0):
        raise ValueError("0 or 1 is due")
    return value == 1.0
