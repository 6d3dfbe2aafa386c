"""Bytes of a segment: a small one is read, a large one is a view of its file, so that memory stays bounded."""

from __future__ import annotations

import mmap
from collections.abc import Iterator
from pathlib import Path

Content = bytes | mmap.mmap
WHOLE_BYTES = 64_000_000  # more than an hour of two links: a segment as it is written is read as a whole
_PIECE_BYTES = 16_000_000


def segment_bytes(path: Path) -> Content:
    """Return the bytes of a segment. Raises: OSError."""
    with path.open("rb") as stream:
        if stream.seek(0, 2) <= WHOLE_BYTES:
            stream.seek(0)
            return stream.read()
        return mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)


def let_go(content: Content) -> None:
    """Give back the memory of what was read of a large segment; it is read again if it is needed again."""
    if isinstance(content, mmap.mmap) and hasattr(content, "madvise"):
        content.madvise(mmap.MADV_DONTNEED)


def pieces(content: Content, stop: int) -> Iterator[memoryview]:
    """Yield the first ``stop`` bytes, a piece at a time."""
    view = memoryview(content)
    for begin in range(0, stop, _PIECE_BYTES):
        yield view[begin : min(begin + _PIECE_BYTES, stop)]
        let_go(content)
