"""What a Korean reader of an analysis still gets in English."""

import re
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

from bench.analysis import Analysis
from bench.model.texts import told

_WORD = re.compile(r"\b(?!m?gauss\b|mrad\b)[A-Za-z]?[a-z]{4,}")  # other units and names of axes are shorter
_GIVEN = re.compile(r"\w+_\w+")  # a column of a log, by its mapping
_TWO_WORDS = re.compile(r"[A-Za-z]{2,} [A-Za-z]{2,}")
_HANGUL = re.compile("[가-힣]")
_NOT_SHOWN = ("group", "style")  # join figures, say how a curve is drawn


def english_left(analysis: Analysis) -> set[str]:
    """Return texts with an English word and no Korean letter: of sentences, titles, captions, heads and labels.

    Of the cells of tables, which hold names of records and units under test too, those of two words and more.
    """
    sentences = [check.sentence for check in analysis.evidence]
    cells = [table.rows for table in analysis.tables]
    heads = [(table.title, table.caption, table.headers) for table in analysis.tables]
    left = {text for text in _texts(told(cells, "ko")) if _TWO_WORDS.search(text)}
    for text in _texts(told([heads, analysis.figures, analysis.notes, analysis.missing, sentences], "ko")):
        left |= {text} if _WORD.search(_GIVEN.sub("", text)) else set()
    return {text for text in left if not _HANGUL.search(text)}


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif is_dataclass(value):
        for field in fields(value):
            if field.name not in _NOT_SHOWN:
                yield from _texts(getattr(value, field.name))
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _texts(item)
