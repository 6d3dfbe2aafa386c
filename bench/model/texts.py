"""Texts for people, by key and language; English stands in for what a language does not have yet."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

ENGLISH = "en"


class Texts:
    """Catalogue of one package: ``<folder>/texts/<language>.json``, flat, key -> text with {names} for str.format.

    Raises: KeyError for a key that English does not have; OSError, ValueError if a catalogue cannot be read.
    """

    def __init__(self, folder: Path, language: str = ENGLISH) -> None:
        self.language = language
        english = _catalogue(folder / "texts" / f"{ENGLISH}.json")
        self._texts = english if language == ENGLISH else english | _catalogue(folder / "texts" / f"{language}.json")

    def __call__(self, key: str, /, **values: object) -> str:
        text = self._texts[key]
        return text.format(**values) if values else text

    @property
    def all(self) -> dict[str, str]:
        """Every text by key."""
        return dict(self._texts)


def languages(folder: Path) -> list[str]:
    """Return languages a package has a catalogue for, English first."""
    names = sorted(path.stem for path in (folder / "texts").glob("*.json"))
    return sorted(names, key=lambda language: language != ENGLISH)


@cache
def _catalogue(path: Path) -> dict[str, str]:
    catalogue: dict[str, str] = json.loads(path.read_text(encoding="utf-8"))
    return catalogue
