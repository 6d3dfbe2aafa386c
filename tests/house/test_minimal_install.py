"""What works on a machine without POSIX, or after a bare ``pip install inertial-bench``; how the rest is refused.

Each process blocks what Windows lacks, or every package of an extra.
"""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import httpx
import pytest
from imported_logs import LOG, SHORT
from minimal_install import PROJECT, closure, normal
from packaging.requirements import Requirement
from record_sample import golden_bytes
from rehearsal import GOLDEN_SEQUENCE, ROOT

from bench.model.extras import EXTRAS

OFF_POSIX = [sys.executable, str(ROOT / "tests" / "support" / "off_posix.py")]
MINIMAL = [sys.executable, str(ROOT / "tests" / "support" / "minimal_install.py")]
SESSION = "20000101T000000Z_golden_GOLDEN"
Done = tuple[int, str, str]


def _environment(top: Path) -> dict[str, str]:
    names = ("LOGNAME", "USER", "LNAME", "USERNAME", "BENCH_HISTORY")  # nobody says who the user is
    kept = {name: value for name, value in os.environ.items() if name not in names}
    return {
        **kept,
        "XDG_CACHE_HOME": str(top / "cache"),
        "XDG_CONFIG_HOME": str(top / "config"),
        "PYTHONUNBUFFERED": "1",
    }


def _done(top: Path, program: list[str], commands: dict[str, list[str]]) -> dict[str, Done]:
    """Return exit status, output and errors of some commands, one behind the other in one process."""
    words = [*program, json.dumps(list(commands.values()))]
    done = subprocess.run(words, capture_output=True, text=True, check=True, cwd=top, env=_environment(top))
    return dict(zip(commands, map(tuple, json.loads(done.stdout)), strict=True))


def segments(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.glob("*.mcap")}


def captured_in(folder: Path) -> Path:
    (folder / "capture.bin").write_bytes(golden_bytes("vn100_binary"))
    return folder


@pytest.fixture(scope="module")
def top(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a capture, a log and its mapping."""
    folder = captured_in(tmp_path_factory.mktemp("off_posix"))
    (folder / "log.csv").write_text(LOG)
    (folder / "mapping.yaml").write_text(SHORT)
    return folder


@pytest.fixture(scope="module")
def done(top: Path) -> dict[str, Done]:
    """Return how every command ended that works everywhere."""
    session = f"sessions/{SESSION}"
    return _done(
        top,
        [*OFF_POSIX, "--all"],
        {
            "check": ["check", "timeline_example"],
            "run": ["run", GOLDEN_SEQUENCE, "--clock", "virtual", "--seed", "3"],
            "replay": ["replay", session],
            "fit": ["fit", session, "--json"],
            "report": ["report", session],
            "verify": ["report", session, "--verify"],
            "recover": ["recover", session],
            "decode": ["decode", "vn100_binary", "capture.bin", "--csv", "fields.csv"],
            "import": ["import", "mapping.yaml", "log.csv"],
            "list": ["history", "list", "--json"],
            "export": ["history", "export", "history.csv"],
            "tables": ["export", session, "--to", "csv", "--out", "tables"],
            "init": ["init", "our_lab", "--name", "Ours"],
            "names": ["list"],
            "talk": ["talk", "calibrator", "*IDN?"],
            "pause": ["pause", session],
            "doctor": ["doctor"],
        },
    )


def test_what_records_reads_and_computes_works(done: dict[str, Done], top: Path) -> None:
    for name, (status, said, errors) in done.items():
        if name not in ("pause", "doctor"):
            assert (status, "error B-" in errors, bool(said)) == (0, False, True), (name, errors)
    for name in ("fields.csv", "history.csv"):
        assert (top / name).read_text().count("\n") > 1
    assert json.loads(done["fit"][1])["estimates"]
    assert json.loads(done["list"][1])
    assert list((top / "sessions").glob("*_any_log_S-1/session.0001.mcap"))


def test_a_rehearsal_is_the_same_byte_for_byte(done: dict[str, Done], top: Path, golden: Path) -> None:
    assert segments(top / "sessions" / SESSION) == segments(golden)
    assert "identical" in done["replay"][1] + done["replay"][2]


def test_nobody_can_be_asked_where_no_run_is_alive(done: dict[str, Done]) -> None:
    status, _, errors = done["pause"]
    assert status == 2
    assert "error B-CTRL-001: " in errors
    assert done["doctor"][0] in (0, 2)  # whether the machine is fit for a run, which it says
    assert "B-INT-001" not in done["doctor"][2]


def test_real_time_is_refused_in_one_line(tmp_path: Path) -> None:
    run = ["run", "timeline_example", "--clock", "wall"]
    commands = {"run": run, "json": [*run, "--json"], "sim": ["sim", "af_rack_sim"]}
    refused = r"error B-SYS-001: system: [^\n]* needs Linux; this system has no fcntl, [^\n]*\n"
    for status, said, errors in _done(tmp_path, [*OFF_POSIX, "--all"], commands).values():
        assert (status, said) == (2, "")
        assert re.fullmatch(refused, errors)
    assert list(tmp_path.iterdir()) == []


def test_the_page_shows_a_recorded_session(done: dict[str, Done], top: Path) -> None:
    assert done["run"][0] == 0
    command = [*OFF_POSIX, "serve", "--port", "0"]
    quiet = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    with subprocess.Popen(command, cwd=top, env=_environment(top), **quiet) as server:  # type: ignore[call-overload]
        try:
            said = ""
            while "Ctrl-C" not in said and (line := server.stdout.readline()):
                said += line
            found = re.search(r"http://127.0.0.1:\d+", said)
            assert found is not None, said
            form = {"name": "kim", "token": said.partition("viewer token: ")[2].split()[0]}
            with httpx.Client(base_url=found[0], headers={"Origin": found[0]}, timeout=20) as page:
                assert page.post("/login", data=form).status_code == 303
                assert SESSION in page.get("/api/v1/runs").text
                assert SESSION in page.get(f"/runs/{SESSION}").text
                assert page.get(f"/api/v1/runs/{SESSION}").json()["state"] == "ended"
                assert "<html" in page.get(f"/api/v1/runs/{SESSION}/report").text
            server.send_signal(signal.SIGINT)
            assert server.wait(20) == 0
        finally:
            server.kill()


MOST_PACKAGES = 30
COMMANDS = {
    "version": ["--version"],
    "check": ["check", "timeline_example"],
    "run": ["run", GOLDEN_SEQUENCE, "--clock", "virtual", "--seed", "3"],
    "replay": ["replay", f"sessions/{SESSION}"],
    "fit": ["fit", f"sessions/{SESSION}", "--json"],
    "verify": ["report", f"sessions/{SESSION}", "--verify"],
    "verify_report": ["report", "reported", "--verify"],
    "recover": ["recover", f"sessions/{SESSION}"],
    "decode": ["decode", "vn100_binary", "capture.bin", "--csv", "fields.csv"],
    "certificate": ["certificate", f"sessions/{SESSION}", "--specimen"],
    "batch": ["batch", "sessions", "--out", "batch"],
}
ASKED = {
    "report": ["report", f"sessions/{SESSION}"],
    "pdf": ["report", f"sessions/{SESSION}", "--pdf"],
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


@pytest.fixture(scope="module")
def bare_top(tmp_path_factory: pytest.TempPathFactory, golden: Path) -> Path:
    """Return a folder with a capture, and a session that has its report."""
    folder = tmp_path_factory.mktemp("minimal")
    shutil.copytree(golden, folder / "reported")
    return captured_in(folder)


@pytest.fixture(scope="module")
def bare(bare_top: Path) -> dict[str, Done]:
    """Return how every command ended without any extra."""
    return _done(bare_top, MINIMAL, COMMANDS | ASKED)


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


def test_what_needs_no_extra_works(bare: dict[str, Done]) -> None:
    for command in COMMANDS.keys() - {"run", "verify_report", "batch"}:
        status, said, errors = bare[command]
        assert (status, "error B-" in errors, bool(said)) == (0, False, True), (command, errors)


def test_a_run_is_judged_and_each_missing_extra_is_one_line(
    bare: dict[str, Done], bare_top: Path, golden: Path
) -> None:
    status, _, errors = bare["run"]
    assert status == 0
    told = [line for line in errors.splitlines() if "B-PKG-005" in line]
    assert [re.findall(r"inertial-bench\[\w+\]", line) for line in told] == [
        ["inertial-bench[report]"],
        ["inertial-bench[history]"],
    ]
    assert "Traceback" not in errors
    assert segments(bare_top / "sessions" / SESSION) == segments(golden)
    assert (bare_top / "sessions" / SESSION / "results.json").read_bytes() == (golden / "results.json").read_bytes()
    assert not (bare_top / "sessions" / SESSION / "report.html").exists()
    assert "identical" in bare["verify"][1]


def test_a_report_that_cannot_be_drawn_is_not_compared(bare: dict[str, Done]) -> None:
    status, said, _ = bare["verify_report"]
    assert status == 0
    assert re.search(r"note: report\.html is not compared: error B-PKG-005: [^\n]*inertial-bench\[report\]", said)
    assert re.search(r"identical: [^\n]*results\.json", said)
    assert "report.html" not in said.partition("identical:")[2]


def test_a_batch_is_counted_without_its_page(bare: dict[str, Done], bare_top: Path) -> None:
    status, _, errors = bare["batch"]
    assert status == 0
    assert errors.count("B-PKG-005") == 1
    assert (bare_top / "batch" / "batch.json").is_file()


def test_an_extra_that_is_asked_for_is_named(bare: dict[str, Done]) -> None:
    line = r"error B-PKG-005: [^\n]* is not installed\. Next: pip install 'inertial-bench\[(\w+)\]'\n"
    for command, extra in EXTRA_OF.items():
        status, said, errors = bare[command]
        assert (status, said) == (2, ""), command
        found = re.fullmatch(line, errors)
        assert (found and found[1]) == extra, errors
