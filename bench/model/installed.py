"""The installed parts of the bench: systems, worlds and packages of drivers, each offered by an entry point.

A name is offered by one distribution only. A package that holds drivers says in its ``__init__`` whose it is
(``__bench__``): the names ``instruments`` and ``bench`` are import names of other distributions too, and whichever is
installed last wins.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.machinery import ModuleSpec
from importlib.metadata import entry_points, packages_distributions
from importlib.util import find_spec, module_from_spec
from pathlib import Path
from typing import Literal

from bench.model import lab_code
from bench.model.errors import InstallationError

OWN = "inertial-bench"
Kind = Literal["systems", "worlds", "instruments"]
KINDS: tuple[Kind, ...] = ("systems", "worlds", "instruments")
_MARK = re.compile(r"^__bench__ = \"([A-Za-z0-9._-]+)\"$", re.MULTILINE)
_SIMULATORS = re.compile(r"^__simulators__ = \"([a-z0-9_.]+)\"$", re.MULTILINE)
_NAMED = {"systems": "system", "worlds": "world", "instruments": "package of drivers"}


@dataclass(frozen=True)
class Offer:
    """One entry point: a name, the package it stands for and the distribution it came with."""

    kind: Kind
    name: str
    package: str
    distribution: str
    version: str

    @property
    def release(self) -> str:
        """Distribution and version."""
        return f"{self.distribution} {self.version}"


@cache
def offers(kind: Kind) -> Mapping[str, Offer]:
    """Return all offers of one kind, sorted by name.

    Raises: InstallationError B-PKG-001 if two distributions offer one name, B-PKG-002 if the bench itself offers none.
    """
    by_name: dict[str, Offer] = {}
    for point in sorted(entry_points(group=f"inertial_bench.{kind}"), key=lambda point: point.name):
        assert point.dist is not None
        offer = Offer(kind, point.name, point.value, point.dist.name, point.dist.version)
        other = by_name.setdefault(point.name, offer)
        if other != offer:
            raise twice(f"the {_NAMED[kind]} {offer.name!r}", other, offer)
    if OWN not in {offer.distribution for offer in by_name.values()}:
        raise InstallationError(
            "B-PKG-002",
            f"the installed {OWN} offers no {kind}: its metadata are older than this source, or it is not installed",
            next_step="'make demo' installs it, and so does 'pip install -e .' in the folder of the source",
        )
    return by_name


def twice(what: str, first: Offer, second: Offer) -> InstallationError:
    """Return the error of a name that two distributions offer, B-PKG-001."""
    message = f"{first.distribution} ({first.package}) and {second.distribution} ({second.package}) both offer {what}"
    return InstallationError("B-PKG-001", message, next_step="uninstall one of them")


@cache
def checked_package(package: str, distribution: str) -> str:
    """Return the text of a package's ``__init__`` if the package is the one that the distribution brought.

    Nothing of the package is executed. Raises: InstallationError B-PKG-003 for a foreign or damaged one.
    """
    spec = _regular(package)
    origin = None if spec is None else spec.origin
    text = "" if origin is None else Path(origin).read_text(encoding="utf-8", errors="replace")
    mark = _MARK.search(text)
    if mark is not None and mark[1] == distribution:
        if spec is not None and find_spec(package) != spec:
            _import(spec)
        return text
    owners = packages_distributions().get(package.partition(".")[0], [])
    others = ", ".join(sorted({owner for owner in owners if owner != distribution}))
    if others and origin is not None:
        message = f"the package {package!r} that is found is of {others}, not of {distribution}"
        cure = f"uninstall {others}, then install {distribution} again"
    else:
        message = f"the package {package!r} of {distribution} is damaged: its __init__.py is not the one installed"
        cure = f"install {distribution} again: pip install --force-reinstall --no-deps {distribution}"
    raise InstallationError("B-PKG-003", message, where=origin or "", next_step=cure)


def _regular(package: str) -> ModuleSpec | None:
    """Return where a package with an ``__init__`` is, None if nowhere.

    A lab folder has folders of such names without one. Python takes the lab's for the package if it was started there
    and ours is an editable installation, whose finder is asked last.
    """
    spec = find_spec(package)
    if spec is None or spec.origin is not None or "." in package:
        return spec
    specs = (finder.find_spec(package, None) for finder in sys.meta_path)
    return next((other for other in specs if other is not None and other.origin is not None), None)


def _import(spec: ModuleSpec) -> None:
    """Import a package from where it is, for everybody who names it from now on."""
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)


@dataclass(frozen=True)
class DriverPackage:
    """A package of drivers and the package of their simulators, "" if it has none."""

    offer: Offer
    simulators: str


@cache
def driver_packages() -> tuple[DriverPackage, ...]:
    """Return all packages of drivers, each recognised by its mark. Raises: InstallationError B-PKG-001 to B-PKG-003."""
    return tuple(_driver_package(offer) for offer in offers("instruments").values())


def _driver_package(offer: Offer) -> DriverPackage:
    simulators = _SIMULATORS.search(checked_package(offer.package, offer.distribution))
    if simulators is not None:
        checked_package(simulators[1], offer.distribution)
    return DriverPackage(offer, "" if simulators is None else simulators[1])


def package_of_driver(name: str) -> DriverPackage | None:
    """Return the package that holds a driver, None if none does.

    Raises: InstallationError B-PKG-001 if two hold one of this name, B-PKG-002, B-PKG-003.
    """
    holding = [package for package in driver_packages() if find_spec(f"{package.offer.package}.{name}") is not None]
    if len(holding) > 1:
        raise twice(f"the driver {name!r}", holding[0].offer, holding[1].offer)
    return holding[0] if holding else None


def simulator_module(driver: str) -> str | None:
    """Return the name of the module that simulates a driver, None if there is none; one of the lab folder is loaded.

    Raises: InstallationError B-PKG-001 to B-PKG-003, B-LAB-004 to B-LAB-006; InputError B-LAB-001.
    """
    package = package_of_driver(driver)
    if lab_code.own_code("sim_instruments", driver) is not None:
        if package is not None:
            raise lab_code.refused_twice("sim_instruments", driver, package.offer.release)
        own = lab_code.load("sim_instruments", driver)
        return None if own is None else own.__name__
    if package is None or not package.simulators:
        return None
    module = f"{package.simulators}.{driver}"
    return module if find_spec(module) is not None else None
