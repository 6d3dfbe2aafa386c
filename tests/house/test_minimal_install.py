"""What ``pip install inertial-bench`` does without any extra, and how an extra that is missing is named."""

import json
import os
import re
import shutil
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest
from minimal_install import PROJECT, closure, normal
from packaging.requirements import Requirement
from rehearsal import GOLDEN_SEQUENCE, ROOT

from bench.model.extras import EXTRAS

PROGRAM = [sys.executable, str(ROOT / "tests" / "support" / "minimal_install.py")]
SESSION = "sessions/20000101T000000Z_golden_GOLDEN"
MOST_PACKAGES = 30
COMMANDS = {
    "version": ["--version"],
    "check": ["check", "timeline_example"],
    "run": ["run", GOLDEN_SEQUENCE, "--clock", "virtual", "--seed", "3"],
    "replay": ["replay", SESSION],
    "fit": ["fit", SESSION, "--json"],
    "verify": ["report", SESSION, "--verify"],
    "verify_report": ["report", "reported", "--verify"],
    "recover": ["recover", SESSION],
    "decode": ["decode", "vn100_binary", "capture.bin", "--csv", "fields.csv"],
    "certificate": ["certificate", SESSION, "--specimen"],
    "batch": ["batch", "sessions", "--out", "batch"],
}
ASKED = {
    "report": ["report", SESSION],
    "pdf": ["report", SESSION, "--pdf"],
    "plot": ["check", "timeline_example", "--plot", "timetable.svg"],
    "serve": ["serve"],
    "top": ["top"],
    "history": ["history", "list"],
}
EXTRA_OF = dict.fromkeys(("report", "pdf", "plot"), "report") | {
    "serve": "page",
    "top": "terminal",
    "history": "history",
}
Done = tuple[int, str, str]


@pytest.fixture(scope="module")
def top(tmp_path_factory: pytest.TempPathFactory, golden: Path) -> Path:
    """Return a folder with a capture, and a session that has its report."""
    folder = tmp_path_factory.mktemp("minimal")
    capture = (ROOT / "tests" / "golden" / "vn100_binary.hex").read_text(encoding="utf-8")
    shutil.copytree(golden, folder / "reported")
    (folder / "capture.bin").write_bytes(bytes.fromhex("".join(capture.split())))
    return folder


@pytest.fixture(scope="module")
def done(top: Path) -> dict[str, Done]:
    """Return how every command ended, one behind the other in one process."""
    kept = {name: value for name, value in os.environ.items() if name != "BENCH_HISTORY"}
    places = {"XDG_CACHE_HOME": str(top / "cache"), "XDG_CONFIG_HOME": str(top / "config")}
    commands = COMMANDS | ASKED
    program = subprocess.run(
        [*PROGRAM, json.dumps(list(commands.values()))],
        capture_output=True, text=True, check=True, cwd=top, env={**kept, **places},
    )  # fmt: skip
    return dict(zip(commands, map(tuple, json.loads(program.stdout)), strict=True))


def test_the_minimal_install_has_at_most_thirty_packages() -> None:
    assert len(closure(PROJECT["dependencies"])) + len({PROJECT["name"], "pip"}) <= MOST_PACKAGES


def test_all_has_every_extra_of_a_bench() -> None:
    extras = PROJECT["optional-dependencies"]
    [everything] = map(Requirement, extras["all"])
    assert everything.extras == set(extras) - {"all", "dev", "docs", "peers", "benchmark", "mutation"}


def test_every_package_of_an_extra_is_named_with_it() -> None:
    extras = PROJECT["optional-dependencies"]
    distributions = metadata.packages_distributions()
    for package, extra in EXTRAS.items():
        named = {normal(Requirement(text).name) for text in extras[extra.name]}
        assert {normal(name) for name in distributions[package]} & named, package


def test_what_needs_no_extra_works(done: dict[str, Done]) -> None:
    for command in COMMANDS.keys() - {"run", "verify_report", "batch"}:
        status, said, errors = done[command]
        assert (status, "error B-" in errors, bool(said)) == (0, False, True), (command, errors)


def test_a_run_is_judged_and_each_missing_extra_is_one_line(done: dict[str, Done], top: Path, golden: Path) -> None:
    status, _, errors = done["run"]
    assert status == 0
    told = [line for line in errors.splitlines() if "B-PKG-005" in line]
    assert [re.findall(r"inertial-bench\[\w+\]", line) for line in told] == [
        ["inertial-bench[report]"],
        ["inertial-bench[history]"],
    ]
    assert "Traceback" not in errors
    segments = sorted(path.name for path in golden.glob("*.mcap"))
    assert [(top / SESSION / name).read_bytes() for name in segments] == [
        (golden / name).read_bytes() for name in segments
    ]
    assert (top / SESSION / "results.json").read_bytes() == (golden / "results.json").read_bytes()
    assert not (top / SESSION / "report.html").exists()
    assert "identical" in done["verify"][1]


def test_a_report_that_cannot_be_drawn_is_not_compared(done: dict[str, Done]) -> None:
    status, said, _ = done["verify_report"]
    assert status == 0
    assert re.search(r"note: report\.html is not compared: error B-PKG-005: [^\n]*inertial-bench\[report\]", said)
    assert re.search(r"identical: [^\n]*results\.json", said)
    assert "report.html" not in said.partition("identical:")[2]


def test_a_batch_is_counted_without_its_page(done: dict[str, Done], top: Path) -> None:
    status, _, errors = done["batch"]
    assert status == 0
    assert errors.count("B-PKG-005") == 1
    assert (top / "batch" / "batch.json").is_file()


def test_an_extra_that_is_asked_for_is_named(done: dict[str, Done]) -> None:
    line = r"error B-PKG-005: [^\n]* is not installed\. Next: pip install 'inertial-bench\[(\w+)\]'\n"
    for command, extra in EXTRA_OF.items():
        status, said, errors = done[command]
        assert (status, said) == (2, ""), command
        found = re.fullmatch(line, errors)
        assert (found and found[1]) == extra, errors
