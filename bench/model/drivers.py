"""Finds the driver class a station names, by plain name, so that a YAML cannot run code of its choosing."""

from __future__ import annotations

import importlib
import re
from functools import lru_cache

from bench.model.errors import InputError

_PLAIN = re.compile(r"[a-z0-9_]{1,40}")


@lru_cache(maxsize=64)
def driver_class(name: str) -> type:
    """The driver class of ``instruments/<name>.py``.

    Raises: InputError B-PLAN-010 if the name is not plain, B-PLAN-011 if there is no such driver.
    """
    if not _PLAIN.fullmatch(name) or name.startswith("_"):
        raise InputError("B-PLAN-010", f"{name!r} is not a plain driver name (a-z, 0-9 and _)", where=name)
    module_name = f"instruments.{name}"
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name not in (module_name, "instruments"):
            raise
        raise InputError("B-PLAN-011", f"there is no driver {name!r} in instruments/", where=name) from error
    found = getattr(module, "DRIVER", None)
    if not isinstance(found, type):
        raise InputError("B-PLAN-011", f"instruments/{name}.py holds no driver", where=name)
    return found
