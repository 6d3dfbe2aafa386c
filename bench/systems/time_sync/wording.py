"""The sentences on a time offset, by key (texts/en.json)."""

from __future__ import annotations

from pathlib import Path

from bench.model.texts import Sayings

say = Sayings(Path(__file__).parent)


def filter_name(name: str) -> str:
    """Return the name of a filter for people."""
    return say(f"method.{name}")


def manoeuvre_name(name: str) -> str:
    """Return the word for a manoeuvre; one that the catalogue does not have stands as it is."""
    return say.word("manoeuvre", name) or say("received.not_stated")
