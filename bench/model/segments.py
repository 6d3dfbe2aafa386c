"""The files of a folder that are segments of a session; a command asks it before it loads what reads them."""

from __future__ import annotations

import re
from pathlib import Path

from bench.model.errors import InputError

SEGMENT_NAME = re.compile(r"session\.(\d{4})\.mcap")


def segment_files(folder: Path) -> list[Path]:
    """Return the segments of a session in their order, none for a folder that is no session."""
    return sorted(path for path in folder.glob("session.*.mcap") if SEGMENT_NAME.fullmatch(path.name))


def session_segments(folder: Path) -> list[Path]:
    """Return the segments of a session in their order. Raises: InputError B-REC-010 if there is none."""
    segments = segment_files(folder)
    if not segments:
        raise InputError(
            "B-REC-010",
            "holds no segment (session.0001.mcap ...)",
            where=str(folder),
            next_step="name the folder of a recorded session",
        )
    return segments
