"""The sentences on north finders, by key (texts/en.json)."""

from __future__ import annotations

from pathlib import Path

from bench.model.texts import Sayings

_SENSES = {1: "counter_clockwise", -1: "clockwise"}

say = Sayings(Path(__file__).parent)


def item_name(item: str) -> str:
    """Return the word for what a set is of; one that the catalogue does not have stands as it is."""
    return say.word("item", item)


def method_name(method: str) -> str:
    """Return the word for a method."""
    return say(f"method.{method}")


def place_name(place: str) -> str:
    """Return the word for a place; a dash for none, one that the catalogue does not have as it is."""
    return say.word("place", place) or "–"


def sense_name(sense: int) -> str:
    """Return the word for a sense of rotation seen from above: +1 counter-clockwise, -1 clockwise."""
    return say(f"sense.{_SENSES[sense]}")
