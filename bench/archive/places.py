"""Folders of sessions on a file system or a store of objects: found, and brought to this machine.

The one place that knows how storage is reached (fsspec): a local path, or a URL such as ``s3://bucket/folder``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import fsspec

from bench.model.errors import BenchError, InputError, SessionDamaged
from bench.model.segments import OPEN_MARKER, SEGMENT_NAME
from bench.record import FOLDER as TREND
from bench.report import CERTIFICATE_FILE, SPECIMEN_FILE
from bench.session.shelf import ACCEPTANCES
from bench.session.verification import REPORT, RESULTS
from bench.store import ArchivedSession

Entries = Mapping[str, Mapping[str, Any]]
_KEPT = (RESULTS, ACCEPTANCES, CERTIFICATE_FILE, SPECIMEN_FILE, OPEN_MARKER)  # what is read beside the segments
# What a store says of the state of an object, the surest first; every one of them has one of these.
_STATES = ("ETag", "etag", "md5Hash", "mtime", "LastModified", "last_modified", "created")
_LATER = "look after storage, rights and workers, then give the same command again"


class StorageError(OSError):
    """Storage cannot be read now, in the words of the package that reaches it."""


class Kind(StrEnum):
    """What a folder is to the archive; each that is seen has one. Folders of folders, and parts of a session, none."""

    ENTERED = "entered"  # a whole recording; one that is looked at again is verified
    UNCHANGED = "unchanged"
    DAMAGED = "damaged"
    UNREADABLE = "unreadable"
    UNFINISHED = "unfinished"
    STOPPED = "stopped"
    NO_RECORDING = "no_recording"
    LINK = "link"


@dataclass(frozen=True)
class Place:
    """The folder of a session; ``fingerprint``: of the names, sizes and states of the files that are read."""

    location: str
    bytes: int
    fingerprint: str


@dataclass(frozen=True)
class Finding:
    """A folder with its kind: why it is no whole session, and what to do; ``session``: what the index is to know."""

    location: str
    kind: Kind
    code: str = ""
    reason: str = ""
    next_step: str = ""
    session: ArchivedSession | None = None


def unreadable(location: str, reason: str, next_step: str = _LATER) -> Finding:
    """Return the finding for a folder that cannot be read now, which says nothing of what lies there."""
    return Finding(location, Kind.UNREADABLE, "B-ARC-007", reason, next_step)


def list_places(url: str) -> list[Place | Finding]:
    """Return every session in a folder and below it, and what else stands there, by location; links are not followed.

    Args:   url: a path, or a URL of a file system that fsspec knows.
    Raises: InputError B-ARC-002 if it is no folder, or nothing in it has a recording.
    """
    try:
        storage, root = _opened(url)
        places = list(_walked(storage, root))
    except (FileNotFoundError, NotADirectoryError) as error:
        raise _no_folder(url, f"cannot be listed: {reason_of(error)}") from error
    except OSError as error:
        return [unreadable(url, reason_of(error))]
    if all(isinstance(place, Finding) and place.kind is Kind.NO_RECORDING for place in places):
        raise _no_folder(url, "holds no session")
    return sorted(places, key=lambda place: place.location)


def _walked(storage: Any, root: str) -> Iterator[Place | Finding]:
    """Yield what stands in a folder and below it. Raises: OSError if the folder itself cannot be listed."""
    waiting = [(root, False)]
    while waiting:
        path, within = waiting.pop()
        location = _location(storage, path)
        try:
            entries = _entries(storage, path)
        except OSError as error:
            if path == root:
                raise
            yield unreadable(_text(location), reason_of(error))
            continue
        yield from _links(location, entries)
        is_recording = _has_segments(entries)
        is_session = is_recording or not {*_KEPT, REPORT, TREND}.isdisjoint(entries)
        below = [str(entry["name"]) for entry in entries.values() if entry["type"] == "directory"]
        if is_recording or not (within or (below and not is_session)):
            yield _classified(location, entries)
        waiting += [(folder, within or is_session) for folder in below]


def _links(location: str, entries: Entries) -> Iterator[Finding]:
    """Yield the links to folders, and those that lead nowhere."""
    for name, entry in entries.items():
        if entry["type"] == "link" and not _is_read(name):
            there = f"a link to {_text(str(entry.get('destination')))}, not followed"
            yield Finding(_text(f"{location}/{name}"), Kind.LINK, "", there, "add the folder that it leads to")


def _classified(location: str, entries: Entries) -> Place | Finding:
    """Return the session in a folder, or what it is in place of one."""
    name = _text(location)
    if name != location:
        return unreadable(name, "its name is not UTF-8", "rename the folder, then add it again")
    if fault := _fault(entries):
        return unreadable(location, fault, "put the file itself in its place, then add it again")
    if _has_segments(entries):
        return _place(location, entries)
    reason = "holds no segment (session.0001.mcap ...)"
    return Finding(location, Kind.NO_RECORDING, "", reason, "bring the segments back if there were any")


@contextmanager
def brought_here(location: str) -> Iterator[tuple[Path, Place]]:
    """Give a session as a folder of this machine: its own if it lies here, else a copy that is gone afterwards.

    Raises: SessionDamaged B-ARC-003 if there is no session any more; OSError if it cannot be read or copied; InputError
            B-ARC-002.
    """
    storage, root = _opened(location)
    entries: Entries = {}
    with suppress(FileNotFoundError):
        entries = _entries(storage, root)
    if not _has_segments(entries):
        step = "bring it back, or add the place where it is now"
        raise SessionDamaged("B-ARC-003", "there is no session any more", next_step=step)
    if fault := _fault(entries):
        raise StorageError(fault)
    place = _place(location, entries)
    files = {name: entry for name, entry in entries.items() if _is_read(name)}
    if _is_local(storage) and not any(entry["islink"] for entry in files.values()):  # links are read by nobody else
        yield Path(root), place
        return
    with TemporaryDirectory(prefix="bench-archive-") as copy:
        with _at_storage():
            for name, entry in files.items():
                storage.get_file(str(entry["name"]), str(Path(copy, name)))
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
        raise StorageError(reason_of(error)) from error


def _opened(url: str) -> tuple[Any, str]:
    """Return the file system of a URL, and the path in it.

    Raises: InputError B-ARC-002 if no package here knows it; OSError if it cannot be reached now.
    """
    with _at_storage():
        try:
            storage, root = fsspec.core.url_to_fs(url)
        except (ValueError, ImportError) as error:
            raise _no_folder(url, f"cannot be listed: {' '.join(str(error).split())}") from error
    return storage, str(root)


def _no_folder(url: str, reason: str) -> InputError:
    return InputError(
        "B-ARC-002",
        reason,
        where=url,
        next_step="name a folder of sessions; a store of objects needs its own package of fsspec, such as s3fs",
    )


def reason_of(error: Exception) -> str:
    """Return in one line what a package or the system says."""
    return f"{type(error).__name__}: {getattr(error, 'strerror', None) or ' '.join(str(error).split())}"


def _entries(storage: Any, path: str) -> Entries:
    """Return what stands in a folder by name; ``type``: file, directory, link (to one, or nowhere) or other."""
    with _at_storage():
        listed: list[Mapping[str, Any]] = storage.ls(path, detail=True)
    # a file is listed as itself, and a store of objects may have one that stands for the folder
    named = ((str(entry["name"]).rstrip("/"), entry) for entry in listed)
    return {name.rpartition("/")[2]: _entry(storage, entry) for name, entry in named if name != path.rstrip("/")}


def _entry(storage: Any, entry: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return an entry; a link to a file is that file."""
    if not entry.get("islink"):
        return entry
    try:
        target: Mapping[str, Any] = storage.info(entry["name"])
    except OSError:  # it leads nowhere, or in a circle
        return {**entry, "type": "link"}
    return {**target, "type": "link"} if target["type"] == "directory" else target


def _has_segments(entries: Entries) -> bool:
    return any(map(SEGMENT_NAME.fullmatch, entries))


def _is_read(name: str) -> bool:
    return name in _KEPT or SEGMENT_NAME.fullmatch(name) is not None


def _fault(entries: Entries) -> str:
    """Return what keeps the files of a session from being opened, "" if nothing does."""
    others = [name for name in filter(_is_read, entries) if entries[name]["type"] != "file"]
    return f"{others[0]} is a folder, pipe, device or dead link; it was not opened" if others else ""


def _text(path: str) -> str:
    """Return a path that can be written; bytes that are not UTF-8 become ``\\xNN``."""
    return path.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")


def _is_local(storage: Any) -> bool:
    return getattr(storage, "local_file", False)


def _location(storage: Any, folder: str) -> str:
    """Return a path of this machine as it is, any other with its protocol."""
    return folder if _is_local(storage) else str(storage.unstrip_protocol(folder))


def _place(location: str, entries: Entries) -> Place:
    read = [(name, entries[name]) for name in sorted(filter(_is_read, entries))]
    states = [(name, entry["size"], _state(entry)) for name, entry in read]
    size = sum(int(entry["size"]) for _, entry in read)
    return Place(location, size, hashlib.sha256(repr(states).encode()).hexdigest())


def _state(entry: Mapping[str, Any]) -> str:
    return next((str(entry[name]) for name in _STATES if entry.get(name) is not None), "")
