"""The systems that are installed, by their declarations; what a declaration names is loaded when it is asked for.

The declarations of the bench itself are read at once. A foreign one is read when a name is asked for that no system of
the bench has; where it cannot be used, that is told to who asks for all or for something that nobody has.
An analysis of a lab folder belongs to no system: its one file holds its declaration too.

Behind them what no data of a campaign can show, by name: the assumption, the size that passes unseen, and what would
show it. An effect that changes every reading as the wanted quantity would leaves no residual; it is said before the
campaign by ``bench check`` and after it in results.json and the report (docs/method-uncertainty.md).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from typing import Any, NamedTuple, TypeVar

from bench.model import lab
from bench.model.declaration import AnalysisDeclaration, System
from bench.model.errors import InstallationError
from bench.model.installed import OWN, Offer, Refusal, named, offers, refuse_unknown, try_foreign, twice, unusable
from bench.model.yamlio import StrictModel

_Sections = TypeVar("_Sections", bound=StrictModel)


class Entry(NamedTuple):
    """An installed analysis, its system and the offer that it came with."""

    analysis: AnalysisDeclaration
    system: System
    offer: Offer


@cache
def _own() -> tuple[tuple[System, Offer], ...]:
    """Return the systems of the bench. Raises: InstallationError B-PKG-002, B-PKG-004 for its own."""
    return tuple((_declaration(offer), offer) for offer in offers("systems") if offer.distribution == OWN)


@cache
def _foreign() -> tuple[list[tuple[System, Offer]], list[Refusal]]:
    """Return the foreign systems that can be used, and those that cannot: what is offered twice is nobody's."""
    read: list[tuple[System, Offer]] = []
    refusals = []
    for offer in offers("systems"):
        try:
            read += [] if offer.distribution == OWN else [(_declaration(offer), offer)]
        except InstallationError as error:
            refusals.append(Refusal(offer, error))
    names = {offer: [offer.what, *(f"the analysis {one.name!r}" for one in system.analyses)]
             for system, offer in [*_own(), *read]}  # fmt: skip
    times = Counter(name for of_offer in names.values() for name in of_offer)
    for _, offer in read:
        if doubled := [name for name in names[offer] if times[name] > 1]:
            other = next(other for other in names if other != offer and doubled[0] in names[other])
            refusals.append(Refusal(offer, twice(doubled[0], other, offer)))
    refused = {offer for offer, _ in refusals}
    return [pair for pair in read if pair[1] not in refused], refusals


def _declaration(offer: Offer) -> System:
    declared = named(f"{offer.package}.declaration:DECLARATION")
    if not isinstance(declared, System) or declared.name != offer.name:
        raise unusable(f"{offer.package}.declaration", f"holds no DECLARATION of {offer.what}")
    return declared


def own_systems() -> tuple[System, ...]:
    """Return the declarations of the bench itself, by name. Raises: InstallationError B-PKG-002, B-PKG-004."""
    return tuple(system for system, _ in _own())


def systems() -> tuple[System, ...]:
    """Return all declarations that can be used, by name. Raises: as ``own_systems``."""
    return tuple(sorted((system for system, _ in [*_own(), *_foreign()[0]]), key=lambda system: system.name))


def system_refusals() -> Sequence[Refusal]:
    """Return the foreign systems that cannot be used: B-PKG-001 offered twice, B-PKG-004 not to be loaded."""
    return _foreign()[1]


def systems_named(
    analysis: object, names: Iterable[str], names_of: Callable[[System], Collection[str]]
) -> tuple[System, ...]:
    """Return the systems of the bench and the foreign ones that a file names, by name.

    Args:   analysis: that the file names.   names: of its keys; ``names_of`` says which of them are of a system.
    Raises: InstallationError B-PKG-001, B-PKG-004 for an analysis that nothing usable has and a refused system may.
    """
    own, asked = own_systems(), analysis if isinstance(analysis, str) else "none"
    entry = installed_analysis(asked)
    if entry is None and analysis_declaration(asked) is None:
        refuse_unknown_analysis(asked)
    others = set(names) - {name for system in own for name in names_of(system)}
    if not others and (entry is None or entry.system in own):
        return own
    wanted = () if entry is None else (entry.system,)
    foreign = (system for system, _ in _foreign()[0] if system in wanted or others & {*names_of(system)})
    return tuple(sorted((*own, *foreign), key=lambda system: system.name))


def analyses() -> Mapping[str, Entry]:
    """Return all installed analyses that can be used, by name."""
    return _by_name([*_own(), *_foreign()[0]])


def _by_name(systems: Iterable[tuple[System, Offer]]) -> dict[str, Entry]:
    return {analysis.name: Entry(analysis, system, offer) for system, offer in systems for analysis in system.analyses}


def installed_analysis(name: str) -> Entry | None:
    """Return an installed analysis, None for a name that no usable system has; foreign ones are asked last."""
    if not lab.is_plain(name):
        return None
    return _by_name(_own()).get(name) or analyses().get(name)


def analysis_declaration(name: str) -> AnalysisDeclaration | None:
    """Return the declaration of an analysis, of a system or of the lab folder; None for a name that neither has.

    Raises: InputError B-LAB-001; InstallationError B-LAB-004 to B-LAB-006 for one of the lab folder that cannot be
            used.
    """
    if lab.own_code("analyses", name) is not None:
        return _declaration_of_lab(name)
    entry = installed_analysis(name)
    return None if entry is None else entry.analysis


def declared_by(campaign: Mapping[str, Any]) -> AnalysisDeclaration | None:
    """Return the declaration of the analysis that a campaign asks for, as ``analysis_declaration``."""
    return analysis_declaration(str(campaign.get("analysis", "none")))


def refuse_unknown_analysis(name: str) -> None:
    """Refuse an analysis that nobody has, if a system that cannot be used may have it.

    Raises: InstallationError B-PKG-001, B-PKG-004.
    """
    if not lab.is_plain(name):
        return
    close = get_close_matches(name, analyses(), n=1)
    meant = f" (did you mean {close[0]!r}?)" if close else ""
    refuse_unknown(f"the analysis {name!r}{meant}", name, system_refusals())


def is_size(analysis: str, quantity: str) -> bool:
    """Return True for a quantity that its analysis declares as a size, which cannot be negative.

    Raises: as ``analysis_declaration``.
    """
    declared = analysis_declaration(analysis)
    return declared is not None and quantity in declared.sizes


def _declaration_of_lab(name: str) -> AnalysisDeclaration:
    if (entry := installed_analysis(name)) is not None:
        raise lab.refused_twice("analyses", name, entry.offer.release)
    module = lab.load("analyses", name)
    assert module is not None
    declared = getattr(module, "DECLARATION", None)
    if not isinstance(declared, AnalysisDeclaration) or (declared.name, declared.module) != (name, module.__name__):
        raise unusable(module.__name__, f"holds no DECLARATION with the name {name!r} and the module __name__")
    if declared.made_of == "logs":
        raise unusable(module.__name__, "is made of imported logs, which systems analyse")
    if not declared.methods or getattr(module, "METHODS", None) != declared.methods:
        raise unusable(module.__name__, "has METHODS that are not the methods of its DECLARATION")
    return declared


def try_analysis(name: str) -> None:
    """Import all that a campaign will need of a foreign analysis or one of the lab, before it begins.

    Raises: InstallationError B-PKG-004, B-LAB-006.
    """
    one, entry = analysis_declaration(name), installed_analysis(name)
    if one is None:
        return
    texts = [f"{one.module}:analyse", one.problems, one.assumptions, one.predicted, one.point, one.design]
    if entry is not None:
        made = entry.system.coefficients
        texts += [entry.system.early, *((made.module, made.header) if made is not None else ())]
    try_foreign(one.module if entry is None else f"{entry.offer.package}.declaration", filter(None, texts))


def system_of_analysis(name: str) -> System | None:
    """Return the system that an analysis belongs to, None for one of the lab folder and for an unknown name."""
    entry = installed_analysis(name)
    return None if entry is None else entry.system


def fields_of(sections: type[StrictModel] | None) -> Collection[str]:
    """Return the keys of the sections of a system, none without."""
    return () if sections is None else sections.model_fields


def sections_in(model: StrictModel, kind: type[_Sections]) -> tuple[type[_Sections], ...]:
    """Return the sections of one kind that the form of a file was made with, by ``with_sections``."""
    return tuple(base for base in type(model).__bases__ if issubclass(base, kind))


def with_sections(form: type[StrictModel], sections: Sequence[type[StrictModel]]) -> tuple[type[StrictModel], ...]:
    """Return the bases of a form of the engine with the sections of all systems.

    Raises: InstallationError B-PKG-001 if two of them have a field of one name.
    """
    owners: dict[str, type[StrictModel]] = {}
    for fields in (form, *sections):
        for name in fields.model_fields:
            if owners.setdefault(name, fields) is not fields:
                message = f"{owners[name].__module__} and {fields.__module__} both declare the section {name!r}"
                raise InstallationError("B-PKG-001", message, next_step="uninstall the system of one of them")
    return (form, *sections)


@dataclass(frozen=True)
class Assumption:
    """One thing that is taken for granted, in short sentences with numbers and units.

    ``unseen``: size that leaves no trace in this campaign.   ``effect``: what it does to which number.   ``shown_by``:
    measurement that would show it.   ``quantities``: the estimates it bears on; none named is every one.
    """

    code: str
    taken_for_granted: str
    unseen: str
    effect: str
    shown_by: str
    quantities: tuple[str, ...] = ()


def assumed(
    say: Callable[..., str],
    code: str,
    quantities: tuple[str, ...] = (),
    *,
    key: str = "",
    taken: str = "taken",
    unseen: str = "unseen",
    effect: str = "effect",
    **fields: object,
) -> Assumption:
    """Return an assumption in the words of a catalogue, under ``key`` or its code.

    ``taken``, ``unseen``, ``effect``: endings of their keys, given where these depend on the campaign.
    ``fields``: what stands in the sentences.
    """
    sentences = [say(f"assumption.{key or code}.{ending}", **fields) for ending in (taken, unseen, effect, "shown")]
    return Assumption(code, sentences[0], sentences[1], sentences[2], sentences[3], quantities)


def assumptions_of(campaign: Mapping[str, Any]) -> list[Assumption]:
    """Return what a campaign takes for granted, by the section "campaign" of its plan or manifest.

    Empty for a campaign that only records.
    """
    declared = declared_by(campaign)
    return list(named(declared.assumptions)(campaign)) if declared is not None and declared.assumptions else []
