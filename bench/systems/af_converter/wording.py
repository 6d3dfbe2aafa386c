"""The sentences on AF converters, by key (texts/en.json)."""

from __future__ import annotations

from pathlib import Path

from bench.model.texts import Sayings

say = Sayings(Path(__file__).parent)


def kind_name(kind: str) -> str:
    """Return the word for a kind of channel; one that the catalogue does not have stands as it is."""
    return say.word("kind", kind)
