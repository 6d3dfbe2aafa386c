"""Texts for people, by key and language; English stands in for what a language does not have yet.

A sentence that a computation composes is written down in English, and still knows its key and its fields: whoever shows
it to a reader of another language asks for it in that language. Names of quantities, conditions and campaigns come from
the catalogue of the system that an analysis is of.
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
from bench.model.installed import spec_of
from bench.model.systems import installed_analysis

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
        text = self._english[key]
        return Said(_filled(text, values) if values else text, str(self._folder), key, values)

    @property
    def _english(self) -> dict[str, str]:
        return _catalogue(self._folder / "texts" / f"{ENGLISH}.json")

    def word(self, kind: str, name: str) -> str:
        """Return the word for a name of its kind; one that the catalogue does not have stands as it is."""
        key = f"{kind}.{name}"
        return self(key) if key in self._english else name

    def heads(self, table: str, /, *names: str, **values: object) -> list[str]:
        """Return the heads of the columns of a table: its own by each name, else that of no table in particular."""
        own = f"{table}.head."
        return [self((own if own + name in self._english else "head.") + name, **values) for name in names]

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


_QUANTITY, _ENDING = "quantity.", "ending."


def quantity_title(analysis: str, quantity: str, language: str = ENGLISH) -> str:
    """Return the name of a quantity for people, ``Scale-factor error N`` for ``dsf_n``.

    Args:    analysis: that made it, as results.json names it under "campaign".
    Returns: ``quantity.<name>`` of the system's ``texts/<language>.json``; else ``ending.<last part>`` around the
             title of what stands before it; else, for a name that a sequence or a foreign system gave, the name itself
             with its underscores as blanks.
    """
    texts = _texts(analysis, language)
    if _QUANTITY + quantity in texts:
        return texts[_QUANTITY + quantity]
    for key, text in texts.items():
        base = quantity.removesuffix("_" + key.removeprefix(_ENDING))
        if key.startswith(_ENDING) and base != quantity:
            return text.format(quantity=quantity_title(analysis, base, language))
    return quantity.replace("_", " ")


def quantity_titles(analysis: str, quantity: str) -> dict[str, str]:
    """Return the name of a quantity for people in every language that its system has a catalogue for, by language."""
    return {language: quantity_title(analysis, quantity, language) for language in _languages(analysis) or [ENGLISH]}


def condition_title(analysis: str, name: str, language: str = ENGLISH) -> str | None:
    """Return the name of a condition for people, ``condition.<name>`` of the system; None if it has none."""
    return _texts(analysis, language).get(f"condition.{name}")


def sizes_of_assumptions(analysis: str, language: str = ENGLISH) -> str:
    """Return what the sizes in the assumptions of an analysis hold for, ``assumption.sizes`` of the system, or ""."""
    return _texts(analysis, language).get("assumption.sizes", "")


def value_title(analysis: str, name: str, value: str, language: str = ENGLISH) -> str:
    """Return the word that is the value of a condition for people, ``<name>.<word>``; else itself, with blanks."""
    return _texts(analysis, language).get(f"{name}.{value.replace(' ', '_')}", value.replace("_", " "))


def campaign_title(analysis: str, language: str = ENGLISH) -> str:
    """Return the name of an analysis for people, ``campaign.<name>`` of its system; else itself, with blanks."""
    return _texts(analysis, language).get(f"campaign.{analysis}", analysis.replace("_", " "))


def sequence_title(analysis: str, sequence: str, title: str, language: str = ENGLISH) -> str:
    """Return the title of a sequence, of a shipped one in a language: ``sequence.<name>`` of the system.

    ``title``: of its YAML; where it is not what the English catalogue has, it is a laboratory's own and stays.
    """
    key = f"sequence.{sequence}"
    return _texts(analysis, language)[key] if _texts(analysis, ENGLISH).get(key) == title else title


@cache
def _texts(analysis: str, language: str) -> dict[str, str]:
    """Return the texts of the system that an analysis belongs to; none for one of a lab or without a catalogue."""
    known, folder = _languages(analysis), _folder(analysis)
    return Texts(folder, language if language in known else ENGLISH).all if known and folder is not None else {}


@cache
def _languages(analysis: str) -> list[str]:
    folder = _folder(analysis)
    return [] if folder is None else languages(folder)


def _folder(analysis: str) -> Path | None:
    """Return the folder of the package of an analysis, None for one of a lab and for an unknown name."""
    entry = installed_analysis(analysis)
    spec = None if entry is None else spec_of(entry.offer.package)
    return None if spec is None or spec.origin is None else Path(spec.origin).parent
