"""Files a command writes."""

from __future__ import annotations

from pathlib import Path

from bench.model.errors import InputError


def write_file(path: Path, text: str) -> None:
    """Write a text file, its folder too. Raises: InputError B-CLI-007."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    except OSError as error:
        raise InputError(
            "B-CLI-007",
            f"cannot be written: {error.strerror}",
            where=str(path),
            next_step="check the folder, its permissions and the space on the disk",
        ) from error
