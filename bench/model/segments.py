"""The files of a folder that are segments of a session; a command asks it before it loads what reads them."""

from __future__ import annotations

import re
import struct
from pathlib import Path

from bench.model.errors import InputError, SessionDamaged

OPEN_MARKER = "session.open"  # file of a session that is being recorded
_MAGIC = b"\x89MCAP0\r\n"
_FOOTER = struct.Struct("<BQQQI8s")  # opcode, length, begin of the summary, ...; magic
_END_BYTES = 1024  # more than the last chunk, which holds the record of the hash chain, and the data end record
SEGMENT_NAME = re.compile(r"session\.(\d{4})\.mcap")


def segment_files(folder: Path) -> list[Path]:
    """Return the segments of a session in their order, none for a folder that is no session; plain files only."""
    return [path for path in _named(folder) if path.is_file() and not path.is_symlink()]


def session_segments(folder: Path) -> list[Path]:
    """Return the segments of a session in their order.

    Raises: InputError B-REC-010 if there is none, SessionDamaged B-REC-013 for one that is no plain file.
    """
    segments, named = segment_files(folder), _named(folder)
    if len(segments) != len(named):
        other = next(path for path in named if path not in segments)
        raise SessionDamaged(
            "B-REC-013",
            "is a link, folder, pipe or device and no segment; it was not opened",
            where=str(other),
            next_step="put the segment itself into the folder",
        )
    if not segments:
        raise InputError(
            "B-REC-010",
            "holds no segment (session.0001.mcap ...)",
            where=str(folder),
            next_step="name the folder of a recorded session",
        )
    return segments


def _named(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("session.*.mcap") if SEGMENT_NAME.fullmatch(path.name))


def sealed_end(path: Path) -> bytes | None:
    """Return the last bytes of a segment's data, with the record of the hash chain; None if it has no end."""
    try:
        with path.open("rb") as stream:
            size = stream.seek(0, 2)
            stream.seek(max(0, size - _FOOTER.size))
            tail = stream.read()
            begin, magic = _FOOTER.unpack(tail)[2::3] if len(tail) == _FOOTER.size else (0, b"")
            if magic != _MAGIC or not 0 < begin < size:
                return None
            stream.seek(max(0, begin - _END_BYTES))
            return stream.read(min(begin, _END_BYTES))
    except OSError:
        return None
