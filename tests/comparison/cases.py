"""What is run in both revisions: every analysis on a session as small as it allows, and every sequence checked.

Nothing here names a module of the product: commands, sequences and mappings only.
"""

from __future__ import annotations

import shutil
import tomllib
from collections.abc import Mapping, Sequence
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


def _run(name: str, sequence: str, *, cuts: Sequence[Cut] = (), settings: dict[str, str] | None = None) -> ShortRun:
    return ShortRun(name, sequence, tuple(cuts), settings or {})


SHORT_SCALE_FACTOR = [("10350 s", "9450 s"), ("records: 105", "records: 75"), ("[1, 2], kind", "1, kind")]
SHORT_BIAS_RAMP = [
    ("duration: 3 h", "duration: 2700 s"), ("records: 540", "records: 135"), ("windows: 60", "windows: 15"),
    ("windows: 120", "windows: 30"), ("cold: 5 degC", "cold: 15 degC"), ("hot: 45 degC", "hot: 25 degC"),
    ("slot: 7200 s", "slot: 2400 s"), ("slot: 2700 s", "slot: 1200 s"),
]  # fmt: skip
SHORT_DMM = [
    ("duration: 32050 s", "duration: 4330 s"), ("records: 170", "records: 34"), ("1-6, kind", "1, kind"),
    ("7-10, kind", "7, kind"), ("dwell: 100 s", "dwell: 10 s"), ("slot: 9000 s", "slot: 2700 s"),
    ("stable_for: 10 min", "stable_for: 5 min"),
]  # fmt: skip
SHORT_FOG = {
    "warm_up": "30 s", "time_constant": "300 ms", "settle": "6 s", "record_time": "1 s", "calibration": "1",
    "repeats": "1", "heads": "90 deg", "search": "1",
}  # fmt: skip

RUNS = (
    _run("scale_factor", "scale_factor_short", cuts=SHORT_SCALE_FACTOR),
    _run("bias_ramp", "bias_ramp_short", cuts=SHORT_BIAS_RAMP),
    _run("dmm_method", "dmm_method", cuts=SHORT_DMM),
    _run("gnc_unit_test", "gnc_unit_test", settings={"units": "GNC-01"}),
    _run(
        "imu_calibration", "gnc_imu_calibration",
        settings={"warm_up": "1 s", "position": "5 s", "check_position": "3 s"},
    ),
    _run(
        "imu_bias", "gnc_bias",
        settings={
            "warm_up": "1 s", "bias_time": "20 s", "stability_time": "200 s", "repeat_time": "20 s",
            "repeat_gap": "1 s",
        },
    ),
    _run(
        "magnetometer", "gnc_magnetometer",
        settings={"warm_up": "2 s", "record_time": "30 s", "attitude_time": "25 s"},
    ),
    _run("fog_north", "fog_north", settings=SHORT_FOG),
    _run(
        "rlg_lock_in", "rlg_lock_in",
        settings={"warm_up": "5 s", "record_time": "2 s", "paths": "15 cm", "clocks": "20 MHz"},
    ),
    _run(
        "time_sync", "time_sync_turn",
        settings={"warm_up": "12 s", "straight": "5 s", "manoeuvre": "6 s", "rate": "15 deg/s"},
    ),
)  # fmt: skip

LOGS = {
    "temperature_ramp": ("tckit_1v_ramp", "tckit/hp3458abx_hp34420a_tcsweep_1vdc_nplc100_test2_oct2024.dsv"),
    "imu_six_position": ("imucal_six_position", "imucal/imucal_example_ferraris_session.csv"),
    "imu_multi_position": ("imu_tk_xsens", "imu_tk/xsens_acc.mat"),
    "imu_strapdown": ("imucal_strapdown", "imucal/imucal_example_ferraris_session.csv"),
}
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
