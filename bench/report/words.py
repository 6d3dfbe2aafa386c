"""The catalogue of the report: its fixed texts by key and language (texts/en.json)."""

from __future__ import annotations

from pathlib import Path

from bench.analysis import header
from bench.model.texts import Texts

FOLDER = Path(__file__).parent


def words_of(language: str) -> Texts:
    """Return the texts of the report in a language; English stands in for what it does not have."""
    return Texts(FOLDER, language)


def column(words: Texts, key: str) -> str:
    """Return the heading of a field: that of the catalogue, else made of the field's own name."""
    return words.all.get(f"column.{key}") or header(key)


def kind_of(words: Texts, kind: object) -> str:
    """Return the word for a kind of channel; a kind that the catalogue does not have stands as it is."""
    return words.all.get(f"kind.{kind}", str(kind))


def channel_title(words: Texts, number: object, kind: object) -> str:
    """``channel 1, gyro``: the title of a panel."""
    return words("channel.title", number=number, kind=kind_of(words, kind)) if kind else words("channel", number=number)
