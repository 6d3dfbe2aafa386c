"""A laboratory's own folder, ``bench.toml`` at its top: sequences, stations, frames, and code of its own below.

Drivers, their simulators and analyses are loaded by path, where nobody else can have written.

A file is read once, so that what is hashed is what is executed. It stands alone: it imports what is installed and no
file beside it, because a lab folder is on no search path. Nothing that a session holds is executed.

Sequences, frames and stations by path or name: those of a lab folder first, then those that come with the bench.

Folders of this user and names of folders stand here too.
"""

from __future__ import annotations

import difflib
import hashlib
import os
import re
import stat
import sys
import tomllib
import traceback
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

from bench.model.errors import InputError, InstallationError
from bench.model.posix import ALONE, AT_ONCE, NO_LINK, distrust, has_owners

FILE = "bench.toml"
_NEXT = 'it needs one line "[lab]" and below it one line such as: name = "Our laboratory"'


@dataclass(frozen=True)
class Lab:
    """The folder, and what the laboratory calls it."""

    folder: Path
    name: str

    @property
    def sessions(self) -> Path:
        """Where sessions go that name no other folder."""
        return self.folder / "sessions"

    def holds(self, path: Path) -> bool:
        """Return whether a file lies in the folder, links followed."""
        return path.resolve().is_relative_to(self.folder)


def lab_here() -> Lab | None:
    """Return the lab folder that the working directory is or lies in, the nearest one; None if there is none.

    Raises: InputError B-LAB-001 if its ``bench.toml`` is not as it should be.
    """
    try:
        here = Path.cwd()
    except FileNotFoundError:  # somebody removed it
        return None
    folder = next((folder for folder in (here, *here.parents) if (folder / FILE).is_file()), None)
    return None if folder is None else Lab(folder.resolve(), _name(folder / FILE))


def _name(file: Path) -> str:
    try:
        content = tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise _wrong(file, f"cannot be read as TOML: {error}") from error
    lab = content.pop("lab", None)
    keys = lab if isinstance(lab, dict) else {}
    for unknown in (*content, *(key for key in keys if key != "name")):
        raise _wrong(file, f"unknown key {unknown!r}")
    name = keys.get("name")
    if not isinstance(name, str) or not name.strip():
        raise _wrong(file, "does not name the laboratory")
    return name.strip()


def _wrong(file: Path, message: str) -> InputError:
    return InputError("B-LAB-001", message, where=str(file), next_step=_NEXT)


CodeKind = Literal["instruments", "sim_instruments", "analyses"]
CODE: tuple[CodeKind, ...] = ("instruments", "sim_instruments", "analyses")
MODULES = "lab_folder."
TRUST = "BENCH_TRUST_LAB"
"""Environment variable by which ``--trust-lab`` reaches the processes that a command starts."""

_NAME = re.compile(r"(?!_|none$)[a-z0-9_]{1,40}")  # "none" means that a sequence has no analysis
_PLACE = re.compile(r"(instruments|sim_instruments|analyses)/([a-z0-9_]{1,40})(\.py|\.yaml)")
_SHOWN = 12  # digits of a hash in a message


@dataclass(frozen=True)
class _Source:
    """A file as it was read."""

    path: Path
    content: bytes

    @property
    def sha256(self) -> str:
        return hashlib.sha256(self.content).hexdigest()


_LOADED: dict[Path, tuple[_Source, ModuleType]] = {}


def is_plain(name: str) -> bool:
    """Return whether a driver or an analysis may have this name."""
    return _NAME.fullmatch(name) is not None


def own_code(kind: CodeKind, name: str, suffix: str = ".py") -> Path | None:
    """Return the file of the lab folder that a plain name means, None without one. Raises: InputError B-LAB-001.

    ``suffix``: ".yaml" for the table of a driver.
    """
    lab = lab_here()
    if lab is None or not is_plain(name):
        return None
    path = lab.folder / kind / f"{name}{suffix}"
    return path if os.path.lexists(path) else None


def own_code_names(kind: CodeKind, lab: Lab) -> list[str]:
    """Return the names of a lab folder's own drivers, simulators or analyses, sorted."""
    return sorted(path.stem for path in (lab.folder / kind).glob("*.py") if is_plain(path.stem))


def load(kind: CodeKind, name: str) -> ModuleType | None:
    """Return a module of the lab folder, executed at its first use; None if the lab has none of this name.

    Raises: InstallationError B-LAB-004 if others can write to it or it is a link, B-LAB-006 if it cannot be loaded.
    """
    source = _source(kind, name)
    return None if source is None else _module_of(source, kind)


def refused_twice(kind: CodeKind, name: str, release: str) -> InstallationError:
    """Return the error of a lab's file that has the name of something installed, B-LAB-005."""
    message = f"{name!r} is the name of what {release} brings; code of a lab folder never stands in for it"
    where = str(own_code(kind, name))
    return InstallationError("B-LAB-005", message, where=where, next_step="give the file another name")


@dataclass(frozen=True)
class Whose:
    """Whose code a module is, as errors name it: of a lab folder, or of a distribution.

    ``place``: its file.   ``below``: file or folder of its lines.
    ``unusable``, ``failed``: codes of what cannot be used as it is, and of an exception.
    """

    name: str
    place: str
    below: Path
    unusable: str
    failed: str
    cure: str

    def error(self, code: str, why: str, error: BaseException | None = None) -> InstallationError:
        """Return an error that names the code, and of an exception the last line of it that it came through."""
        trace = traceback.extract_tb(getattr(error, "__traceback__", None))
        places = [(self.place, None), *((frame.filename, frame.lineno) for frame in trace)]
        if isinstance(error, SyntaxError):
            places.append((error.filename or "", error.lineno))
        file, line = [place for place in places if Path(place[0]).is_relative_to(self.below)][-1]
        where = file if line is None else f"{file}:{line}"
        return InstallationError(code, f"{self.name} {why}", where=where, next_step=self.cure)


def whose(module: str, path: Path) -> Whose:
    """Return how errors name a file of the lab folder, by the name of its module."""
    place = f"{module.removeprefix(MODULES).replace('.', '/')}.py"
    cure = "correct the file; docs/user-guide.md says what it holds"
    return Whose(place, str(path), path, "B-LAB-006", "B-LAB-008", cure)


def code_used(drivers: Collection[str], *, simulated: bool = False, analysis: str = "none") -> dict[str, str]:
    """Return SHA-256 of the lab's files that a run uses, by their place such as ``instruments/my_meter.py``.

    ``simulated``: the simulators of the drivers are used, too.
    Raises: InputError B-LAB-001; InstallationError B-LAB-004.
    """
    kinds: tuple[CodeKind, ...] = ("instruments", "sim_instruments") if simulated else ("instruments",)
    asked: list[tuple[CodeKind, str, str]] = [("analyses", analysis, ".py")]
    for driver in set(drivers):
        asked += [("instruments", driver, ".yaml"), *((kind, driver, ".py") for kind in kinds)]
    found = {f"{kind}/{name}{suffix}": _source(kind, name, suffix) for kind, name, suffix in asked}
    return {place: source.sha256 for place, source in sorted(found.items()) if source is not None}


def code_texts(places: Collection[str]) -> dict[str, str]:
    """Return the texts of the lab's files at these places, for a session: to be read, never to be executed."""
    sources = {place: _source(*_parts(place)) for place in places}
    return {place: source.content.decode("utf-8", "replace") for place, source in sources.items() if source is not None}


def table_of(driver: str) -> bytes | None:
    """Return the table beside a driver of the lab; None without one. Raises: InstallationError B-LAB-004."""
    source = _source("instruments", driver, ".yaml")
    return None if source is None else source.content


def sha256_of(kind: CodeKind, name: str, suffix: str = ".py") -> str:
    """Return SHA-256 of a lab's file, as it was loaded or as it is; "" if the lab has none of this name."""
    source = _source(kind, name, suffix)
    return "" if source is None else source.sha256


def recorded_code(manifest: Mapping[str, Any]) -> tuple[dict[str, str], str]:
    """Return what a session says of the lab's code it was recorded with: SHA-256 by place, and the lab's name."""
    lab = manifest.get("lab")
    files = lab.get("files") if isinstance(lab, dict) else None
    if lab is None or not isinstance(files, dict):
        return {}, "an installation"
    return {str(place): str(sha256) for place, sha256 in files.items()}, str(lab.get("name", "a lab"))


def require_code(recorded: Mapping[str, str], whose: str) -> None:
    """Refuse to read on without the lab's files that a session names, whatever is in them.

    Raises: InstallationError B-LAB-007, B-LAB-004; InputError B-LAB-001.
    """
    for place, sha256 in sorted(recorded.items()):
        if not sha256_of(*_parts(place)):
            raise _differs(place, sha256, "", whose)


def demand(recorded: Mapping[str, str], whose: str) -> None:
    """Load the lab's files that a session or a run names, if they are what they were.

    Args:   recorded: SHA-256 by place, as of ``code_used``.   whose: the lab's name, for the message.
    Raises: InstallationError B-LAB-007 for a file that is not here or has another hash; those of ``load``.
    """
    for place, sha256 in sorted(recorded.items()):
        kind, name, suffix = _parts(place)
        source = _source(kind, name, suffix)
        if source is None or source.sha256 != sha256:
            raise _differs(place, sha256, "" if source is None else source.sha256, whose)
        if suffix == ".py":
            _module_of(source, kind)


def refuse_others(recorded: Mapping[str, str], used: Mapping[str, str], whose: str) -> None:
    """Refuse to go on with other code than a session began with. Raises: InstallationError B-LAB-007."""
    for place in sorted(used.keys() - recorded.keys()):
        raise _differs(place, "", used[place], whose)


def differing(recorded: Mapping[str, str], analysis: str, whose: str) -> str:
    """Return a sentence if the lab's analysis is not what a session was recorded with, else "".

    Raises: InstallationError B-LAB-007 if the session's analysis is of a lab, and not here; B-LAB-001, B-LAB-004.
    """
    place = f"analyses/{analysis}.py"
    then, now = recorded.get(place, ""), sha256_of("analyses", analysis)
    if then and not now:
        raise _differs(place, then, now, whose)
    if then == now:
        return ""
    before = f"with {then[:_SHOWN]}" if then else "without it"
    return f"Computed by {place} as it is today, SHA-256 {now[:_SHOWN]}; the session was recorded {before}."


def _differs(place: str, then: str, now: str, whose: str) -> InstallationError:
    lab = lab_here()
    here = "there is no lab folder here" if lab is None else f"{lab.folder} has no such file"
    found = f"{lab.folder} has {now[:_SHOWN]}" if now and lab is not None else here
    asked = f"SHA-256 {then[:_SHOWN]} of {whose} is asked for" if then else "it was not used before"
    cure = "go to the lab folder that the session was recorded in, with this file as it was then"
    return InstallationError("B-LAB-007", f"{asked}, and {found}", where=place, next_step=cure)


def _parts(place: str) -> tuple[CodeKind, str, str]:
    match = _PLACE.fullmatch(place)
    if match is None:
        message, cure = "is no file of code that a lab folder may hold", "somebody changed the session's manifest"
        raise InstallationError("B-LAB-007", message, where=place[:80], next_step=cure)
    return next(kind for kind in CODE if kind == match[1]), match[2], match[3]


def _source(kind: CodeKind, name: str, suffix: str = ".py") -> _Source | None:
    path = own_code(kind, name, suffix)
    if path is None:
        return None
    return _LOADED[path][0] if path in _LOADED else _read(path)


def _read(path: Path) -> _Source:
    """Return a file that this user or root alone can have written. Raises: InstallationError B-LAB-004."""
    lab = path.parent.parent
    if not has_owners() and not os.environ.get(TRUST):
        message, cure = "this system does not say who wrote it", "look at the code, then say so: bench --trust-lab ..."
        raise InstallationError("B-LAB-004", message, where=str(path), next_step=cure)
    for folder in (*reversed(lab.parents), lab, path.parent):
        if folder.is_symlink():
            raise _distrusted(folder, "is a link")
        if why := distrust(folder.lstat(), shared=folder in lab.parents):
            raise _distrusted(folder, why)
    try:
        descriptor = os.open(path, os.O_RDONLY | ALONE | NO_LINK | AT_ONCE)
    except OSError as error:
        why = "is a link" if path.is_symlink() else f"cannot be read: {error.strerror}"
        raise _distrusted(path, why) from error
    with os.fdopen(descriptor, "rb") as file:
        status = os.fstat(descriptor)
        if path.is_symlink() or not stat.S_ISREG(status.st_mode):
            raise _distrusted(path, "is a link" if path.is_symlink() else "is no file")
        if why := distrust(status):
            raise _distrusted(path, why)
        return _Source(path, file.read())


def _distrusted(path: Path, why: str) -> InstallationError:
    cure = (
        "code of a lab folder is a file of your own in folders that only you or root can write to (chmod go-w, chown)"
    )
    return InstallationError("B-LAB-004", why, where=str(path), next_step=cure)


def _module_of(source: _Source, kind: CodeKind) -> ModuleType:
    """Return the module of a file, executed at its first use. Raises: InstallationError B-LAB-006."""
    if source.path not in _LOADED:
        _LOADED[source.path] = source, _executed(source, kind)
    module = _LOADED[source.path][1]
    sys.modules[module.__name__] = module  # where dataclasses and declarations look it up
    return module


def _executed(source: _Source, kind: CodeKind) -> ModuleType:
    """Return the module of a file. Raises: InstallationError B-LAB-006 with file, line and exception."""
    name = f"{MODULES}{kind}.{source.path.stem}"
    module = ModuleType(name)
    module.__file__, module.__package__ = str(source.path), ""  # in no package: no relative import finds anything
    sys.modules[name] = module
    try:
        exec(compile(source.content, str(source.path), "exec", dont_inherit=True), module.__dict__)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        of_lab = whose(name, source.path)
        raise of_lab.error(of_lab.unusable, f"cannot be loaded: {in_words(error)}", error) from error
    return module


def in_words(error: BaseException) -> str:
    """Return the name of an exception and what it says, in one line."""
    text = " ".join((error.msg if isinstance(error, SyntaxError) else str(error)).split())
    return f"{type(error).__name__}{f': {text}' if text else ''}"


def cache_folder() -> Path:
    """Return where the bench keeps what it can compute again; nobody made it yet.

    Source: XDG Base Directory Specification: XDG_CACHE_HOME if it is absolute, else ~/.cache.
    """
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if Path(base).is_absolute() else Path.home() / ".cache") / "inertial-bench"


def folder_name(serial: str) -> str:
    """Return a serial number as the name of a folder: letters, digits, dot, dash and underscore, no dot at its ends."""
    return re.sub(r"[^A-Za-z0-9._-]", "_", serial).strip(".") or "_"


Kind = Literal["sequences", "frames", "stations"]
KINDS: tuple[Kind, ...] = ("sequences", "stations", "frames")

_KINDS = {  # what a file is, the keys at its top of which it has all and no other kind has, which command takes it
    "sequences": ("sequence", {"sequence", "station"}, "'bench check {name}' and 'bench run {name}' take it"),
    "mappings": ("mapping", {"mapping", "columns"}, "'bench import {name} FILE' takes it"),
    "frames": ("frame", {"frame", "crc"}, "'bench decode {name} FILE' takes it; a sequence names it under 'frame'"),
    "stations": ("station", {"station", "instruments"}, "--station {name} of 'bench check' and 'bench run' takes it"),
}
_KEYS = re.compile(rb"^([a-z]+)[ ]*:", re.MULTILINE)
_MOST_BYTES = 1_000_000  # of a YAML file
_PLAIN_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*")
_PACKAGE = Path(__file__).resolve().parent.parent


def shipped_folder(kind: str) -> Path:
    """Return the folder of shipped files: inside the installed package, or at the top of a checkout."""
    installed = _PACKAGE / "shipped" / kind
    return installed if installed.is_dir() else _PACKAGE.parent / kind


def shipped_names(kind: Kind) -> list[str]:
    """Return names of the shipped files of a kind, sorted, without ``.yaml``."""
    return sorted(path.stem for path in shipped_folder(kind).glob("*.yaml"))


def own_names(kind: Kind, lab: Lab) -> list[str]:
    """Return names of a lab folder's own files of a kind, sorted, without ``.yaml``."""
    return sorted(path.stem for path in (lab.folder / kind).glob("*.yaml"))


def find_shipped(kind: Kind, name_or_path: str | Path) -> Path:
    """Return the file meant by a path, or by the plain name, with or without ``.yaml``, of a lab's or a shipped file.

    Raises: InputError B-SHIP-001 if there is none, B-SHIP-002 if it is a file of another kind; a name never leaves
    these folders. B-LAB-001.
    """
    text = str(name_or_path)
    path = Path(text)
    if _is_file(path):
        refuse_other_kinds(kind, path)
        return path
    lab = lab_here()
    if _PLAIN_NAME.fullmatch(text):
        for folder in (*([] if lab is None else [lab.folder / kind]), shipped_folder(kind)):
            named = folder / f"{text.removesuffix('.yaml')}.yaml"
            if _is_file(named):
                return named
    for other in KINDS:
        if path.name == text and path.stem in shipped_names(other):
            raise _another(kind, other, path.stem)
    names = [*([] if lab is None else own_names(kind, lab)), *shipped_names(kind)]
    text = text[:80]
    near = difflib.get_close_matches(path.stem, names, n=1)
    meant = f"did you mean {near[0]!r}? " if near else ""
    raise InputError(
        "B-SHIP-001",
        f"there is no file {text!r} and no shipped {kind[:-1]} of that name",
        where=text,
        next_step=f"{meant}give the path of a YAML file or one of: {', '.join(names) or 'none shipped'}",
    )


def refuse_other_kinds(kind: str, path: Path) -> None:
    """Raise InputError B-SHIP-002 if the keys at the top of a file are those of another kind of file."""
    try:
        with path.open("rb") as file:
            keys = {found.decode() for found in _KEYS.findall(file.read(_MOST_BYTES))}
    except OSError:  # whoever reads the file says why it cannot be read
        return
    other = next((name for name, (_, own, _) in _KINDS.items() if own <= keys), None)
    if other is not None and other != kind and not _KINDS[kind][1] <= keys:
        raise _another(kind, other, str(path))


def _another(kind: str, other: str, text: str) -> InputError:
    is_a, _, taken = _KINDS[other]
    taken = taken.format(name=text)
    return InputError("B-SHIP-002", f"this is a {is_a}, and a {kind[:-1]} is due", where=text, next_step=taken)


def _is_file(path: Path) -> bool:
    """Return False also for what no file system can hold: a name that is too long, or with a zero byte."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def find_beside(source: Path, kind: Kind, name: str) -> Path:
    """Return a file that a source names: beside the source's folder, unless that is shipped, else as ``find_shipped``.

    A path begins at the source's own folder. Raises: InputError B-SHIP-001, B-SHIP-002, B-LAB-001.
    """
    if name.endswith(".yaml"):
        return find_shipped(kind, source.parent / name)
    beside = source.parent.parent / kind / f"{name}.yaml"
    is_shipped = beside.parent.resolve() == shipped_folder(kind).resolve()
    return beside if beside.is_file() and not is_shipped else find_shipped(kind, name)


def replaced_by_lab(kind: Kind, path: Path) -> str:
    """Return, where a file is a lab's own and a shipped one has the same name, a sentence that says so; else ""."""
    lab = lab_here()
    if lab is None or not lab.holds(path) or path.stem not in shipped_names(kind):
        return ""
    return f"{kind[:-1]} {path.stem}: {path} of {lab.name}, not the installed one"
