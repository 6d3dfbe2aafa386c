"""Finds the driver class a station names, by plain name, so that a YAML cannot run code of its choosing."""

from __future__ import annotations

import importlib
import re
from functools import lru_cache

from bench.model.errors import InputError
from bench.model.installed import package_of_driver

_PLAIN = re.compile(r"[a-z0-9_]{1,40}")


@lru_cache(maxsize=64)
def driver_class(name: str) -> type:
    """Return the driver class of a module ``<name>`` in one of the packages of drivers that are installed.

    Raises: InputError B-PLAN-010 if the name is not plain, B-PLAN-011 if there is no such driver; InstallationError.
    """
    if not _PLAIN.fullmatch(name) or name.startswith("_"):
        raise InputError("B-PLAN-010", f"{name!r} is not a plain driver name (a-z, 0-9 and _)", where=name)
    package = package_of_driver(name)
    if package is None:
        raise InputError("B-PLAN-011", f"there is no driver {name!r} in instruments/", where=name)
    module = importlib.import_module(f"{package.offer.package}.{name}")
    driver = getattr(module, "DRIVER", None)
    if not isinstance(driver, type):
        raise InputError("B-PLAN-011", f"instruments/{name}.py holds no driver", where=name)
    return driver
