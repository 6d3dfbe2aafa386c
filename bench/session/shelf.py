"""Computed results that are kept in the user's cache, outside of all sessions, and what they depend on.

A file on the shelf is a convenience and never evidence: whatever is damaged, of another user or of another key counts
as not there, and where nothing can be kept everything is computed.
"""

from __future__ import annotations

import hashlib
import io
import os
import pickle
import platform
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import is_dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from bench import __version__
from bench.analysis import Closed
from bench.model.errors import InputError, InstallationError
from bench.model.installed import OWN, offers
from bench.model.lab import cache_folder, lab_here, own_code_names, sha256_of
from bench.model.posix import is_own
from bench.model.segments import OPEN_MARKER, sealed_end, session_segments
from bench.session.output import write_file

ACCEPTANCES = "acceptances.json"  # beside the recording
MOST_BYTES = 500_000_000
_HEAD = b"inertial-bench kept results 1\n"
_ARRAYS = {
    ("numpy", "dtype"), ("numpy", "ndarray"), ("numpy._core.multiarray", "_reconstruct"),
    ("numpy._core.multiarray", "scalar"), ("numpy._core.numeric", "_frombuffer"),
}  # fmt: skip
_SENTENCE = ("bench.model.texts", "Said")  # a text with fields
_OURS = ("bench.analysis.", "bench.report.", "bench.session.")


def key_of(folders: Sequence[Path], options: Mapping[str, Any]) -> str | None:
    """Return what the results of some sessions depend on, as a name; None while one is recorded or has no end.

    Of each segment these are its name, size, times and the end of its data with the record of the hash chain, which
    stands for every byte before it; then what was accepted, all of the software; then how the results are computed.
    """
    parts: list[Any] = [sorted(options.items()), *_software(), *_of_lab()]
    for folder in folders:
        if (folder / OPEN_MARKER).exists():
            return None
        for path in session_segments(folder):
            end = sealed_end(path)
            if end is None:
                return None
            status = path.stat()
            parts.append((path.name, status.st_size, status.st_mtime_ns, status.st_ctime_ns, end.hex()))
        accepted = folder / ACCEPTANCES
        parts.append(hashlib.sha256(accepted.read_bytes()).hexdigest() if accepted.is_file() else "nothing accepted")
        parts.append("end of a session")
    return hashlib.sha256(repr(parts).encode()).hexdigest()


@cache
def _software() -> tuple[str, ...]:
    """Return version and source of the bench and of other systems, changed files too, and all that is installed."""
    packages = {"bench"} | {offer.package.partition(".")[0] for offer in offers("systems") if offer.distribution != OWN}
    digest = hashlib.sha256()
    for package in sorted(packages):
        spec = find_spec(package)
        for place in [] if spec is None else spec.submodule_search_locations or []:
            for path in _source(Path(place)):
                digest.update(repr((package, str(path.relative_to(place)))).encode())
                digest.update(hashlib.sha256(path.read_bytes()).digest())
    return (__version__, digest.hexdigest(), sys.version, platform.machine(), *sorted(_installed()))


def _of_lab() -> Iterator[tuple[str, str]]:
    """Yield the analyses of the lab folder with their hashes; what is refused computes nothing."""
    lab = lab_here()
    for name in [] if lab is None else own_code_names("analyses", lab):
        with suppress(InstallationError):
            yield name, sha256_of("analyses", name)


def _source(folder: Path) -> Iterator[Path]:
    for base, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if name != "__pycache__")
        yield from (Path(base) / name for name in sorted(names))


def _installed() -> Iterator[str]:
    """Yield names of installed distributions with their versions."""
    for place in sys.path:
        with suppress(OSError):
            yield from (path.name for path in Path(place).glob("*.dist-info"))


class _Reader(pickle.Unpickler):
    """Makes plain values, arrays, dataclasses and estimates of results: a file of others can do nothing here."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) in _ARRAYS:
            return super().find_class(module, name)
        if (module, name) == _SENTENCE:
            return super().find_class(module, name)
        if module.startswith(_OURS) and name.isidentifier():
            found = super().find_class(module, name)
            of_results = is_dataclass(found) or (isinstance(found, type) and issubclass(found, Closed))
            if isinstance(found, type) and of_results and found.__module__ == module:
                return found
        raise pickle.UnpicklingError(f"{module}.{name} is no result")


class Shelf:
    """What is kept under one key, by kind; without a key nothing is."""

    def __init__(self, key: str | None) -> None:
        self._key = key
        self._folder = cache_folder() / "results"

    def get(self, kind: str) -> Any:
        """Return what was kept, None if there is nothing that can be believed."""
        if self._key is None:
            return None
        try:
            if not is_own(self._folder.stat()):
                return None
            raw = self._path(kind).read_bytes()
            body = raw[len(_HEAD) + hashlib.sha256().digest_size :]
            return _Reader(io.BytesIO(body)).load() if raw == self._sealed(kind, body) else None
        except Exception:
            return None

    def put(self, kind: str, value: object) -> None:
        """Keep something, if that is possible."""
        if self._key is None:
            return
        try:
            self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            write_file(self._path(kind), self._sealed(kind, pickle.dumps(value, pickle.HIGHEST_PROTOCOL)))
            self._make_room()
        except (OSError, InputError, pickle.PicklingError, AttributeError, TypeError):
            return

    def _path(self, kind: str) -> Path:
        return self._folder / f"{self._key}.{kind}"

    def _sealed(self, kind: str, body: bytes) -> bytes:
        """Return the file: its hash covers the key, so that it is worth nothing under another name."""
        return _HEAD + hashlib.sha256(f"{self._key}.{kind}\n".encode() + body).digest() + body

    def _make_room(self) -> None:
        """Remove the oldest files until the rest is no more than MOST_BYTES."""
        files = [(path.stat(), path) for path in self._folder.iterdir()]
        size = sum(status.st_size for status, _ in files)
        for status, path in sorted(files, key=lambda file: file[0].st_mtime_ns):
            if size <= MOST_BYTES:
                return
            path.unlink(missing_ok=True)
            size -= status.st_size
