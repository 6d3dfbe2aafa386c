"""Folders of this user, and names of folders."""

from __future__ import annotations

import os
import re
from pathlib import Path


def cache_folder() -> Path:
    """Return where the bench keeps what it can compute again; nobody made it yet.

    Source: XDG Base Directory Specification: XDG_CACHE_HOME if it is absolute, else ~/.cache.
    """
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if Path(base).is_absolute() else Path.home() / ".cache") / "inertial-bench"


def folder_name(serial: str) -> str:
    """Return a serial number as the name of a folder: letters, digits, dot, dash and underscore, no dot at its ends."""
    return re.sub(r"[^A-Za-z0-9._-]", "_", serial).strip(".") or "_"
