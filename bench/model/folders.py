"""Folders of this user."""

from __future__ import annotations

import os
from pathlib import Path


def cache_folder() -> Path:
    """Return where the bench keeps what it can compute again; nobody made it yet.

    Source: XDG Base Directory Specification: XDG_CACHE_HOME if it is absolute, else ~/.cache.
    """
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if Path(base).is_absolute() else Path.home() / ".cache") / "inertial-bench"
