"""The software that made a session, as the session names it."""

from __future__ import annotations

import platform
import subprocess
import tomllib
from collections.abc import Collection, Iterable
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import bench
from bench.model.installed import package_of_driver
from bench.model.lab import code_used, lab_here
from bench.model.systems import installed_analysis
from bench.plan import Station

DISTRIBUTION = "inertial-bench"
PACKAGES = (
    DISTRIBUTION,
    "numpy",
    "scipy",
    "pydantic",
    "PyYAML",
    "PyVISA",
    "PyVISA-sim",
    "pyserial",
    "crcmod-plus",
    "lz4",
)


def software(analysis: str = "", drivers: Iterable[str] = ()) -> dict[str, Any]:
    """Return versions of everything a number depends on, and the revision of the source if it is a checkout.

    ``distributions``: by package, what brought the system of the analysis and the drivers.
    """
    document = {
        "packages": {package: _version(package) for package in PACKAGES},
        "python": platform.python_version(),
        "git": _revision(),
    }
    return {**document, "distributions": _distributions(analysis, drivers)}


def lab_of(station: Station, analysis: str = "none", roles: Collection[str] = ()) -> dict[str, Any]:
    """Return entry "lab" of a manifest: whose code is used, and SHA-256 of each file; nothing if it is all installed.

    ``roles``: of the instruments that are used (default: all).
    Raises: InputError B-LAB-001; InstallationError B-LAB-004.
    """
    lab, files = lab_here(), code_of(station, analysis, roles)
    return {} if lab is None or not files else {"lab": {"name": lab.name, "files": files}}


def code_of(station: Station, analysis: str = "none", roles: Collection[str] = ()) -> dict[str, str]:
    """Return SHA-256 of the lab's files that are used, by place. Arguments and errors: those of ``lab_of``."""
    drivers = {entry.driver for role, entry in station.instruments.items() if not roles or role in roles}
    return code_used(drivers, simulated=station.simulated, analysis=analysis)


@cache
def _version(package: str) -> str:
    """Return the version that is installed, read once: what is imported stays as it was."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed as a package"


def _distributions(analysis: str, drivers: Iterable[str]) -> dict[str, str]:
    entry = installed_analysis(analysis)
    offers = [] if entry is None else [entry.offer]
    packages = [package_of_driver(driver) for driver in sorted(drivers)]
    offers += [package.offer for package in packages if package is not None]
    return {offer.package: offer.release for offer in offers}


def _revision() -> str:
    root = Path(bench.__file__).resolve().parents[1]
    if not ((root / ".git").exists() and _is_this_project(root / "pyproject.toml")):
        return "not a checkout"
    try:
        revision = _git(root, "rev-parse", "HEAD")
        modified = _git(root, "status", "--porcelain", "--untracked-files=no")
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return f"{revision} with local modifications" if modified else revision


def _git(root: Path, *words: str) -> str:
    command = ["git", "-C", str(root), *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=5, check=True).stdout.strip()


def _is_this_project(pyproject: Path) -> bool:
    """Return False for a package that was installed into somebody else's repository: its revision is not ours."""
    try:
        project = tomllib.loads(pyproject.read_text(encoding="utf-8")).get("project", {})
    except (OSError, ValueError):
        return False
    return bool(project.get("name") == DISTRIBUTION)
