"""Files a command writes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bench.model.errors import InputError


def write_file(path: Path, text: str) -> None:
    """Write a text file, its folder too. Raises: InputError B-CLI-007."""
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


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
