"""How a driver finds out whether a command that may not have arrived took effect."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class ReadBack:
    """``see`` asks for the state; ``done`` and ``untouched`` judge it: as the command wants it, as it was before.

    What is neither is an error. ``untouched`` allows the command to be sent a second time.
    """

    see: Callable[[], Any]
    done: Callable[[Any], bool]
    untouched: Callable[[Any], bool]


def either(see: Callable[[], Any], wanted: object) -> ReadBack:
    """Of a state that is as wanted or as before, there is no third: an output on or off."""
    return ReadBack(see, lambda found: found == wanted, lambda found: found != wanted)
