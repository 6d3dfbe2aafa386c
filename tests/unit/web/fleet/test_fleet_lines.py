"""A fleet page and real servers of benches: what each says, and why one is unknown."""

from __future__ import annotations

import asyncio
import json
import logging
import shutil
import ssl
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import pytest
from shown_run import LIVING, ShownRun, state_of
from web_rig import Page, served
from websockets.sync.client import connect

from bench.model.clock import WallClock
from bench.web.fleet.app import create_fleet_app
from bench.web.fleet.fleet_file import FleetBench
from bench.web.fleet.line import ServerLine
from bench.web.fleet.seat import Seat
from bench.web.security.gate import OVERVIEW
from bench.web.security.tokens import OPERATOR, VIEWER

pytestmark = pytest.mark.waits

NAME = "20260101T000000Z_shown_7"
WAIT_S = 10.0
CLOCK = WallClock()


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Page]:
    with served(tmp_path / "bench") as page:
        yield page


def entry(url: str, token: str, name: str = "bench-1") -> FleetBench:
    return FleetBench(name, "room 1", f"fleet.yaml:2:5 {name}", url, token)


@contextmanager
def fleet_of(folder: Path, *benches: FleetBench) -> Iterator[Page]:
    with served(folder / "fleet", make=lambda serving: create_fleet_app(serving, benches)) as page:
        yield page


def cards(page: Page, are: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """What a page of the fleet is sent, as soon as it is so."""
    address = f"ws://127.0.0.1:{page.port}/ws"
    with connect(address, origin=page.origin, additional_headers=page.cookie(VIEWER), proxy=None) as viewer:  # type: ignore[arg-type]
        until_ns, found = CLOCK.now_ns() + round(WAIT_S * 1e9), {}
        while CLOCK.now_ns() < until_ns:
            message = viewer.recv(timeout=WAIT_S)
            said = json.loads(message) if isinstance(message, str) else {}
            if said.get("type") == "snapshot":
                found = said["state"]["benches"]
            elif said.get("type") == "delta":
                for name, patch in said["patch"]["benches"].items():
                    left = {key: value for key, value in {**found[name], **patch}.items() if value is not None}
                    found = {**found, name: left}
            if found and are(found):
                return found
    raise AssertionError(found)


def is_state(state: str, name: str = "bench-1", **more: Any) -> Callable[[dict[str, Any]], bool]:
    wanted = {"state": state, **more}
    return lambda found: {key: found[name].get(key) for key in wanted} == wanted


def test_a_bench_is_shown_as_its_own_first_page_shows_it(tmp_path: Path, bench: Page) -> None:
    run = ShownRun(bench.serving.out, NAME)
    run.state.update(state_of(LIVING["door"]))
    (row,) = (row for row in bench.ask("GET", "/api/v1/runs", bench.cookie(VIEWER)).json["runs"] if row["run"] == NAME)
    now = row["now"]
    with fleet_of(tmp_path, entry(bench.origin, bench.clear[VIEWER])) as page:
        card = cards(page, is_state(row["state"]))["bench-1"]
        assert (card["state"], card["attention"]) == ("holding", "much")
        assert card["attention"] == now["attention"]
        assert card["outputs"] == now["bench"]["state"] == "energised"
        assert (card["waits"], card["alarm_count"]) == (now["wait"]["reason"], now["alarm_count"])
        assert [alarm["text"] for alarm in card["alarms"]] == [alarm["text"] for alarm in now["alarms"]]
        assert card["progress"] == pytest.approx(now["progress"], abs=0.001)
        assert card["end_utc_s"] == pytest.approx(now["eta"]["likely_utc_s"], abs=40)
        assert (card["run"], card["title"], card["uut"]) == (NAME, run.state["title"], run.state["uut"])
        run.state.update({"state": "running", "alarms": [], "holds": {}, "attention": "none"})
        assert cards(page, is_state("running", attention="none"))["bench-1"].get("alarm_count") == 0
        run.close()
        lost = cards(page, is_state("stopped"))["bench-1"]
        assert (lost["attention"], lost["outputs"], lost.get("progress")) == ("much", "unknown", None)


def test_a_folder_on_this_machine_and_one_that_is_taken_away(tmp_path: Path) -> None:
    out = tmp_path / "sessions"
    out.mkdir()
    run = ShownRun(out, NAME)
    with fleet_of(tmp_path, FleetBench("here", "", "fleet.yaml:2:5", folder=out)) as page:
        assert cards(page, is_state("running", "here"))["here"]["run"] == NAME
        (out / NAME / "session.open").unlink()
        run.close()
        over = cards(page, is_state("idle", "here"))["here"]
        assert (over.get("progress"), over["outcome"], over["attention"]) == (None, "damaged", "some")
        out.rename(tmp_path / "elsewhere")
        assert cards(page, is_state("unknown", "here"))["here"]["attention"] == "much"


@pytest.mark.parametrize("role", [OPERATOR, "nobody"])
def test_a_wrong_token_is_named(tmp_path: Path, bench: Page, role: str, caplog: pytest.LogCaptureFixture) -> None:
    token = bench.clear.get(role, "x" * 32)
    with caplog.at_level(logging.ERROR), fleet_of(tmp_path, entry(bench.origin, token)) as page:
        assert cards(page, is_state("unknown", why="refused"))["bench-1"]["attention"] == "much"
    (said,) = (record.getMessage() for record in caplog.records if record.name.startswith("bench.web.fleet"))
    assert said.startswith("fleet.yaml:2:5 bench-1: bench bench-1: its server refuses the token")
    assert token not in caplog.text


def test_a_server_of_another_kind_is_unknown(tmp_path: Path) -> None:
    with fleet_of(tmp_path / "a", entry("http://127.0.0.1:1", "x" * 32)) as other:
        second = entry(other.origin, other.clear[VIEWER], "other")
        with fleet_of(tmp_path / "b", second, entry("http://127.0.0.1:1", "x" * 32)) as page:
            found = cards(page, is_state("unknown", "other", why="foreign"))
            assert found["bench-1"]["state"] == "unknown"
            assert cards(page, is_state("unknown", why="unreached"))


def why_of(bench: FleetBench, trusted: ssl.SSLContext) -> str:
    """Why a line to a bench has ended, or the state it said."""

    async def listen() -> str:
        seat = Seat(bench, CLOCK)
        following = asyncio.create_task(ServerLine(seat, trusted).follow())
        async with asyncio.timeout(WAIT_S):
            while seat.card().get("why") == "connecting":
                await asyncio.sleep(0.02)
        following.cancel()
        await asyncio.gather(following, return_exceptions=True)
        return str(seat.card().get("why") or seat.card()["state"])

    return asyncio.run(listen())


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")
def test_a_certificate_that_nobody_knows_is_not_trusted(tmp_path: Path) -> None:
    cert, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    made = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    made += ["-keyout", str(key), "-out", str(cert), "-days", "2", "-subj", "/CN=localhost"]
    subprocess.run([*made, "-addext", "subjectAltName=IP:127.0.0.1"], check=True, capture_output=True)
    with served(tmp_path, tls=(cert, key), secure=True) as page:
        bench = entry(page.origin.replace("http:", "https:"), page.clear[VIEWER])
        assert why_of(bench, ssl.create_default_context()) == "untrusted"
        assert why_of(bench, ssl.create_default_context(cafile=cert)) == "idle"


def test_a_redirect_is_not_followed(bench: Page) -> None:
    asked = []

    class Elsewhere(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            asked.append(self.path)
            self.send_response(307)
            self.send_header("Location", f"{bench.origin}{OVERVIEW}".replace("http", "ws"))
            self.end_headers()

        def log_message(self, *words: object) -> None:
            del words

    server = HTTPServer(("127.0.0.1", 0), Elsewhere)
    threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
    moved = entry(f"http://127.0.0.1:{server.server_port}", bench.clear[VIEWER])
    assert why_of(moved, ssl.create_default_context()) == "unreached"
    assert asked == [OVERVIEW]
    server.shutdown()
    server.server_close()


def test_what_a_bench_tells_is_small_and_its_heart_beats_each_two_seconds(bench: Page) -> None:
    run = ShownRun(bench.serving.out, NAME)
    headers = {"Authorization": f"Bearer {bench.clear[VIEWER]}"}
    address = f"ws://127.0.0.1:{bench.port}{OVERVIEW}"
    with connect(address, origin=bench.origin, additional_headers=headers, proxy=None) as viewer:  # type: ignore[arg-type]
        messages, beats_ns = [], []
        while len(beats_ns) < 3:
            messages.append(viewer.recv(timeout=WAIT_S))
            if isinstance(messages[-1], str) and json.loads(messages[-1])["type"] == "heartbeat":
                beats_ns.append(CLOCK.now_ns())
    snapshots = [said for said in messages if isinstance(said, str) and json.loads(said)["type"] == "snapshot"]
    assert len(snapshots) == 1  # time goes on, and is no news
    assert len(snapshots[0]) < 1200
    assert set(json.loads(snapshots[0])["state"]["runs"]) == {NAME}
    assert (beats_ns[2] - beats_ns[0]) / 2e9 == pytest.approx(2.0, abs=0.7)
    run.close()


def test_nobody_looks_without_a_login_and_no_route_commands(tmp_path: Path, bench: Page) -> None:
    with fleet_of(tmp_path, entry(bench.origin, bench.clear[VIEWER])) as page:
        assert page.ask("GET", "/").status == 401
        assert page.close_code({}, origin=page.origin) == 4401
        posted = [route.path for route in page.app.routes if "POST" in (getattr(route, "methods", None) or ())]
        assert posted == ["/login", "/logout"]
        assert page.post("/api/v1/commands", OPERATOR, {}).status == 404
        texts = page.ask("GET", "/", page.cookie(OPERATOR)).body.decode()
        assert bench.clear[VIEWER] not in texts
