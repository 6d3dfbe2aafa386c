"""A page server that is killed while people watch: the run does not notice, down to its last byte.

The other run of this seed was watched by nobody, so the same seed gives the same bytes.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from http.client import HTTPConnection
from pathlib import Path
from subprocess import CompletedProcess

import pytest
from rehearsal import NAME, SEED, contents
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

pytestmark = pytest.mark.waits

TRIES = 1_000


def log_in(port: int, token: str) -> str:
    page = HTTPConnection("127.0.0.1", port, timeout=30)
    kind = {"Content-Type": "application/x-www-form-urlencoded", "Origin": f"http://127.0.0.1:{port}"}
    page.request("POST", "/login", f"name=kim&token={token}", kind)
    answer = page.getresponse()
    answer.read()
    page.close()
    return answer.getheader("set-cookie", "").partition(";")[0]


def watch(port: int, cookie: str) -> list[str]:
    """States of the run that a page is told, until it has heard five batches of points of the living run."""
    place, origin = f"ws://127.0.0.1:{port}/ws?run={NAME}", f"http://127.0.0.1:{port}"
    for _ in range(TRIES):
        with connect(place, origin=origin, additional_headers={"Cookie": cookie}, proxy=None, max_size=None) as page:  # type: ignore[arg-type]
            try:
                said = json.loads(page.recv(timeout=30))
                if said["state"]["source"] != "live":
                    continue  # it has just begun and does not answer yet
                for _ in range(5):
                    page.recv(timeout=30)
                return [said["state"]["state"]]
            except ConnectionClosed as closed:
                if closed.rcvd is None or closed.rcvd.code != 4404:  # there is no such run yet
                    raise
        time.sleep(0.05)
    raise AssertionError("the run was never seen")


@pytest.mark.slow
def test_a_killed_page_server_leaves_the_run_as_it_is(
    short: tuple[Path, CompletedProcess[str]], tmp_path: Path
) -> None:
    unwatched, _ = short
    environment = {**os.environ, "XDG_CONFIG_HOME": str(tmp_path / "config"), "PYTHONUNBUFFERED": "1"}
    bench = [sys.executable, "-m", "bench"]
    out = tmp_path / "out"
    out.mkdir()
    serve = [*bench, "serve", "--out", str(out), "--port", "0"]
    with subprocess.Popen(serve, stdout=subprocess.PIPE, text=True, env=environment) as server:
        assert server.stdout is not None
        said = "".join(line for line, _ in zip(server.stdout, range(4), strict=False))
        port, token = re.search(r":(\d+)/", said), re.search(r"viewer token: (\S+)", said)
        assert port is not None
        assert token is not None
        cookie = log_in(int(port[1]), token[1])
        words = [
            "run",
            "scale_factor_short",
            "--seed",
            str(SEED),
            "--out",
            str(out),
            "--set",
            "world.calibrator_gain=off",
            "--truth",
        ]
        with subprocess.Popen([*bench, *words], stdout=subprocess.DEVNULL, stdin=subprocess.DEVNULL) as run:
            seen = watch(int(port[1]), cookie)
            server.kill()
            assert run.poll() is None, "the server was to be killed during the run"
            assert run.wait() == 0
    assert seen[0] in ("starting", "running")
    first, second = contents(unwatched), contents(out / NAME)
    assert {name for name in first if first[name] != second.get(name)} == set()
    assert first.keys() == second.keys()
    truth = [path.with_name(f"{NAME}.truth.json").read_bytes() for path in (unwatched, out / NAME)]
    assert truth[0] == truth[1]
