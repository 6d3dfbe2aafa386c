"""Names of quantities, conditions and campaigns for people: from the catalogue of the system that an analysis is of."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from bench.model.installed import spec_of
from bench.model.systems import installed_analysis
from bench.model.texts import ENGLISH, Texts, languages

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
