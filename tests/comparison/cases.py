"""What is run in both revisions: every analysis on a session as small as it allows, and every sequence checked.

Nothing here and in ``cases.toml`` names a module of the product: commands, sequences and mappings only.
"""

import shutil
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

Cut = tuple[str, str]


@dataclass(frozen=True)
class Case:
    """One command, given in an empty folder of its own on both sides.

    ``files``: texts that are written beside, by name, for example a sequence that is cut short.
    ``copied``: folder that is there when the command begins.   ``is_session``: it leaves one that can be replayed.
    ``example``: the command is given in a copy of this folder below ``examples``, each side in a copy of its own.
    ``is_of_plans``: the words are sequences, whose plans are written; no command prints these.
    """

    name: str
    words: tuple[str, ...]
    files: Mapping[str, str] = field(default_factory=dict)
    copied: Path | None = None
    settings: Mapping[str, str] = field(default_factory=dict)
    is_session: bool = True
    example: str = ""
    is_of_plans: bool = False

    def prepare(self, folder: Path, tree: Path) -> Path:
        """Make the folder and what the command needs in it; return the folder in which it is to be given."""
        folder.mkdir(parents=True)
        if self.copied is not None:
            shutil.copytree(self.copied, folder / "out" / self.copied.name)
        for name, text in self.files.items():
            (folder / name).write_text(text, encoding="utf-8")
        if not self.example:
            return folder
        place = folder.parent / "examples" / self.example  # beside the case: its files are no output
        if not place.exists():
            shutil.copytree(tree / "examples" / self.example, place)
            _install(place)
        return place

    def command(self) -> list[str]:
        """Return the words behind ``bench``."""
        return [*self.words, *(word for item in self.settings.items() for word in ("--set", "=".join(item)))]


def _install(place: Path) -> None:
    """Write the metadata by which a distribution in a folder is found, if it is one."""
    if not (place / "pyproject.toml").is_file():
        return
    project = tomllib.loads((place / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    folder = place / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    folder.mkdir()
    head = f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    (folder / "METADATA").write_text(head, encoding="utf-8")
    groups = (
        "\n".join([f"[{group}]", *(f"{name} = {target}" for name, target in points.items())])
        for group, points in project["entry-points"].items()
    )
    (folder / "entry_points.txt").write_text("\n".join(groups) + "\n", encoding="utf-8")


@dataclass(frozen=True)
class ShortRun:
    """A shipped sequence, shortened by ``cuts`` (old text, new text) and by ``settings``."""

    name: str
    sequence: str
    cuts: tuple[Cut, ...] = ()
    settings: Mapping[str, str] = field(default_factory=dict)

    def of(self, tree: Path) -> Case:
        """Return the case that runs the sequence of a tree. Raises: ValueError for a cut that no longer fits."""
        file = f"{self.sequence}.yaml" if self.cuts else self.sequence
        words = ("run", file, "--clock", "virtual", "--seed", "1", "--out", "out", "--truth")
        return Case(self.name, words, {file: self._text(tree)} if self.cuts else {}, settings=self.settings)

    def _text(self, tree: Path) -> str:
        text = (tree / "sequences" / f"{self.sequence}.yaml").read_text(encoding="utf-8")
        for old, new in self.cuts:
            if old not in text:
                raise ValueError(f"{self.name}: {self.sequence}.yaml holds no {old!r}")
            text = text.replace(old, new)
        return text


_LISTS = tomllib.loads(Path(__file__).with_name("cases.toml").read_text(encoding="utf-8"))
RUNS = tuple(
    ShortRun(run["name"], run["sequence"], tuple(map(tuple, run.get("cuts", ()))), run.get("settings", {}))
    for run in _LISTS["run"]
)
LOGS: Mapping[str, tuple[str, str]] = {name: tuple(log) for name, log in _LISTS["logs"].items()}
MERGED = Case(  # reads two sessions of its own side
    "coefficients",
    (
        "coefficients", "../scale_factor/out/20000101T000000Z_scale_factor_short_SIM-1",
        "../bias_ramp/out/20000101T000000Z_bias_ramp_short_SIM-1", "--out", "out",
    ),
    is_session=False,
)  # fmt: skip
STUDY = Case(
    "study", ("study", "time_sync", "--quick", "--runs", "2", "--offsets", "0,10", "--out", "out"), is_session=False
)


def imports(mappings: Path, logs: Path) -> list[Case]:
    """Return a case for each recorded log that is on this machine."""
    return [
        Case(name, ("import", str(mappings / f"{mapping}.yaml"), str(logs / log), "--out", "out"))
        for name, (mapping, log) in LOGS.items()
        if (logs / log).is_file()
    ]


def resumptions(golden: Path) -> list[Case]:
    """Return a case for each stopped golden session: it goes on to its end."""
    return [
        Case(f"resume_{folder.parent.name}", ("resume", f"out/{folder.name}"), copied=folder)
        for folder in sorted(golden.glob("stopped/*/*"))
    ]


def golden_sessions(golden: Path) -> list[Case]:
    """Return two cases for each golden session: it is analysed, and a copy of it gets a report."""
    return [
        Case(f"{words[0]}_{folder.parent.name}_{folder.name.partition('_')[2]}",
             (words[0], f"out/{folder.name}", *words[1:]), copied=folder, is_session=False)
        for folder in sorted(golden.glob("sessions/*/*"))
        if folder.is_dir()
        for words in (("fit", "--json"), ("report",))
    ]  # fmt: skip


def checks(tree: Path) -> list[Case]:
    """Return a check of each sequence that a tree ships, and of each of its examples."""
    return [
        Case(f"check_{Path(name).stem}", ("check", name, "--json"), is_session=False, example=example)
        for example, names in sequences(tree).items()
        for name in names
    ]


def plans(tree: Path) -> list[Case]:
    """Return a case for the plans of all sequences that a tree ships, and one for those of each example."""
    return [
        Case(f"plans_{example or 'shipped'}", tuple(names), is_session=False, example=example, is_of_plans=True)
        for example, names in sequences(tree).items()
    ]


def sequences(tree: Path) -> dict[str, list[str]]:
    """Return all sequences of a tree by the example to which they belong, "" for those that are shipped.

    The shipped ones by their names, those of an example by their paths in its folder.
    """
    shipped = {"": [path.stem for path in sorted((tree / "sequences").glob("*.yaml"))]}
    examples: dict[str, list[str]] = {}
    for path in sorted(tree.glob("examples/*/sequences/*.yaml")):
        examples.setdefault(path.parents[1].name, []).append(f"sequences/{path.name}")
    return shipped | examples
