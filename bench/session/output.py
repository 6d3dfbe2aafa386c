"""Files a command writes."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from bench.model.errors import InputError

UNITS = "units"  # folder of a session with the results of each unit and test item


def write_file(path: Path, content: str | bytes) -> None:
    """Write a file, text as UTF-8, its folder too; whoever looks sees the old file or the whole new one, never a part.

    A device or a pipe is written to as it is. Raises: InputError B-CLI-007.
    """
    raw = content.encode() if isinstance(content, str) else content
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        target = path.resolve()
        if target.exists() and not target.is_file():
            target.write_bytes(raw)
            return
        part = target.with_name(f"{target.name}.part")
        try:
            with part.open("wb") as stream:
                stream.write(raw)
                stream.flush()
                os.fsync(stream.fileno())
            part.replace(target)
        finally:
            part.unlink(missing_ok=True)


def write_attachments(folder: Path, attachments: Mapping[str, str]) -> Path:
    """Write the files that go with the results of a session below its folder ``units``; returns that folder.

    Raises: InputError B-CLI-007.
    """
    target = folder / UNITS
    for name, text in attachments.items():
        write_file(target / name, text)
    return target


def make_folder(path: Path) -> None:
    """A folder for sessions, before anything is switched on. Raises: InputError B-CLI-007."""
    with writing(path):
        path.mkdir(parents=True, exist_ok=True)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Whatever keeps a file from being written is one clear error. Raises: InputError B-CLI-007."""
    try:
        yield
    except OSError as error:
        raise InputError(
            "B-CLI-007",
            f"cannot be written: {error.strerror}",
            where=str(path),
            next_step="check the folder, its permissions and the space on the disk",
        ) from error
