"""Which folders the page may look into: the sessions directly below one folder, nothing else."""

from __future__ import annotations

import re
from pathlib import Path

from bench.record.layout import SEGMENT_NAME

RUN_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,199}")  # no leading dot, so neither "." nor ".."


def run_folder(out: Path, name: str) -> Path | None:
    """Folder of a session in ``out``; None if the name is none, is no session or leads elsewhere."""
    if RUN_NAME.fullmatch(name) is None:
        return None
    folder = out / name
    try:
        if folder.is_symlink() or not folder.is_dir():
            return None
        return folder if any(SEGMENT_NAME.fullmatch(path.name) for path in folder.iterdir()) else None
    except OSError:
        return None
