"""Folders of sessions on a file system or a store of objects: found, and brought to this machine.

The one place that knows how storage is reached (fsspec): a local path, or a URL such as ``s3://bucket/folder``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import fsspec

from bench.model.errors import BenchError, InputError
from bench.model.segments import OPEN_MARKER, SEGMENT_NAME
from bench.report import CERTIFICATE_FILE, SPECIMEN_FILE
from bench.session.shelf import ACCEPTANCES
from bench.session.verification import RESULTS

_KEPT = (RESULTS, ACCEPTANCES, CERTIFICATE_FILE, SPECIMEN_FILE)  # what is read beside the segments
# What a store says of the state of an object, the surest first; every one of them has one of these.
_STATES = ("ETag", "etag", "md5Hash", "mtime", "LastModified", "last_modified", "created")


class StorageError(OSError):
    """Storage cannot be read now, in the words of the package that reaches it."""


@dataclass(frozen=True)
class Place:
    """The folder of a session; ``fingerprint``: of the names, sizes and states of the files that are read."""

    location: str
    bytes: int
    fingerprint: str

    @property
    def name(self) -> str:
        """The folder's own name, which a person reads while it is looked at."""
        return self.location.rstrip("/").rpartition("/")[2]


def sessions_at(url: str) -> list[Place]:
    """Return every session in a folder and below it, by location; one that is being recorded is left out.

    Args:   url: a path, or a URL of a file system that fsspec knows.
    Raises: InputError B-ARC-002 if it cannot be listed, or holds no session.
    """
    try:
        storage, root = _opened(url)
        with _at_storage():
            listed: Mapping[str, Mapping[str, Any]] = storage.find(root, detail=True)
    except OSError as error:
        raise _unreadable(url, error) from error
    folders: dict[str, dict[str, Mapping[str, Any]]] = {}
    for path, state in listed.items():
        folder, _, name = path.rpartition("/")
        folders.setdefault(folder, {})[name] = state
    places = [
        _place(_location(storage, folder), files)
        for folder, files in sorted(folders.items())
        if OPEN_MARKER not in files and any(map(SEGMENT_NAME.fullmatch, files))
    ]
    if not places:
        raise InputError(
            "B-ARC-002",
            "holds no session that has ended",
            where=url,
            next_step="name a folder of sessions, or one of them",
        )
    return places


@contextmanager
def brought_here(location: str) -> Iterator[tuple[Path, Place]]:
    """Give a session as a folder of this machine: its own if it lies here, else a copy that is gone afterwards.

    Raises: FileNotFoundError if there is no session any more; OSError if it cannot be read or copied; InputError
            B-ARC-002.
    """
    storage, root = _opened(location)
    with _at_storage():
        entries: list[Mapping[str, Any]] = storage.ls(root, detail=True)
    files = {str(entry["name"]).rpartition("/")[2]: entry for entry in entries if entry["type"] == "file"}
    place = _place(location, files)
    if not any(map(SEGMENT_NAME.fullmatch, files)):
        raise FileNotFoundError(location)
    if _is_local(storage):
        yield Path(root), place
        return
    with TemporaryDirectory(prefix="bench-archive-") as copy:
        with _at_storage():
            for name in sorted(filter(_is_read, files)):
                storage.get_file(str(files[name]["name"]), str(Path(copy, name)))
        yield Path(copy), place


@contextmanager
def _at_storage() -> Iterator[None]:
    """Give whatever a package of fsspec raises as the OSError that storage of this machine gives.

    Packages have errors of their own (botocore's are no OSError), and which ones cannot be listed.
    """
    try:
        yield
    except (OSError, BenchError):
        raise
    except Exception as error:
        raise StorageError(f"{type(error).__name__}: {' '.join(str(error).split())}") from error


def _opened(url: str) -> tuple[Any, str]:
    """Return the file system of a URL, and the path in it.

    Raises: InputError B-ARC-002 if no package here knows it; OSError if it cannot be reached now.
    """
    with _at_storage():
        try:
            storage, root = fsspec.core.url_to_fs(url)
        except (ValueError, ImportError) as error:
            raise _unreadable(url, error) from error
    return storage, str(root)


def _unreadable(url: str, error: Exception) -> InputError:
    reason = getattr(error, "strerror", None) or " ".join(str(error).split())
    return InputError(
        "B-ARC-002",
        f"cannot be listed: {reason}",
        where=url,
        next_step="name a folder that is there; a store of objects needs its own package of fsspec, such as s3fs",
    )


def _is_local(storage: Any) -> bool:
    protocol = storage.protocol
    return "file" in ((protocol,) if isinstance(protocol, str) else protocol)


def _location(storage: Any, folder: str) -> str:
    """Return a path of this machine as it is, any other with its protocol."""
    return folder if _is_local(storage) else str(storage.unstrip_protocol(folder))


def _is_read(name: str) -> bool:
    return name in _KEPT or SEGMENT_NAME.fullmatch(name) is not None


def _place(location: str, files: Mapping[str, Mapping[str, Any]]) -> Place:
    read = {name: files[name] for name in sorted(filter(_is_read, files))}
    states = [(name, state["size"], _state(state)) for name, state in read.items()]
    return Place(
        location, sum(int(state["size"]) for state in read.values()), hashlib.sha256(repr(states).encode()).hexdigest()
    )


def _state(state: Mapping[str, Any]) -> str:
    return next((str(state[name]) for name in _STATES if state.get(name) is not None), "")
