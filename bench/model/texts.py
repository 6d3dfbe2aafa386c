"""Texts for people, by key and language; English stands in for what a language does not have yet.

A sentence that a computation composes is written down in English, and still knows its key and its fields: whoever shows
it to a reader of another language asks for it in that language.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass, replace
from functools import cache, reduce
from pathlib import Path
from string import Formatter
from typing import Any, TypeVar

from bench.model.errors import InputError

ENGLISH = "en"
T = TypeVar("T")


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
        return _filled(text, values) if values else text

    @property
    def all(self) -> dict[str, str]:
        """Every text by key."""
        return dict(self._texts)


class Said(str):
    """An English sentence that knows its key and fields in the catalogue of a package; a field may be another one.

    It is that text wherever a text is due: in results.json, in an event, in another sentence.
    """

    __slots__ = ("fields", "folder", "key")
    folder: str
    key: str
    fields: Mapping[str, Any]

    def __new__(cls, english: str, folder: str, key: str, fields: Mapping[str, Any]) -> Said:
        """Return the sentence; ``folder`` is that of the package, ``english`` what its catalogue makes of the rest."""
        said = super().__new__(cls, english)
        said.folder, said.key, said.fields = folder, key, fields
        return said

    def __reduce__(self) -> tuple[type[Said], tuple[Any, ...]]:
        return Said, (str(self), self.folder, self.key, self.fields)

    def told(self, language: str) -> str:
        """Return the sentence in a language, in English where the catalogue has no such language or key."""
        try:
            text = _catalogue(Path(self.folder) / "texts" / f"{language}.json")[self.key]
        except (OSError, KeyError):
            return str(self)
        return _filled(text, told(self.fields, language)) if self.fields else text


class Sayings:
    """The sentences of a package by key: ``say("fit.none", why=...)``.

    Raises: KeyError for a key that English does not have.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def __call__(self, key: str, /, **values: object) -> str:
        text = _catalogue(self._folder / "texts" / f"{ENGLISH}.json")[key]
        return Said(_filled(text, values) if values else text, str(self._folder), key, values)

    def heads(self, table: str, *names: str, **values: object) -> list[str]:
        """Return the heads of the columns of a table; ``table``: "" for heads that are of no table in particular."""
        prefix = f"{table}.head" if table else "head"
        return [self(f"{prefix}.{name}", **values) for name in names]

    def listed(self, parts: Iterable[str], key: str = "list") -> str:
        """Return parts as one, "" for none; ``key``: of the text that joins {first} and {rest}."""
        each = list(parts)
        return reduce(lambda first, rest: self(key, first=first, rest=rest), each) if each else ""


def told(value: T, language: str) -> T:
    """Return a value with every sentence inside it in a language: of documents, tuples, lists and dataclasses."""
    return _told(value, language) if language != ENGLISH else value


def _told(value: Any, language: str) -> Any:
    if isinstance(value, Said):
        return value.told(language)
    if isinstance(value, dict):
        return {name: _told(item, language) for name, item in value.items()}
    if isinstance(value, list | tuple) and not hasattr(value, "_fields"):
        return type(value)(_told(item, language) for item in value)
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{field.name: _told(getattr(value, field.name), language) for field in fields(value)})
    return value


def languages(folder: Path) -> list[str]:
    """Return languages a package has a catalogue for, English first."""
    names = sorted(path.stem for path in (folder / "texts").glob("*.json"))
    return sorted(names, key=lambda language: language != ENGLISH)


def check_language(language: str, folder: Path) -> None:
    """Refuse a language that a package has no catalogue for. Raises: InputError B-TXT-001."""
    known = languages(folder)
    if language not in known:
        raise InputError(
            "B-TXT-001",
            f"there is no language {language!r}",
            where="--lang",
            next_step=f"use one of: {', '.join(known)}",
        )


class _Capitals(Formatter):
    """Formats as ``str.format`` does; ``{name!C}`` begins a sentence."""

    def convert_field(self, value: Any, conversion: str | None) -> Any:
        text = str(value)
        return text[:1].upper() + text[1:] if conversion == "C" else super().convert_field(value, conversion)


def _filled(text: str, values: Mapping[str, Any]) -> str:
    return _Capitals().vformat(text, (), values) if "!C" in text else text.format(**values)


@cache
def _catalogue(path: Path) -> dict[str, str]:
    catalogue: dict[str, str] = json.loads(path.read_text(encoding="utf-8"))
    return catalogue
