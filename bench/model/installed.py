"""The installed parts of the bench: systems, worlds and packages of drivers, each offered by an entry point.

Only what somebody names is loaded, so that a foreign part that cannot be used stops those who name it and nobody else.
A name is offered by one distribution only. A package that holds drivers says in its ``__init__`` whose it is
(``__bench__``): the names ``instruments`` and ``bench`` are import names of other distributions too, and whichever is
installed last wins.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.machinery import ModuleSpec
from importlib.metadata import entry_points, packages_distributions
from importlib.util import find_spec, module_from_spec
from pathlib import Path
from traceback import walk_tb
from types import ModuleType
from typing import Any, Literal, NamedTuple

from bench.model import lab
from bench.model.errors import BenchError, InstallationError

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

    @property
    def what(self) -> str:
        """Kind and name, for a message."""
        return f"the {_NAMED[self.kind]} {self.name!r}"


class Refusal(NamedTuple):
    """A foreign offer that cannot be used, and why."""

    offer: Offer
    error: InstallationError


@cache
def offers(kind: Kind) -> tuple[Offer, ...]:
    """Return all offers of one kind, sorted by name and distribution; nothing of them is executed.

    Raises: InstallationError B-PKG-002 if the bench itself offers none.
    """
    found: set[Offer] = set()
    for point in entry_points(group=f"inertial_bench.{kind}"):
        assert point.dist is not None
        found.add(Offer(kind, point.name, point.value, point.dist.name, point.dist.version))
    if OWN not in {offer.distribution for offer in found}:
        raise InstallationError(
            "B-PKG-002",
            f"the installed {OWN} offers no {kind}: its metadata are older than this source, or it is not installed",
            next_step="'make demo' installs it, and so does 'pip install -e .' in the folder of the source",
        )
    return tuple(sorted(found, key=lambda offer: (offer.name, offer.distribution, offer.package)))


def offer_of(kind: Kind, name: str) -> Offer | None:
    """Return the offer of a name, None without one. Raises: InstallationError B-PKG-001 if there are two, B-PKG-002."""
    named = [offer for offer in offers(kind) if offer.name == name]
    if len(named) > 1:
        raise twice(named[0].what, named[0], named[1])
    return named[0] if named else None


def twice(what: str, first: Offer, second: Offer) -> InstallationError:
    """Return the error of a name that two distributions offer, B-PKG-001."""
    message = f"{first.distribution} ({first.package}) and {second.distribution} ({second.package}) both offer {what}"
    return InstallationError("B-PKG-001", message, next_step="uninstall one of them")


def refuse_unknown(what: str, name: str, refusals: Sequence[Refusal]) -> None:
    """Refuse a name that nothing usable has, if a part that cannot be used may have it; that of this name comes first.

    Args: what: the name with its noun, for the message. Raises: the error of the part, with what it was asked for.
    """
    for _, error in sorted(refusals, key=lambda refusal: refusal.offer.name != name)[:1]:
        message = f"{what} is of nothing that can be used, and {error.message}"
        raise InstallationError(error.code, message, where=error.where, next_step=error.next_step) from error


def load(name: str) -> ModuleType:
    """Import a module by its full name. Raises: InstallationError B-PKG-004 for one of a foreign part that cannot be.

    Of the bench itself it is raised for a module that is missing; what else one of them raises is passed on.
    """
    try:
        _put_first(name.partition(".")[0])
        return import_module(name)
    except BenchError:
        raise
    except (Exception, SystemExit) as error:  # a stranger's module may do anything, also end the process
        missing = isinstance(error, ModuleNotFoundError) and error.name == name
        if (owner := whose(name, own=missing)) is None:
            raise
        raise owner.error(owner.unusable, f"cannot be loaded: {lab.in_words(error)}", error) from error


def named(text: str) -> Any:
    """Import what a part names: ``package.module`` or ``package.module:name``. Raises: as ``load``, and B-PKG-004."""
    module, _, name = text.partition(":")
    loaded = load(module)
    if name and not hasattr(loaded, name):
        raise unusable(module, f"holds no {name}")
    return getattr(loaded, name) if name else loaded


def try_foreign(by: str, texts: Iterable[str]) -> None:
    """Import what a module names, unless it is of the bench itself, whose tests do. Raises: as ``named``."""
    if (owner := whose(by)) is None:
        return
    for text in texts:
        module = text.partition(":")[0]
        if module not in sys.modules and spec_of(module) is None:
            lines = Path(owner.place).read_text("utf-8").splitlines()
            line = next((f":{number}" for number, line in enumerate(lines, 1) if module in line), "")
            error = owner.error(owner.unusable, f"names {module}, which is not there")
            error.where += line
            raise error
        named(text)


def world_parts(offer: Offer) -> tuple[str, ...]:
    """Return what is imported of a world: its class, and its options that are switches, numbers and texts."""
    options = (f"{offer.package}.options:{group}" for group in ("OPTIONS", "NUMBERS", "TEXTS"))
    return f"{offer.package}.world:WORLD", *options


def unusable(module: str, why: str) -> InstallationError:
    """Return the error of a module that is not what it should be, B-PKG-004 or B-LAB-006."""
    owner = whose(module, own=True)
    assert owner is not None
    return owner.error(owner.unusable, why)


def unforeseen(error: BaseException) -> BenchError:
    """Return an error of the bench as it is; any other names the code that it came from.

    B-PKG-006 or B-LAB-008 if it came through a foreign part or code of a lab, else B-INT-001 with module and line.
    """
    if isinstance(error, BenchError):
        return error
    if (fault := foreign_fault(error)) is not None:
        return fault
    module, line = next(reversed(_passed(error)), ("?", 0))
    advice = "report this with the command you gave"
    return BenchError("B-INT-001", lab.in_words(error), where=f"{module}:{line}", next_step=advice)


def foreign_fault(error: BaseException) -> InstallationError | None:
    """Return what an exception is that came through foreign code, B-PKG-006 or B-LAB-008; None for any other."""
    owners = (whose(module) for module, _ in reversed(_passed(error)))
    owner = next(filter(None, owners), None)
    return None if owner is None else owner.error(owner.failed, f"failed: {lab.in_words(error)}", error)


def _passed(error: BaseException) -> list[tuple[str, int]]:
    """Return module and line of each call that an exception came through."""
    return [(frame.f_globals.get("__name__", "?"), line) for frame, line in walk_tb(error.__traceback__)]


def whose(module: str, own: bool = False) -> lab.Whose | None:
    """Return whose code a module is, None for one that nobody offers or, unless ``own``, that is of the bench."""
    if module.startswith(lab.MODULES):
        return lab.whose(module, Path(str(sys.modules[module].__file__)))
    offer = _owner(module)
    if offer is None or (offer.distribution == OWN and not own):
        return None
    specs = (spec_of(module), spec_of(module.partition(".")[0]))
    files = [Path(spec.origin) for spec in specs if spec is not None and spec.origin is not None] or [Path()]
    cure = f"mend {offer.distribution}, install it again or uninstall it; what does not name it goes on without"
    name = f"{module} of {offer.release}"
    return lab.Whose(name, str(files[0]), files[-1].parent, "B-PKG-004", "B-PKG-006", cure)


def _owner(name: str) -> Offer | None:
    """Return the offer whose package a module is of, or at least its distribution; None for neither."""
    top = name.partition(".")[0]
    packages = [(offer.package, offer) for kind in KINDS for offer in offers(kind)]
    packages += [(package.simulators, package.offer) for package in driver_packages()]
    related = [(package, offer) for package, offer in packages if package.partition(".")[0] == top]
    return max(related, key=lambda pair: name.startswith(pair[0]), default=(None, None))[1]


@cache
def checked_package(package: str, distribution: str) -> str:
    """Return the text of a package's ``__init__`` if the package is the one that the distribution brought.

    Nothing of the package is executed. Raises: InstallationError B-PKG-003 for a foreign or damaged one.
    """
    spec = spec_of(package)
    origin = None if spec is None else spec.origin
    text = "" if origin is None else Path(origin).read_text(encoding="utf-8", errors="replace")
    mark = _MARK.search(text)
    if mark is not None and mark[1] == distribution:
        if distribution == OWN:
            _put_first(package)
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


def spec_of(module: str) -> ModuleSpec | None:
    """Return where a module is, None if nowhere; nothing is executed, not even the package that it is in.

    A lab folder has folders of such names without an ``__init__``. Python takes the lab's for the package if it was
    started there and ours is an editable installation, whose finder is asked last: what has a file comes first.
    """
    parts = module.split(".")
    places: Sequence[str] | None = None
    spec: ModuleSpec | None = getattr(sys.modules.get(module), "__spec__", None)
    if spec is not None and len(parts) > 1:
        return spec
    for end in range(1, len(parts) + 1):
        name = ".".join(parts[:end])
        specs = [spec for finder in sys.meta_path if (spec := finder.find_spec(name, places)) is not None]
        spec = next((spec for spec in specs if spec.origin is not None), specs[0] if specs else None)
        if spec is None:
            return None
        places = spec.submodule_search_locations
    return spec


def _put_first(package: str) -> None:
    """Import a top-level package that a folder of the same name hides, for everybody who names it from now on."""
    if getattr(sys.modules.get(package), "__file__", None) is not None:
        return
    spec = spec_of(package)
    if spec is not None and spec.loader is not None and find_spec(package) != spec:
        module = module_from_spec(spec)
        sys.modules[spec.name] = module
        spec.loader.exec_module(module)


@dataclass(frozen=True)
class DriverPackage:
    """A package of drivers and the package of their simulators, "" if it has none."""

    offer: Offer
    simulators: str

    @property
    def folder(self) -> Path:
        """Folder of its modules and of what stands beside them."""
        spec = spec_of(self.offer.package)
        assert spec is not None
        assert spec.origin is not None
        return Path(spec.origin).parent

    def drivers(self) -> list[str]:
        """Return the names of its drivers, by the text of its modules: nothing is executed."""
        return sorted(path.stem for path in self.folder.glob("*.py") if "\nDRIVER = " in path.read_text("utf-8"))

    def parts(self) -> Iterator[str]:
        """Yield what is imported of its drivers and simulators."""
        for name in self.drivers():
            yield f"{self.offer.package}.{name}:DRIVER"
            if self.simulators and spec_of(module := f"{self.simulators}.{name}") is not None:
                yield f"{module}:SIMULATOR"


@cache
def _examined_packages() -> tuple[list[DriverPackage], list[Refusal]]:
    packages, refusals = [], []
    for offer in offers("instruments"):
        try:
            simulators = _SIMULATORS.search(checked_package(offer.package, offer.distribution))
            if simulators is not None:
                checked_package(simulators[1], offer.distribution)
        except InstallationError as error:
            if offer.distribution == OWN:
                raise
            refusals.append(Refusal(offer, error))
        else:
            packages.append(DriverPackage(offer, "" if simulators is None else simulators[1]))
    return packages, refusals


def driver_packages() -> Sequence[DriverPackage]:
    """Return the packages of drivers that can be used, each recognised by its mark.

    Raises: InstallationError B-PKG-002; B-PKG-003 for the one of the bench itself.
    """
    return _examined_packages()[0]


def driver_refusals() -> Sequence[Refusal]:
    """Return the foreign packages of drivers that lack their mark (B-PKG-003). Raises: as ``driver_packages``."""
    return _examined_packages()[1]


def package_of_driver(name: str) -> DriverPackage | None:
    """Return the package that holds a driver, None if none does.

    Raises: InstallationError B-PKG-001 if two hold one of this name, B-PKG-002, B-PKG-003.
    """
    holding = [package for package in driver_packages() if spec_of(f"{package.offer.package}.{name}") is not None]
    if len(holding) > 1:
        raise twice(f"the driver {name!r}", holding[0].offer, holding[1].offer)
    return holding[0] if holding else None


def simulator_module(driver: str) -> str | None:
    """Return the name of the module that simulates a driver, None if there is none; one of the lab folder is loaded.

    Raises: InstallationError B-PKG-001 to B-PKG-003, B-LAB-004 to B-LAB-006; InputError B-LAB-001.
    """
    package = package_of_driver(driver)
    if lab.own_code("sim_instruments", driver) is not None:
        if package is not None:
            raise lab.refused_twice("sim_instruments", driver, package.offer.release)
        own = lab.load("sim_instruments", driver)
        return None if own is None else own.__name__
    if package is None or not package.simulators:
        return None
    module = f"{package.simulators}.{driver}"
    return module if spec_of(module) is not None else None
