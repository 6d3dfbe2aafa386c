"""Controller of an unattended calibration bench for inertial-navigation electronics.

The names of ``bench.api``, ``load`` and others, are here too; it is loaded with the first of them.
"""

from __future__ import annotations

from typing import Any

__version__ = "0.1.0"
__bench__ = "inertial-bench"
__api__ = ("BenchError", "Checked", "Fit", "Session", "check", "fit", "load", "run", "to_xarray", "watch")


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name == "run":  # the room of that name, which can be called
        return import_module("bench.run")
    if name in __api__:
        return getattr(import_module("bench.api"), name)
    raise AttributeError(f"module 'bench' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__api__})
