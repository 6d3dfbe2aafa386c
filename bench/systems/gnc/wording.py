"""The sentences on GNC modules and inertial units, by key (texts/en.json)."""

from __future__ import annotations

from pathlib import Path

from bench.model.texts import Said, Sayings

_FOLDER = Path(__file__).parent
_ENDINGS = ("beyond_limits", "deviation")

say = Sayings(_FOLDER)


def kind_name(kind: str) -> str:
    """Return the word for a kind of sensor; one that the catalogue does not have stands as it is."""
    return say.word("kind", kind)


def record_name(item: str) -> str:
    """Return the word for what a record is of; one that the catalogue does not have stands as it is."""
    return say.word("record", item)


def channel_name(name: str) -> str:
    """Return the name of a channel, such as "gyro x", for people."""
    kind, _, axis = name.partition(" ")
    return say("sensor", kind=kind_name(kind), axis=axis) if axis else kind_name(kind)


def quantity_word(name: str) -> str:
    """Return the name of a quantity within a sentence or a table; one that the catalogue does not have in English."""
    for ending in _ENDINGS:
        if name.endswith(f"_{ending}"):
            quantity = quantity_word(name.removesuffix(f"_{ending}"))
            return Said(name.replace("_", " "), str(_FOLDER), f"ending.{ending}", {"quantity": quantity})
    return Said(name.replace("_", " "), str(_FOLDER), f"quantity.{name}", {})


def quantity_name(name: str) -> str:
    """Return the name of a quantity as reports head their rows with it."""
    for ending in _ENDINGS:
        if name.endswith(f"_{ending}"):
            return say(f"ending.{ending}", quantity=quantity_name(name.removesuffix(f"_{ending}")))
    return say(f"quantity.{name}")


def refused(what: str, why: str, code: str) -> str:
    """Return what has no result, and the error that is the reason."""
    return say("missing.refused", what=what, why=why, code=code)
