"""Folders of sessions on a file system or a store of objects: found, and brought to this machine.

The one place that knows how storage is reached (fsspec): a local path, or a URL such as ``s3://bucket/folder``.
"""

from __future__ import annotations

import hashlib
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import fsspec

from bench.archive.census import Finding, Kind, unreadable
from bench.model.errors import BenchError, InputError
from bench.model.segments import OPEN_MARKER, SEGMENT_NAME
from bench.record import FOLDER as TREND
from bench.report import CERTIFICATE_FILE, SPECIMEN_FILE
from bench.session.released import released_results
from bench.session.shelf import ACCEPTANCES
from bench.session.verification import REPORT, RESULTS

_KEPT = (RESULTS, ACCEPTANCES, CERTIFICATE_FILE, SPECIMEN_FILE, OPEN_MARKER)  # what is read beside the segments
_OF_SESSION = {*_KEPT, REPORT, TREND}
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


def list_places(url: str) -> list[Place | Finding]:
    """Return every session in a folder and below it, and what else stands there, by location; links are not followed.

    Args:   url: a path, or a URL of a file system that fsspec knows.
    Raises: InputError B-ARC-002 if it is no folder, or nothing in it has a recording.
    """
    try:
        storage, root = _opened(url)
        places = list(_walked(storage, root))
    except (FileNotFoundError, NotADirectoryError) as error:
        raise _unreadable(url, error) from error
    except OSError as error:
        return [unreadable(url, _reason(error))]
    if all(isinstance(place, Finding) and place.kind is Kind.NO_RECORDING for place in places):
        raise InputError(
            "B-ARC-002",
            "holds no session",
            where=url,
            next_step="name a folder of sessions, or one of them",
        )
    return sorted(places, key=lambda place: place.location)


def _walked(storage: Any, root: str) -> Iterator[Place | Finding]:
    """Yield what stands in a folder and below it. Raises: OSError if the folder itself cannot be listed."""
    waiting = [(root, False)]
    while waiting:
        path, within = waiting.pop()
        try:
            folder = _Folder.of(storage, path)
        except OSError as error:
            if path == root:
                raise
            yield unreadable(_text(_location(storage, path)), _reason(error))
            continue
        yield from folder.links()
        found = folder.classified(within)
        if found is not None:
            yield found
        waiting += [(name, within or folder.is_session) for name in folder.paths("directory")]


@dataclass(frozen=True)
class _Folder:
    """The entries of a folder by name, and the sort of each: directory, file, link (to a folder, or nowhere), other."""

    location: str
    entries: Mapping[str, Mapping[str, Any]]
    sorts: Mapping[str, str]

    @classmethod
    def of(cls, storage: Any, path: str) -> _Folder:
        """List a folder. Raises: OSError."""
        with _at_storage():
            listed: list[Mapping[str, Any]] = storage.ls(path, detail=True)
        # a file is listed as itself, and a store of objects may have one that stands for the folder
        entries = {
            name.rpartition("/")[2]: entry
            for entry in listed
            if (name := str(entry["name"]).rstrip("/")) != path.rstrip("/")
        }
        return cls(_location(storage, path), entries, {name: _sort_of(entry) for name, entry in entries.items()})

    def paths(self, sort: str) -> list[str]:
        return [str(self.entries[name]["name"]) for name, found in self.sorts.items() if found == sort]

    @property
    def has_segments(self) -> bool:
        return any(map(SEGMENT_NAME.fullmatch, self.sorts))

    @property
    def is_session(self) -> bool:
        return self.has_segments or not _OF_SESSION.isdisjoint(self.sorts)

    @property
    def fault(self) -> str:
        """What keeps its files from being opened, "" if nothing does."""
        others = [name for name in filter(_is_read, self.sorts) if self.sorts[name] != "file"]
        return f"{others[0]} is a folder, pipe, device or dead link; it was not opened" if others else ""

    def links(self) -> Iterator[Finding]:
        """Yield the links to folders, and those that lead nowhere."""
        for name, sort in self.sorts.items():
            if sort == "link" and not _is_read(name):
                there = f"a link to {_text(str(self.entries[name].get('destination', 'another folder')))}, not followed"
                yield Finding(_text(f"{self.location}/{name}"), Kind.LINK, "", there, "add the folder that it leads to")

    def classified(self, within: bool) -> Place | Finding | None:
        """Return what the folder is, None for one that only holds others or is part of a session (``within``)."""
        is_leaf = not {"directory", "link"} & set(self.sorts.values())
        if not self.has_segments and (within or not (is_leaf or self.is_session)):
            return None
        location = _text(self.location)
        if location != self.location:
            return unreadable(location, "its name is not UTF-8", "rename the folder, then add it again")
        if self.fault:
            return unreadable(location, self.fault, "put the file itself in its place, then add it again")
        if self.has_segments:
            return _place(location, self.entries)
        reason = "holds no segment (session.0001.mcap ...)"
        return Finding(location, Kind.NO_RECORDING, "", reason, "bring the segments back if there were any")


def _sort_of(entry: Mapping[str, Any]) -> str:
    """Return the sort of an entry; a link to a file is that file."""
    if not entry.get("islink"):
        return str(entry["type"]) if entry["type"] in ("directory", "file", "link") else "other"
    try:
        mode = Path(entry["name"]).stat().st_mode
    except OSError:  # it leads nowhere, or in a circle
        return "link"
    return "file" if stat.S_ISREG(mode) else "link" if stat.S_ISDIR(mode) else "other"


def _text(path: str) -> str:
    """Return a path that can be written; bytes that are not UTF-8 become ``\\xNN``."""
    return path.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")


def _reason(error: OSError) -> str:
    return f"{type(error).__name__}: {error.strerror or ' '.join(str(error).split())}"


@contextmanager
def brought_here(location: str) -> Iterator[tuple[Path, Place]]:
    """Give a session as a folder of this machine: its own if it lies here, else a copy that is gone afterwards.

    Raises: FileNotFoundError if there is no session any more; OSError if it cannot be read or copied; InputError
            B-ARC-002.
    """
    storage, root = _opened(location)
    listed = _Folder.of(storage, root)
    if listed.fault:
        raise StorageError(listed.fault)
    files = {name: entry for name, entry in listed.entries.items() if _is_read(name)}
    if not listed.has_segments:
        raise FileNotFoundError(location)
    place = _place(location, files)
    if _is_local(storage) and not any(entry["islink"] for entry in files.values()):
        yield Path(root), place
        return
    with TemporaryDirectory(prefix="bench-archive-") as copy:
        with _at_storage():
            for name, entry in sorted(files.items()):
                storage.get_file(str(entry["name"]), str(Path(copy, name)))
        yield Path(copy), place


def released_at(location: str, session_sha256: str) -> Mapping[str, Any] | None:
    """Return the results that lie beside a recording, None if they are of another one.

    Raises: OSError if there are none or they cannot be read; InputError B-ARC-002, B-FIT-010.
    """
    storage, root = _opened(location)
    with _at_storage(), TemporaryDirectory(prefix="bench-archive-") as copy:
        storage.get_file(f"{root}/{RESULTS}", str(Path(copy, RESULTS)))
        results = released_results(Path(copy))
    return results if results is not None and results["provenance"]["session_sha256"] == session_sha256 else None


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
    if state.get("islink"):
        return str(Path(state["name"]).stat().st_mtime)
    return next((str(state[name]) for name in _STATES if state.get(name) is not None), "")
