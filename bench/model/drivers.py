"""Finds the driver class a station names, by plain name, so that a YAML cannot run code of its choosing."""

from __future__ import annotations

import re
from functools import lru_cache
from pathlib import Path

from bench.model import lab
from bench.model.errors import InputError
from bench.model.installed import driver_refusals, load, package_of_driver, refuse_unknown

_PLAIN = re.compile(r"[a-z0-9_]{1,40}")


def driver_class(name: str) -> type:
    """Return the driver class of a module ``<name>``: of an installed package of drivers, or of the lab folder.

    Raises: InputError B-PLAN-010 if the name is not plain, B-PLAN-011 if there is no such driver, B-LAB-001;
            InstallationError, of the lab folder B-LAB-004 to B-LAB-006.
    """
    try:
        here = Path.cwd()
    except FileNotFoundError:  # somebody removed it
        here = Path()
    return _class_of(name, here)


@lru_cache(maxsize=64)
def _class_of(name: str, here: Path) -> type:
    """Return the class as it is found from a working directory, which decides on the lab folder."""
    if not _PLAIN.fullmatch(name) or name.startswith("_"):
        raise InputError("B-PLAN-010", f"{name!r} is not a plain driver name (a-z, 0-9 and _)", where=name)
    package = package_of_driver(name)
    if lab.own_code("instruments", name) is not None:
        return _class_of_lab(name)
    if package is None:
        refuse_unknown(f"the driver {name!r}", name, driver_refusals())
        raise InputError("B-PLAN-011", f"there is no driver {name!r} in instruments/", where=name)
    module = load(f"{package.offer.package}.{name}")
    driver = getattr(module, "DRIVER", None)
    if not isinstance(driver, type):
        raise InputError("B-PLAN-011", f"instruments/{name}.py holds no driver", where=name)
    return driver


def _class_of_lab(name: str) -> type:
    package = package_of_driver(name)
    if package is not None:
        raise lab.refused_twice("instruments", name, package.offer.release)
    driver = getattr(lab.load("instruments", name), "DRIVER", None)
    if not isinstance(driver, type):
        raise lab.unusable("instruments", name, "names no class as DRIVER")
    return driver
