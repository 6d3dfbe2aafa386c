"""What is run in both revisions: every analysis on a session as small as it allows, and every shipped sequence checked.

Nothing here names a module of the product: commands, sequences and mappings only.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

Cut = tuple[str, str]


@dataclass(frozen=True)
class Case:
    """One command, given in an empty folder of its own on both sides.

    ``sequence``: shipped sequence that is shortened by ``cuts`` (old, new) and written beside, else "".
    ``copied``: folder that is there when the command begins.   ``is_session``: it leaves one that can be replayed.
    """

    name: str
    words: tuple[str, ...]
    sequence: str = ""
    cuts: tuple[Cut, ...] = ()
    copied: Path | None = None
    settings: dict[str, str] = field(default_factory=dict)
    is_session: bool = True

    def prepare(self, folder: Path, base: Path) -> None:
        """Make the folder and what the command needs in it. Raises: ValueError for a cut that no longer fits."""
        folder.mkdir(parents=True)
        if self.copied is not None:
            shutil.copytree(self.copied, folder / "out" / self.copied.name)
        if self.sequence:
            text = (base / "sequences" / f"{self.sequence}.yaml").read_text(encoding="utf-8")
            for old, new in self.cuts:
                if old not in text:
                    raise ValueError(f"{self.name}: {self.sequence}.yaml holds no {old!r}")
                text = text.replace(old, new)
            (folder / f"{self.sequence}.yaml").write_text(text, encoding="utf-8")

    def command(self) -> list[str]:
        """Return the words behind ``bench``."""
        return [*self.words, *(word for item in self.settings.items() for word in ("--set", "=".join(item)))]


def _run(name: str, sequence: str, *, cuts: Sequence[Cut] = (), settings: dict[str, str] | None = None) -> Case:
    file = f"{sequence}.yaml" if cuts else sequence
    words = ("run", file, "--clock", "virtual", "--seed", "1", "--out", "out", "--truth")
    return Case(name, words, sequence if cuts else "", tuple(cuts), settings=settings or {})


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


def checks(base: Path) -> list[Case]:
    """Return a check of each sequence that the base ships."""
    return [
        Case(f"check_{path.stem}", ("check", path.stem, "--json"), is_session=False)
        for path in sorted((base / "sequences").glob("*.yaml"))
    ]
