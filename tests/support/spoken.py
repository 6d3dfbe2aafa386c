"""What a Korean reader of an analysis still gets in English."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

from bench.analysis import Analysis
from bench.model.texts import told

_WORDS = re.compile(r"[A-Za-z]{2,} [A-Za-z]{2,}")
_HANGUL = re.compile("[가-힣]")


def english_left(analysis: Analysis) -> set[str]:
    """Return texts of two words and more, of tables, figures, notes and evidence, that have no Korean letter."""
    sentences = [evidence.sentence for evidence in analysis.evidence]
    shown = [analysis.tables, analysis.figures, analysis.notes, analysis.missing, sentences]
    found = {text for text in _texts(told(shown, "ko")) if _WORDS.search(text)}
    return {text for text in found if not _HANGUL.search(text)}


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif is_dataclass(value):
        for field in fields(value):
            if field.name != "group":  # joins figures, is not shown
                yield from _texts(getattr(value, field.name))
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _texts(item)
