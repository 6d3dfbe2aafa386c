"""Commands on a machine where only ``pip install inertial-bench`` was done: a program of its own.

``minimal_install.py JSON`` runs a list of commands in one process and prints ``[[status, stdout, stderr], ...]``.
Every package that is installed here and not needed by the dependencies of pyproject.toml cannot be imported.
"""

import json
import re
import sys
import tomllib
from importlib import metadata
from pathlib import Path

from off_posix import statuses
from packaging.requirements import Requirement

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def normal(name: str) -> str:
    """Return the one spelling of a distribution's name."""
    return re.sub(r"[-_.]+", "-", name).lower()


def closure(texts: list[str]) -> set[str]:
    """Return the distributions that some requirements bring, with all they need on this machine."""
    found: set[str] = set()
    waiting = [(Requirement(text), "") for text in texts]
    while waiting:
        requirement, extra = waiting.pop()
        name = normal(requirement.name)
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": extra}):
            continue
        extras = requirement.extras or {""}
        if name in found and extras == {""}:
            continue
        found.add(name)
        needed = metadata.requires(name) or []
        waiting += [(Requirement(text), wanted) for text in needed for wanted in extras]
    return found


def hide_all_but(kept: set[str]) -> None:
    """Make every module unfindable that no kept distribution brings."""
    for module, owners in metadata.packages_distributions().items():
        if not {normal(owner) for owner in owners} & kept:
            sys.modules[module] = None  # type: ignore[assignment]


if __name__ == "__main__":
    hide_all_but(closure(PROJECT["dependencies"]) | {normal(PROJECT["name"])})
    print(json.dumps(statuses(json.loads(sys.argv[1]))))
