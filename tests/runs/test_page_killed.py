"""A page server that is killed while people watch: the run does not notice, down to its last byte.

The other run of this seed was watched by nobody, so the same seed gives the same bytes.
"""

import json
import subprocess
import sys
import time
from pathlib import Path
from subprocess import CompletedProcess

import pytest
from rehearsal import NAME, SEED, contents
from served import ServedPage
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

pytestmark = pytest.mark.waits

TRIES = 1_000


def watch(server: ServedPage) -> str:
    """Return the state that a page is told, once it has heard five batches of points of the living run."""
    place, head = f"ws://127.0.0.1:{server.port}/ws?run={NAME}", {"Cookie": server.cookie}
    for _ in range(TRIES):
        with connect(place, origin=server.origin, additional_headers=head, proxy=None, max_size=None) as page:  # type: ignore[arg-type]
            try:
                said = json.loads(page.recv(timeout=30))
                if said["state"]["source"] != "live":
                    continue  # it has just begun and does not answer yet
                for _ in range(5):
                    page.recv(timeout=30)
                return str(said["state"]["state"])
            except ConnectionClosed as closed:
                if closed.rcvd is None or closed.rcvd.code != 4404:  # there is no such run yet
                    raise
        time.sleep(0.05)
    raise AssertionError("the run was never seen")


@pytest.mark.sweep
def test_a_killed_page_server_leaves_the_run_as_it_is(
    short: tuple[Path, CompletedProcess[str]], tmp_path: Path
) -> None:
    unwatched, _ = short
    out = tmp_path / "out"
    out.mkdir()
    server = ServedPage(tmp_path, tmp_path / "config", "--out", str(out))
    words = ["run", "scale_factor_short", "--seed", str(SEED), "--out", str(out), "--truth"]
    command = [sys.executable, "-m", "bench", *words, "--set", "world.calibrator_gain=off"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stdin=subprocess.DEVNULL) as run:
        try:
            assert watch(server) in ("starting", "running")
        finally:
            server.kill()
        assert run.poll() is None, "the server was to be killed during the run"
        assert run.wait() == 0
    first, second = contents(unwatched), contents(out / NAME)
    assert {name for name in first if first[name] != second.get(name)} == set()
    assert first.keys() == second.keys()
    truth = [path.with_name(f"{NAME}.truth.json").read_bytes() for path in (unwatched, out / NAME)]
    assert truth[0] == truth[1]
