"""``fleet.yaml``: which benches there are, where each is reached, and where its token is kept, which is never in it."""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated
from urllib.parse import urlsplit

from pydantic import Field, StringConstraints, model_validator

from bench.model.errors import InputError, InputErrors
from bench.model.posix import AT_ONCE, RAW, is_own
from bench.model.yamlio import Document, StrictModel, load_yaml

MOST_BENCHES = 500
LOOPBACK = ("localhost", "127.0.0.1", "::1")
_OTHERS_USE = stat.S_IRWXG | stat.S_IRWXO
_TOKEN = re.compile(r"[A-Za-z0-9_-]{16,200}")
_LONGEST_FILE = 300  # bytes of a token with what an editor puts behind it
_URL_EXAMPLE = "for example https://bench-1.example.org, or http://127.0.0.1:8321 through 'ssh -L'"

_Name = Annotated[str, StringConstraints(pattern=r"^\w[\w .-]{0,39}$")]
_Words = Annotated[str, StringConstraints(min_length=1, max_length=200)]
_Variable = Annotated[str, StringConstraints(pattern=r"^[A-Za-z_][A-Za-z0-9_]{0,99}$")]


class BenchEntry(StrictModel):
    """One bench as ``fleet.yaml`` has it."""

    name: _Name
    place: Annotated[str, StringConstraints(max_length=80)] = ""
    url: _Words | None = None
    token_file: _Words | None = None
    token_env: _Variable | None = None
    folder: _Words | None = None

    @model_validator(mode="after")
    def _one_way(self) -> BenchEntry:
        tokens = (self.token_file is not None) + (self.token_env is not None)
        if (self.url is None) == (self.folder is None):
            raise ValueError("a bench has either 'url', of its 'bench serve', or 'folder', of its sessions")
        if tokens != (self.url is not None):
            raise ValueError("a bench with 'url' has either 'token_file' or 'token_env', one with 'folder' neither")
        return self


class FleetFile(StrictModel):
    """``fleet.yaml``."""

    benches: Annotated[list[BenchEntry], Field(min_length=1, max_length=MOST_BENCHES)]


@dataclass(frozen=True)
class FleetBench:
    """One bench that is looked at: its server by ``url`` and viewer's token, or the ``folder`` of its sessions.

    ``url`` is scheme, host and port alone, "" for a folder. ``where``: its place in ``fleet.yaml``.
    """

    name: str
    place: str
    where: str
    url: str = ""
    token: str = field(default="", repr=False)
    folder: Path | None = None


def load_fleet(path: Path, environment: Mapping[str, str]) -> tuple[FleetBench, ...]:
    """Return the benches in the order of the file; files it names are relative to its own folder.

    Raises: InputErrors with one mistake of each bench: B-YAML-001 to B-YAML-017, B-FLEET-001 (an address), B-FLEET-002
    (twice), B-FLEET-003 (a token), B-FLEET-004 (a folder).
    """
    document = load_yaml(path, FleetFile)
    benches, wrong = [], list(_doubles(document))
    for number, entry in enumerate(document.model.benches):
        try:
            benches.append(_bench(document, number, entry, path.parent, environment))
        except InputError as error:
            wrong.append(error)
    if wrong:
        raise InputErrors(sorted(wrong, key=lambda error: [int(part) for part in error.where.split(":")[-2:]]))
    return tuple(benches)


def _bench(
    document: Document[FleetFile], number: int, entry: BenchEntry, base: Path, environment: Mapping[str, str]
) -> FleetBench:
    def place(key: str) -> str:
        return document.where(("benches", number, key))

    if entry.folder is not None:
        folder = (base / entry.folder).absolute()
        if not folder.is_dir():
            advice = "name the folder of the sessions; 'bench run' makes one"
            raise InputError("B-FLEET-004", f"{entry.folder!r} is no folder", where=place("folder"), next_step=advice)
        return FleetBench(entry.name, entry.place, place("name"), folder=folder)
    url = _origin(str(entry.url), place("url"))
    if entry.token_env is not None:
        token = _token(environment.get(entry.token_env, ""), f"the variable {entry.token_env}", place("token_env"))
    else:
        token = _kept_token(base / str(entry.token_file), place("token_file"))
    return FleetBench(entry.name, entry.place, place("name"), url, token)


def _doubles(document: Document[FleetFile]) -> Iterator[InputError]:
    for key in ("name", "url", "folder"):
        first: dict[str, int] = {}
        for number, entry in enumerate(document.model.benches):
            text = getattr(entry, key)
            if text is not None and text.rstrip("/") in first:
                other = document.where(("benches", first[text.rstrip("/")], key))
                message = f"{key} {text!r} stands there twice, first at {other}"
                where = document.where(("benches", number, key))
                yield InputError("B-FLEET-002", message, where=where, next_step="each bench once, with its own name")
            elif text is not None:
                first[text.rstrip("/")] = number


def _origin(url: str, where: str) -> str:
    """Return scheme, host and port of the address of a whole server."""
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
        parts = urlsplit("")
    if parts.username or parts.password:
        message = "a name or a password stands in an address, where everybody reads it"
    elif (
        parts.scheme not in ("https", "http")
        or not host
        or parts.path not in ("", "/")
        or parts.query
        or parts.fragment
    ):
        message = f"{url!r} is not the address of a whole 'bench serve'"
    elif parts.scheme == "http" and host not in LOOPBACK:
        message = f"{url!r} is on another machine, and nothing would be encrypted, nor the token"
    else:
        shown = f"[{host}]" if ":" in host else host
        return f"{parts.scheme}://{shown}" + ("" if port is None else f":{port}")
    raise InputError("B-FLEET-001", message, where=where, next_step=_URL_EXAMPLE)


def _kept_token(path: Path, where: str) -> str:
    """Return the token in a file that only its owner may read."""
    advice = "put the viewer's token of this bench into it, alone, and 'chmod 600' it"
    try:
        with os.fdopen(os.open(path, os.O_RDONLY | RAW | AT_ONCE), "rb") as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise OSError("it is no file")
            content = file.read(_LONGEST_FILE)
    except (OSError, ValueError) as error:
        message = f"the token of {str(path)!r} cannot be read: {getattr(error, 'strerror', None) or error}"
        raise InputError("B-FLEET-003", message, where=where, next_step=advice) from error
    if not is_own(status, _OTHERS_USE, or_of_root=True):
        message = f"{str(path)!r} has mode {stat.S_IMODE(status.st_mode):04o}, others may use the token; due: 0600"
        raise InputError("B-FLEET-003", message, where=where, next_step="'chmod 600' it, as its owner")
    return _token(content.decode("ascii", "replace"), repr(str(path)), where)


def _token(text: str, place: str, where: str) -> str:
    token = text.strip()
    if _TOKEN.fullmatch(token) is None:
        message = f"{place} holds no token" if token else f"{place} is empty"
        advice = "the viewer's token is the 32 letters that 'bench serve' of that bench printed"
        raise InputError("B-FLEET-003", message, where=where, next_step=advice)
    return token
