"""The wheel beside InstrumentKit, whose import name ``instruments`` is ours too: it works, or says so in one line.

Needs a package index; ``make sweep`` runs it.
"""

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from rehearsal import ROOT

pytestmark = pytest.mark.sweep

OTHER = "instrumentkit"
NOBODY = 1 << 22  # a number that no process has
COMMANDS = (
    ("check", "scale_factor_short"),
    ("run", "scale_factor_short", "--clock", "virtual", "--out", "sessions"),
    ("doctor",),
)


class Environment:
    """A virtual environment of its own with the locked requirements."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.python = folder / "venv" / "bin" / "python"
        subprocess.run([sys.executable, "-m", "venv", folder / "venv"], check=True)
        self.pip("install", "--require-hashes", "-r", str(ROOT / "requirements" / "run.txt"))
        self.pip("install", "setuptools>=77", "wheel")
        self.pip("wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", str(folder / "dist"), str(ROOT))
        (self.wheel,) = (folder / "dist").glob("*.whl")

    def pip(self, *words: str) -> None:
        """Run pip quietly."""
        quiet = ("--quiet", "--disable-pip-version-check", "--no-input")
        subprocess.run([self.python, "-m", "pip", *quiet, *words], check=True, cwd=self.folder)

    def install_ours(self) -> None:
        """Install the wheel, over one that is there already."""
        self.pip("install", "--no-deps", "--force-reinstall", str(self.wheel))

    def install_other(self) -> None:
        """Install the other distribution without what it requires: none of its code is to be executed."""
        self.pip("install", "--no-deps", "--force-reinstall", OTHER)

    def run(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Run the bench from an empty folder."""
        place = self.folder / "empty"
        place.mkdir(exist_ok=True)
        command = [self.python, "-m", "bench", *words]
        return subprocess.run(command, cwd=place, capture_output=True, text=True, check=False)

    def guard(self) -> subprocess.CompletedProcess[str]:
        """Start a guard as a run does, and say goodbye to it once it is ready; its controller is nobody."""
        address = {"role": "dmm", "driver": "hp_3458a", "resource": "GPIB0::1::INSTR", "options": {}}
        brief = {
            "pid": NOBODY, "visa": "@bench", "instruments": [address], "limits": {}, "silence_s": 60.0,
            "diary": str(self.folder / "diary"), "notify": [],
        }  # fmt: skip
        command = [self.python, "-m", "bench.run.guard"]
        pipe = subprocess.PIPE
        with subprocess.Popen(
            command, cwd=self.folder / "empty", stdin=pipe, stdout=pipe, stderr=pipe, text=True, bufsize=1
        ) as guard:
            assert guard.stdin is not None
            assert guard.stdout is not None
            assert guard.stderr is not None
            guard.stdin.write(json.dumps(brief) + "\n")
            said = guard.stdout.readline()
            if said:
                guard.stdin.write(json.dumps({"goodbye": True}) + "\n")
            status = guard.wait(60.0)
            return subprocess.CompletedProcess(command, status, said, guard.stderr.read())

    def works(self) -> None:
        """Assert that every command does its work."""
        for words in COMMANDS:
            done = self.run(*words)
            assert done.returncode == 0, (words, done.stderr)
        guarded = self.guard()
        assert (guarded.returncode, guarded.stdout.startswith("ready")) == (0, True), guarded.stderr

    def refuses(self, says: str) -> None:
        """Assert that every command ends with one line that names the distribution, and status 2."""
        for done in (*(self.run(*words) for words in COMMANDS), self.guard()):
            assert done.returncode == 2, (done.args, done.stderr)
            assert done.stderr.count("\n") == 1, done.stderr
            assert "B-PKG-003" in done.stderr
            assert says in done.stderr
            assert "Traceback" not in done.stderr


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Environment]:
    return Environment(tmp_path_factory.mktemp("foreign"))


def test_ours_last_works_until_the_other_is_removed(environment: Environment) -> None:
    environment.install_other()
    environment.install_ours()
    environment.works()
    environment.pip("uninstall", "--yes", OTHER)  # it takes its __init__.py away, which is ours by now
    environment.refuses("damaged")
    environment.install_ours()
    environment.works()


def test_the_other_last_is_refused_and_the_cure_helps(environment: Environment) -> None:
    environment.install_ours()
    environment.install_other()
    environment.refuses("is of instrumentkit, not of inertial-bench")
    environment.pip("uninstall", "--yes", OTHER)
    environment.refuses("damaged")
    environment.install_ours()
    environment.works()


def test_ours_removed_leaves_no_command(environment: Environment) -> None:
    environment.install_ours()
    environment.install_other()
    environment.pip("uninstall", "--yes", "inertial-bench")
    assert not (environment.python.parent / "bench").exists()
    done = environment.run("check", "scale_factor_short")
    assert done.returncode != 0
    assert "Traceback" not in done.stderr
