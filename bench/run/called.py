"""``bench.run(sequence)``: the room ``bench.run`` has the name of a function of ``bench.api``, so it can be called.

Whoever has loaded anything in this room finds the module under that name, whoever has not finds the same module.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import Any


class CalledRoom(ModuleType):
    """A package that runs a campaign when it is called (bench.api.run)."""

    def __call__(self, *words: Any, **options: Any) -> Any:
        """Run a campaign. Arguments, return value and errors: those of ``bench.api.run``."""
        return import_module("bench.api").run(*words, **options)


sys.modules[__package__].__class__ = CalledRoom
