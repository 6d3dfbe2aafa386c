"""Texts of an analysis that a reader of another language gets in English: composed without a key."""

from __future__ import annotations

import re
from collections.abc import Iterator

from bench.analysis import Analysis
from bench.model.texts import Said

_WORDS = re.compile(r"\b(?!m?gauss\b)[A-Za-z]?[a-z]{4,}")  # other units and names of axes are shorter


def without_a_key(found: Analysis) -> list[str]:
    """Return texts with a word that is no sentence of a catalogue; names of records and units under test are given."""
    return [text for text in _texts(found) if _WORDS.search(text) and not isinstance(text, Said)]


def _texts(found: Analysis) -> Iterator[str]:
    yield from (*found.notes, *found.missing, *(check.sentence for check in found.evidence))
    for table in found.tables:
        yield from (table.title, table.caption, *table.headers)
    for figure in found.figures:
        yield from (figure.title, figure.caption, figure.x_label, figure.y_label)
        yield from (part.label for part in figure.series)
