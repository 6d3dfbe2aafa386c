"""What a session says about the software that made it."""

from __future__ import annotations

import platform
import subprocess
from importlib import metadata
from pathlib import Path
from typing import Any

PACKAGES = (
    "inertial-bench",
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


def software() -> dict[str, Any]:
    """Versions of everything a number depends on, and the revision of the source if it is a checkout."""
    versions = {}
    for package in PACKAGES:
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            versions[package] = "not installed as a package"
    return {"packages": versions, "python": platform.python_version(), "git": _revision()}


def _revision() -> str:
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
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
