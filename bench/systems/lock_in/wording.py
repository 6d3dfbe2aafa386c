"""The sentences on ring lasers, by key (texts/en.json)."""

from __future__ import annotations

from collections.abc import Iterable
from functools import reduce
from pathlib import Path

from bench.model.texts import Sayings

say = Sayings(Path(__file__).parent)


def label(method: str) -> str:
    """Return how people call a compensator, or the output without one."""
    return say(f"method.{method}")


def listed(parts: Iterable[str], key: str = "list") -> str:
    """Return parts as one, "" for none; ``key``: of the text that joins two."""
    told = list(parts)
    return reduce(lambda first, rest: say(key, first=first, rest=rest), told) if told else ""
