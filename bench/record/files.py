"""The recorder's only way to the disk; tests put another one in its place to inject short writes and errors."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Protocol

from bench.model.posix import ALONE, sync_folder


class AppendFile(Protocol):
    """A file that is written at its end."""

    def write(self, chunk: bytes) -> int:
        """Append; returns the number of bytes written, which may be less than asked. Raises OSError."""

    def truncate(self, size: int) -> None:
        """Cut the file back to ``size`` bytes and go on from there."""

    def sync(self) -> None:
        """Return when everything written is on the disk. Raises OSError."""

    def close(self) -> None:
        """Close the file."""


class Files(Protocol):
    """Where segments and journals are created."""

    def create(self, path: Path) -> AppendFile:
        """Return a new, empty file; an existing one is an error. Raises OSError."""

    def append(self, path: Path) -> AppendFile:
        """Return an existing or new file, positioned at its end. Raises OSError."""

    def remove(self, path: Path) -> None:
        """Remove a file if it is there."""

    def sync_folder(self, folder: Path) -> None:
        """Make the names in a folder durable."""


class _OsFile:
    def __init__(self, path: Path, flags: int) -> None:
        self._descriptor = os.open(path, flags | os.O_WRONLY | os.O_CREAT | ALONE, 0o644)

    def write(self, chunk: bytes) -> int:
        return os.write(self._descriptor, chunk)

    def truncate(self, size: int) -> None:
        os.ftruncate(self._descriptor, size)
        os.lseek(self._descriptor, size, os.SEEK_SET)

    def sync(self) -> None:
        os.fsync(self._descriptor)

    def close(self) -> None:
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


class OsFiles:
    """The real disk."""

    def create(self, path: Path) -> AppendFile:
        return _OsFile(path, os.O_EXCL)

    def append(self, path: Path) -> AppendFile:
        return _OsFile(path, os.O_APPEND)

    def remove(self, path: Path) -> None:
        path.unlink(missing_ok=True)

    def sync_folder(self, folder: Path) -> None:
        sync_folder(folder)


def write_all(file: AppendFile, block: bytes) -> None:
    """Write every byte of a block. Raises: OSError."""
    done = 0
    while done < len(block):
        count = file.write(block[done:] if done else block)
        if count <= 0:
            raise OSError(28, "nothing could be written")
        done += count
