"""The sentences on ring lasers, by key (texts/en.json)."""

from __future__ import annotations

from pathlib import Path

from bench.model.texts import Sayings

say = Sayings(Path(__file__).parent)


def label(method: str) -> str:
    """Return how people call a compensator, or the output without one."""
    return say(f"method.{method}")
