"""Which folders the page may look into: the sessions directly below one folder, nothing else.

A session may come from elsewhere: no link in it is followed, and a pipe, at which one would wait for ever, is no file.
"""

from __future__ import annotations

import os
import re
import stat
from pathlib import Path

from bench.model.segments import SEGMENT_NAME

RUN_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,199}")  # no leading dot, so neither "." nor ".."


def run_folder(out: Path, name: str) -> Path | None:
    """Folder of a session in ``out``; None if the name is none, is no session or leads elsewhere."""
    if RUN_NAME.fullmatch(name) is None:
        return None
    folder = out / name
    try:
        if folder.is_symlink() or not folder.is_dir():
            return None
        with os.scandir(folder) as entries:
            plain = [one.is_file(follow_symlinks=False) for one in entries if SEGMENT_NAME.fullmatch(one.name)]
    except OSError:
        return None
    return folder if plain and all(plain) else None


def content_of(path: Path) -> bytes | None:
    """Return what a plain file of a session holds; None if it is not there, cannot be read, or is no plain file."""
    try:
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb") as file:
            return file.read() if stat.S_ISREG(os.fstat(file.fileno()).st_mode) else None
    except OSError:
        return None
