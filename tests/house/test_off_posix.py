"""What works on a machine without POSIX, and how the rest is refused; each process blocks what Windows lacks."""

import json
import os
import re
import signal
import subprocess
import sys
from http.client import HTTPConnection
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import pytest
from imported_logs import LOG, SHORT
from rehearsal import GOLDEN_SEQUENCE, ROOT

PROGRAM = [sys.executable, str(ROOT / "tests" / "support" / "off_posix.py")]
FRAMES = str(ROOT / "tests" / "golden" / "vn100_binary.hex")
SESSION = "20000101T000000Z_golden_GOLDEN"
Done = tuple[int, str, str]


def _environment(top: Path) -> dict[str, str]:
    names = ("LOGNAME", "USER", "LNAME", "USERNAME")  # nobody says who the user is
    kept = {name: value for name, value in os.environ.items() if name not in names}
    return {
        **kept,
        "XDG_CACHE_HOME": str(top / "cache"),
        "XDG_CONFIG_HOME": str(top / "config"),
        "PYTHONUNBUFFERED": "1",
    }


def _done(top: Path, commands: dict[str, list[str]]) -> dict[str, Done]:
    """Return exit status, output and errors of some commands, one behind the other in one process."""
    words = [*PROGRAM, "--all", json.dumps(list(commands.values()))]
    done = subprocess.run(words, capture_output=True, text=True, check=True, cwd=top, env=_environment(top))
    answers: list[list[Any]] = json.loads(done.stdout)
    return {name: (status, said, errors) for name, (status, said, errors) in zip(commands, answers, strict=True)}


@pytest.fixture(scope="module")
def top(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a capture, a log and its mapping."""
    folder = tmp_path_factory.mktemp("off_posix")
    (folder / "capture.bin").write_bytes(bytes.fromhex("".join(Path(FRAMES).read_text().split())))
    (folder / "log.csv").write_text(LOG)
    (folder / "mapping.yaml").write_text(SHORT)
    return folder


@pytest.fixture(scope="module")
def done(top: Path) -> dict[str, Done]:
    """Return how every command ended that works everywhere."""
    session = f"sessions/{SESSION}"
    return _done(
        top,
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
    here = top / "sessions" / SESSION
    segments = sorted(path.name for path in golden.glob("*.mcap"))
    assert segments
    assert [(here / name).read_bytes() for name in segments] == [(golden / name).read_bytes() for name in segments]
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
    for status, said, errors in _done(tmp_path, commands).values():
        assert (status, said) == (2, "")
        assert re.fullmatch(refused, errors)
    assert list(tmp_path.iterdir()) == []


def test_the_page_shows_a_recorded_session(done: dict[str, Done], top: Path) -> None:
    assert done["run"][0] == 0
    command = [*PROGRAM, "serve", "--port", "0"]
    quiet = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    with subprocess.Popen(command, cwd=top, env=_environment(top), **quiet) as server:  # type: ignore[call-overload]
        try:
            said = ""
            while "Ctrl-C" not in said and (line := server.stdout.readline()):
                said += line
            found = re.search(r"http://127.0.0.1:(\d+)/", said)
            assert found is not None, said
            token = said.partition("viewer token: ")[2].split()[0]
            connection = HTTPConnection("127.0.0.1", int(found[1]), timeout=20)
            cookie = _logged_in(connection, found[0].rstrip("/"), token)
            runs = json.loads(_page(connection, "/api/v1/runs", cookie))
            assert SESSION in json.dumps(runs)
            assert SESSION in _page(connection, f"/runs/{SESSION}", cookie)
            assert json.loads(_page(connection, f"/api/v1/runs/{SESSION}", cookie))["state"] == "ended"
            assert "<html" in _page(connection, f"/api/v1/runs/{SESSION}/report", cookie)
            connection.close()
            server.send_signal(signal.SIGINT)
            assert server.wait(20) == 0
        finally:
            server.kill()


def _logged_in(connection: HTTPConnection, origin: str, token: str) -> str:
    headers = {"Origin": origin, "Content-Type": "application/x-www-form-urlencoded"}
    connection.request("POST", "/login", urlencode({"name": "kim", "token": token}), headers)
    reply = connection.getresponse()
    assert reply.read() is not None
    return reply.getheader("set-cookie", "").partition(";")[0]


def _page(connection: HTTPConnection, path: str, cookie: str) -> str:
    connection.request("GET", path, headers={"Cookie": cookie})
    reply = connection.getresponse()
    text = reply.read().decode()
    assert reply.status == 200, text
    return text
