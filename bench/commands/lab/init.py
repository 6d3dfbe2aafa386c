"""``bench init``, ``bench copy``: a laboratory's own folder, with files that run and are meant to be changed."""

from __future__ import annotations

import difflib
import re
import sys
from contextlib import chdir
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from bench.commands.console import console, say
from bench.commands.schema import schema
from bench.model.errors import InputError
from bench.model.lab import CODE, FILE, KINDS, find_shipped, lab_here, shipped_folder, shipped_names
from bench.session.output import write_file, writing

_TEMPLATES = files("bench.commands.lab") / "templates"
FIRST_STATION = "af_bench_sim"  # the bench that the first sequence is written for
_PLACES = {
    "bench_toml": FILE, "readme": "README.md", "laboratory": "laboratory.yaml", "unit_frame": "frames/my_unit.yaml",
    "first_check": "sequences/first_check.yaml", "test_lab": "tests/test_lab.py", "gitignore": ".gitignore",
}  # fmt: skip
_CODE = {
    "instruments": "Drivers that `bench` does not have: `<maker>_<model>.py`, which ends with `DRIVER = TheClass`.",
    "sim_instruments": "Their simulators, each in a file of the driver's name, which ends with `SIMULATOR = TheClass`.",
    "analyses": "Analyses of your own: `<name>.py` with `METHODS`, `DECLARATION` and `analyse`.",
}
_OTHERS_WRITE = 0o022


@dataclass(frozen=True)
class Answers:
    """What a lab folder is made for: name of the laboratory, model and serial number of the unit, simulated station."""

    name: str
    model: str
    serial: str
    station: str


_QUESTIONS = {
    "name": ("What is the laboratory called?", "--name"),
    "model": ("Which model of unit is tested?", "--model"),
    "serial": ("What is its serial number?", "--serial"),
    "station": ("Which simulated bench is nearest to yours?", "--station"),
}
_PLAIN = (r"[A-Za-z0-9][A-Za-z0-9._-]{0,39}", "up to 40 letters, digits, '.', '_' and '-'")
_FORMS = {
    "name": (r"[^\x00-\x1f\"\\{}]{1,60}", "up to 60 characters without quotes, braces and backslashes"),
    "model": _PLAIN,
    "serial": _PLAIN,
}
_DEFAULTS = {"model": "unit", "serial": "1", "station": FIRST_STATION}


def init(folder: Path, **given: str | None) -> None:
    """Write a lab folder; what the command line does not say is asked on a terminal, else taken as proposed.

    Raises: InputError B-LAB-002 if the folder is there and not empty, B-LAB-003 for an answer that cannot be used,
        B-SHIP-001 for a station that does not exist, B-CLI-007 if it cannot be written.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError("B-LAB-002", "is there already and not empty", where=folder, next_step="name a new folder")
    proposed = {"name": folder.resolve().name, **_DEFAULTS}
    answers = Answers(**{key: value or _asked(key, proposed[key]) for key, value in given.items()})
    for key, (pattern, what) in _FORMS.items():
        if not re.fullmatch(pattern, getattr(answers, key)):
            text = f"{getattr(answers, key)!r} is not {what}"
            raise InputError("B-LAB-003", text, where=_QUESTIONS[key][1], next_step="choose another")
    station = find_shipped("stations", answers.station)
    _make_folders(folder)
    contents = _contents(answers, station)
    for name, text in contents.items():
        write_file(folder / name, text)
    with chdir(folder):
        schema(Path("schemas"), vscode=True)
    first = _PLACES["first_check"] in contents
    then = f"try: cd {folder} && bench check first_check" if first else f"sequences go into {folder}/sequences"
    say(f"lab folder {folder}: {answers.name}; {then}")


def copy(name: str, new: str | None) -> None:
    """Copy a shipped sequence, station or frame into the lab folder, without one into this folder.

    Raises: InputError B-SHIP-001 for an unknown name, B-LAB-002 if there is such a file, B-CLI-007, B-LAB-001.
    """
    kinds = {known: kind for kind in KINDS for known in shipped_names(kind)}
    near = difflib.get_close_matches(name, kinds, n=1)
    kind = kinds[near[0]] if near else KINDS[0]
    source, lab = find_shipped(kind, name), lab_here()
    own = Path(new or source).stem
    target = (Path() if lab is None else lab.folder / kind) / f"{own}.yaml"
    if target.exists():
        raise InputError("B-LAB-002", "is there already", where=target, next_step="give another name with --as")
    write_file(target, _renamed(source, kind[:-1], own))
    say(f"{target}: change what is yours")


def _renamed(source: Path, noun: str, own: str) -> str:
    """Return the text of a file with another name in its first entry."""
    return source.read_text(encoding="utf-8").replace(f"{noun}: {source.stem}\n", f"{noun}: {own}\n", 1)


def _make_folders(folder: Path) -> None:
    """Make the folder, that of sequences and those for code, which nobody else may write to whatever the umask is.

    Raises: InputError B-CLI-007.
    """
    for path in (folder, folder / "sequences", *(folder / kind for kind in CODE)):
        with writing(path):
            path.mkdir(parents=True, exist_ok=True)
            path.chmod(path.stat().st_mode & ~_OTHERS_WRITE)


def _asked(key: str, proposed: str) -> str:
    if not sys.stdin.isatty():
        return proposed
    if key == "station":
        say(f"simulated benches: {', '.join(shipped_names('stations'))}")
    console().print(f"{_QUESTIONS[key][0]} [{proposed}] ", end="")
    return sys.stdin.readline().strip() or proposed


def _contents(answers: Answers, station: Path) -> dict[str, str]:
    """Return the files of the folder by their places."""
    own = f"my_{station.stem}" if station.parent.resolve() == shipped_folder("stations").resolve() else station.stem
    values = {"NAME": answers.name, "MODEL": answers.model, "SERIAL": answers.serial, "STATION": own}
    places = {name: place for name, place in _PLACES.items() if name != "first_check" or station.stem == FIRST_STATION}
    written = {place: _filled(template, values) for template, place in places.items()}
    if "first_check" not in places:
        lines = written["README.md"].splitlines(keepends=True)
        written["README.md"] = "".join(line for line in lines if "first_check" not in line)
    written |= {f"{kind}/README.md": f"{_CODE[kind]}\n" for kind in CODE}
    return written | {f"stations/{own}.yaml": _renamed(station, "station", own)}


def _filled(template: str, values: dict[str, str]) -> str:
    text = _TEMPLATES.joinpath(f"{template}.txt").read_text(encoding="utf-8")
    return re.sub(r"@([A-Z]+)@", lambda match: values[match[1]], text)
