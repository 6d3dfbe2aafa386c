"""The sentences on AF converters, by key (texts/en.json)."""

from __future__ import annotations

from pathlib import Path

from bench.model.texts import Sayings

_KINDS = ("gyro", "accelerometer")

say = Sayings(Path(__file__).parent)


def kind_name(kind: str) -> str:
    """Return the word for a kind of channel; one that the catalogue does not have stands as it is."""
    return say(f"kind.{kind}") if kind in _KINDS else kind
