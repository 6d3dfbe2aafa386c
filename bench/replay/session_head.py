"""Frame definitions of a session, read once for whoever asks often."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

from bench.frame import FrameDefinition
from bench.record import SessionReader
from bench.replay.session_signals import frames_of

KEPT = 16


def session_frames(folder: Path) -> Mapping[str, FrameDefinition]:
    """Frame definitions by link, as ``frames_of`` gives them; a session's texts never change.

    Raises: InputError B-REC-010 (no session); SessionDamaged B-REC-012, B-REC-014.
    """
    return _frames(folder, _first_file(folder))


def _first_file(folder: Path) -> int:
    """Return number of the first segment's file: another one at the same place is another session."""
    return SessionReader(folder).segments[0].stat().st_ino


@lru_cache(maxsize=KEPT)
def _frames(folder: Path, first_segment: int) -> Mapping[str, FrameDefinition]:
    del first_segment
    reader = SessionReader(folder)
    return frames_of(reader.manifest, reader.texts)
