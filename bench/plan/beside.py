"""Where the files are that a sequence or a station names."""

from __future__ import annotations

from pathlib import Path

from bench.model.shipped import Kind, find_shipped


def find_beside(source: Path, kind: Kind, name: str) -> Path:
    """A file beside the source's folder wins over a shipped one of the same name. Raises InputError."""
    beside = source.parent.parent / kind / f"{name}.yaml"
    return beside if beside.is_file() else find_shipped(kind, name)
