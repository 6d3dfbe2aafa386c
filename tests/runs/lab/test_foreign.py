"""A distribution of strangers, broken in each way: who is named, where, how the bench is left, what is left to do."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from own_lab import ANALYSIS, DRIVER, NAME, SIMULATOR, copied
from rehearsal import Inside

from bench.commands.doctor import _installed
from bench.model import drivers, installed, systems
from bench.plan import station

CACHES = (
    installed.offers, installed.checked_package, installed._examined_packages,  systems._own,
    systems._foreign, drivers._class_of, drivers._manual_of, station._declared,
)  # fmt: skip
OFFERS = """\
[inertial_bench.systems]
air = stranger_air
[inertial_bench.worlds]
room = stranger_room
[inertial_bench.instruments]
stranger = stranger_drivers
"""
DECLARATION = """\
from bench.model.declaration import AnalysisDeclaration, System

DECLARATION = System("air", (AnalysisDeclaration(
    "air_mean", "stranger_air.analysis", ("mean",), "readings", ("place",), assumptions="stranger_air.taken:granted",
),))
"""
WORLD = """\
from sim_instruments.worlds.af_converter.world import WORLD as RACK


class Room(RACK):
    def __init__(self, **made):
        super().__init__(**made)

    def truth(self, windows):
        return super().truth(windows)


WORLD = Room
"""
MARK = '"""A stranger\'s."""\n\n__bench__ = "stranger"\n'
AIR, ROOM, T100, MODEL = "stranger_air/analysis.py", "stranger_room/world.py", "stranger_drivers/example_t100.py", \
    "stranger_sim/example_t100.py"  # fmt: skip
DECLARED, TAKEN, OPTIONS = "stranger_air/declaration.py", "stranger_air/taken.py", "stranger_room/options.py"
FAILED = "failed: ZeroDivisionError: division by zero"
WHOLE = (
    f"The bench is safe. Every step was done; the session out/{NAME} is whole: once that is mended, 'bench fit' "
    "computes its results and 'bench resume' writes them"
)
NOTHING = "Nothing was sent to the bench, and no session was begun."
BEGUN, ALL = (f"The bench is safe; {records} of 2 records are in out/{NAME}" for records in (0, 2))


@pytest.fixture
def stranger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Yield the folder of the distribution: the example of a lab folder as packages; its sequence names them."""
    lab = copied(tmp_path / "lab").resolve()
    analysis = (lab / ANALYSIS).read_text()
    files = {
        "stranger-1.0.dist-info/METADATA": "Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n",
        "stranger-1.0.dist-info/entry_points.txt": OFFERS,
        "stranger_air/__init__.py": "",
        AIR: analysis[: analysis.index("DECLARATION")] + analysis[analysis.index("def analyse") :],
        DECLARED: DECLARATION,
        TAKEN: "def granted(campaign):\n    return []\n",
        "stranger_room/__init__.py": "",
        ROOM: WORLD,
        OPTIONS: "from sim_instruments.worlds.af_converter.options import NUMBERS, OPTIONS, TEXTS\n",
        "stranger_drivers/__init__.py": f'{MARK}__simulators__ = "stranger_sim"\n',
        T100: (lab / DRIVER).read_text(),
        "stranger_sim/__init__.py": MARK,
        MODEL: (lab / SIMULATOR).read_text(),
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    for name in (ANALYSIS, DRIVER, SIMULATOR):
        (lab / name).unlink()
    station = lab / "stations" / "t100_bench.yaml"
    station.write_text(station.read_text().replace("af_converter", "room"))
    monkeypatch.syspath_prepend(tmp_path)
    for fresh in (1, 2):
        for cached in CACHES:
            cached.cache_clear()
        for name in [name for name in sys.modules if name.startswith("stranger_")]:
            del sys.modules[name]
        if fresh == 1:
            yield tmp_path


def broken(folder: Path, file: str, old: str, new: str) -> str:
    """Put a mistake into a file, at its end or in place of something; returns file and line of it."""
    text = (folder / file).read_text()
    assert old in text
    head = text.partition(old)[0] if old else text
    (folder / file).write_text(text.replace(old, new, 1) if old else text + new)
    return f"{folder / file}:{head.count(chr(10)) + new.rstrip(chr(10)).count(chr(10)) + 1}"


PARTS = {AIR: "analyse", TAKEN: "granted", T100: "DRIVER", MODEL: "SIMULATOR", ROOM: "WORLD", OPTIONS: "NUMBERS"}


@pytest.mark.parametrize(
    ("mistake", "file", "name"),
    [
        *((mistake, file, name) for mistake in ("import no\n", "del ") for file, name in PARTS.items()),
        ("_", DECLARED, "stranger_air.analysis"),
    ],
)
def test_what_cannot_be_loaded_is_told_before_the_run(
    stranger: Path, inside: Inside, mistake: str, file: str, name: str
) -> None:
    """Import errors of every kind of part; a name that is misspelt in the declaration or not there in the part."""
    module = f"{file.removesuffix('.py').replace('/', '.')} of stranger 1.0"
    if mistake == "import no\n":
        place, says = broken(stranger, file, "", mistake), "cannot be loaded: ModuleNotFoundError: No module named 'no'"
    elif mistake == "del ":
        broken(stranger, file, "", f"del {name}\n")
        place, says = str(stranger / file), "names no class as DRIVER" if name == "DRIVER" else f"holds no {name}"
    else:
        place, says = broken(stranger, file, f'{name}"', f'{name}_"'), f"names {name}_, which is not there"
    lab = stranger / "lab"
    for words in (("check", "air_mean"), ("run", "air_mean", "--out", "out")):
        done = inside(*words, cwd=lab)
        assert (done.returncode, done.stderr.count("\n")) == (2, 1)
        assert done.stderr.startswith(f"error B-PKG-004: {place}: ")
        assert f"{module} {says}. Next: mend stranger, " in done.stderr
    assert not (lab / "out").exists()
    (told,) = [finding.text for finding in _installed() if finding.value.endswith("B-PKG-004")]
    assert f"{place}: {module} " in told
    assert inside("check", "timeline_example", cwd=lab).returncode == 0


@pytest.mark.parametrize(
    ("file", "old", "new", "says", "status", "left"),
    [
        (AIR, "check_method(method", "1 / 0; check_method(method", FAILED, 1, WHOLE),
        (AIR, "check_method(method", "raise SystemExit(0); check_method(method", "failed: SystemExit: 0", 1, WHOLE),
        (T100, "self.switch_output_on()", "1 / 0", FAILED, 3, BEGUN),
        (T100, "self.switch_output_on()", "raise SystemExit(0)", "failed: SystemExit: 0", 3, BEGUN),
        (T100, "    identity_p", "    def identify(self):\n        1 / 0\n\n    identity_p", FAILED, 2,
         "The bench is safe, and no session was begun."),
        (T100, "    identity_p", "    def __init__(self, *a, **b):\n        1 / 0\n\n    identity_p", FAILED, 2,
         NOTHING),
        (T100, "    identity_p", "    def make_safe(self):\n        1 / 0\n\n    identity_p", FAILED, 3,
         "error B-RUN-060: thermometer: not confirmed safe, unreachable"),
        (MODEL, "        super()", "        1 / 0; super()", FAILED, 2, NOTHING),
        (MODEL, "        if not self.on", "        1 / 0\n        if not self.on", FAILED, 3, BEGUN),
        (ROOM, "        super().__init__", "        1 / 0; super().__init__", FAILED, 2, NOTHING),
        (ROOM, "        return super().t", "        1 / 0; super().t", FAILED, 3, ALL),
    ],
)  # fmt: skip
def test_what_fails_in_a_run_is_told_with_how_the_bench_is_left(
    stranger: Path, inside: Inside, file: str, old: str, new: str, says: str, status: int, left: str
) -> None:
    sound, lab = (stranger / file).read_text(), stranger / "lab"
    broken(stranger, file, old, new)
    lines = (stranger / file).read_text().splitlines()
    line = next(n for n, text in enumerate(lines, 1) if "1 / 0" in text or "SystemExit" in text)
    assert inside("check", "air_mean", cwd=lab).returncode == 0
    done = inside("run", "air_mean", "--out", "out", cwd=lab)
    module = f"{file.removesuffix('.py').replace('/', '.')} of stranger 1.0"
    assert done.returncode == status, done.stderr
    assert f"error B-PKG-006: {stranger / file}:{line}: {module} {says}. Next: mend stranger, " in done.stderr
    assert left in " ".join((done.stdout + done.stderr).split())
    if left in (WHOLE, ALL):
        (stranger / file).write_text(sound)
        for name in [name for name in sys.modules if name.startswith("stranger_")]:
            del sys.modules[name]
        assert inside("resume", f"out/{NAME}", cwd=lab).returncode == 0
        assert (lab / "out" / NAME / "results.json").is_file()
