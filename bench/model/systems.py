"""The systems that are installed, by their declarations; what a declaration names is loaded when it is asked for.

An analysis of a lab folder belongs to no system: its one file holds its declaration too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from importlib import import_module
from typing import Any

from bench.model import lab_code
from bench.model.declaration import AnalysisDeclaration, System
from bench.model.errors import InstallationError
from bench.model.installed import Offer, offers, twice
from bench.model.yamlio import StrictModel


@cache
def systems() -> tuple[System, ...]:
    """Return all declarations, by name. Raises: InstallationError B-PKG-001, B-PKG-002, B-PKG-004."""
    return tuple(declared for declared, _ in _offered())


@cache
def _offered() -> tuple[tuple[System, Offer], ...]:
    return tuple((_declaration(offer), offer) for offer in offers("systems").values())


def _declaration(offer: Offer) -> System:
    name = f"{offer.package}.declaration"
    try:
        declared = getattr(import_module(name), "DECLARATION", None)
    except ImportError as error:
        raise _unusable(offer, f"cannot be imported: {error}") from error
    if not isinstance(declared, System) or declared.name != offer.name:
        raise _unusable(offer, f"holds no DECLARATION of the system {offer.name!r}")
    return declared


def _unusable(offer: Offer, why: str) -> InstallationError:
    message = f"{offer.package}.declaration of {offer.distribution} {why}"
    return InstallationError("B-PKG-004", message, next_step=f"install {offer.distribution} again, or uninstall it")


@cache
def analyses() -> Mapping[str, tuple[AnalysisDeclaration, System, Offer]]:
    """Return all installed analyses by name, each with its system.

    Raises: InstallationError B-PKG-001 if two have one name.
    """
    by_name: dict[str, tuple[AnalysisDeclaration, System, Offer]] = {}
    for system, offer in _offered():
        for analysis in system.analyses:
            if analysis.name in by_name:
                raise twice(f"the analysis {analysis.name!r}", by_name[analysis.name][2], offer)
            by_name[analysis.name] = analysis, system, offer
    return by_name


def analysis_declaration(name: str) -> AnalysisDeclaration | None:
    """Return the declaration of an analysis, of a system or of the lab folder; None for a name that neither has.

    Raises: InputError B-LAB-001; InstallationError B-LAB-004 to B-LAB-006 for one of the lab folder that cannot be
            used.
    """
    if lab_code.own_code("analyses", name) is not None:
        return _declaration_of_lab(name)
    return analyses()[name][0] if name in analyses() else None


def is_size(analysis: str, quantity: str) -> bool:
    """Return True for a quantity that its analysis declares as a size, which cannot be negative.

    Raises: as ``analysis_declaration``.
    """
    declared = analysis_declaration(analysis)
    return declared is not None and quantity in declared.sizes


def _declaration_of_lab(name: str) -> AnalysisDeclaration:
    if name in analyses():
        raise lab_code.refused_twice("analyses", name, analyses()[name][2].release)
    module = lab_code.load("analyses", name)
    assert module is not None
    declared = getattr(module, "DECLARATION", None)
    if not isinstance(declared, AnalysisDeclaration) or (declared.name, declared.module) != (name, module.__name__):
        why = f"holds no DECLARATION with the name {name!r} and the module __name__"
        raise lab_code.unusable("analyses", name, why)
    if declared.made_of == "logs":
        raise lab_code.unusable("analyses", name, "is made of imported logs, which systems analyse")
    if not declared.methods or getattr(module, "METHODS", None) != declared.methods:
        raise lab_code.unusable("analyses", name, "METHODS are not the methods of its DECLARATION")
    if not callable(getattr(module, "analyse", None)):
        raise lab_code.unusable("analyses", name, "has no function 'analyse'")
    return declared


def system_of_analysis(name: str) -> System | None:
    """Return the system that an analysis belongs to, None for one of the lab folder and for an unknown name."""
    return analyses()[name][1] if name in analyses() else None


def with_sections(form: type[StrictModel], sections: Sequence[type[StrictModel]]) -> tuple[type[StrictModel], ...]:
    """Return the bases of a form of the engine with the sections of all systems.

    Raises: InstallationError B-PKG-001 if two of them have a field of one name.
    """
    owners: dict[str, type[StrictModel]] = {}
    for part in (form, *sections):
        for name in part.model_fields:
            if owners.setdefault(name, part) is not part:
                message = f"{owners[name].__module__} and {part.__module__} both declare the section {name!r}"
                raise InstallationError("B-PKG-001", message, next_step="uninstall the system of one of them")
    return (form, *sections)


def named(text: str) -> Any:
    """Import what a declaration names: ``package.module`` or ``package.module:name``."""
    module, _, name = text.partition(":")
    loaded = import_module(module)
    return getattr(loaded, name) if name else loaded
