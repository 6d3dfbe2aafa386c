"""``bench serve`` and its server: what it says, whom it lets in, and connections that do not wait for ever."""

import asyncio
import json
import logging
import re
import shutil
import signal
import socket
import ssl
import subprocess
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx
import pytest
from uvicorn import Config
from uvicorn.server import ServerState
from waiting import until
from web_rig import Page, served, started
from websockets.frames import Frame, Opcode
from websockets.protocol import State
from websockets.server import ServerProtocol

from bench.commands.requests import ServeRequest
from bench.commands.serve import serve
from bench.model.clock import WallClock
from bench.model.errors import InputError
from bench.web import serving
from bench.web.security.tokens import VIEWER
from bench.web.serving import PatientSocket, written

END_S = 20.0
CUT_S = 30.0  # the test waits no longer


def address_of(said: str) -> str:
    return re.findall(r"https?://\S+:\d+", said)[0]


def log_in(address: str, token: str, origin: str, **more: Any) -> httpx.Response:
    headers = {"Origin": origin, **more.pop("headers", {})}
    return httpx.post(f"{address}/login", data={"name": "kim", "token": token}, headers=headers, **more)


def test_tokens_are_printed_once_and_the_end_is_quiet(tmp_path: Path) -> None:
    with started(tmp_path) as (server, said):
        assert len(re.findall(r"^(viewer|operator) token: [\w-]{32}$", said, re.MULTILINE)) == 2
        assert "not an emergency stop" in said
        assert httpx.get(address_of(said)).status_code == 401
        server.send_signal(signal.SIGTERM)
        rest, _ = server.communicate(timeout=END_S)
        assert (server.returncode, rest) == (0, "")
    with started(tmp_path) as (server, again):
        assert "token:" not in again
        server.send_signal(signal.SIGINT)
        rest, _ = server.communicate(timeout=END_S)
        assert (server.returncode, rest) == (0, "")
    kept = (tmp_path / "config" / "inertial-bench" / "serve.json").read_text()
    assert not [token for token in re.findall(r"token: (\S+)", said) if token in kept]
    with started(tmp_path, "--rotate") as (_, rotated):
        new = re.findall(r"token: (\S+)", rotated)
        assert len(new) == 3
        assert set(new).isdisjoint(re.findall(r"token: (\S+)", said))


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A self-signed certificate for localhost and 127.0.0.1, and its key."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed, so there is no certificate to serve with")
    folder = tmp_path_factory.mktemp("tls")
    cert, key = folder / "cert.pem", folder / "key.pem"
    names = "subjectAltName=DNS:localhost,IP:127.0.0.1"
    made = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    made += ["-keyout", str(key), "-out", str(cert), "-days", "2", "-subj", "/CN=localhost", "-addext", names]
    subprocess.run(made, check=True, capture_output=True)
    return cert, key


def test_tls_on_every_address(tmp_path: Path, certificate: tuple[Path, Path]) -> None:
    cert, key = certificate
    options = ("--host", "0.0.0.0", "--cert", str(cert), "--key", str(key))
    with started(tmp_path, *options) as (_, said):
        assert address_of(said).startswith("https://0.0.0.0:")
        address = address_of(said).replace("0.0.0.0", "127.0.0.1")
        trusted = ssl.create_default_context(cafile=str(cert))
        assert httpx.get(address, verify=trusted).status_code == 401
        assert httpx.get(address, verify=trusted, headers={"Host": "evil.example"}).status_code == 403
        token = re.findall(r"viewer token: (\S+)", said)[0]
        answer = log_in(address, token, address, verify=trusted)
        assert answer.status_code == 303
        assert answer.headers["set-cookie"].startswith("__Host-bench_login_")
        assert answer.headers["set-cookie"].endswith("; Secure")
        assert log_in(address, token, address.replace("https", "http"), verify=trusted).status_code == 403


def refused(**fields: object) -> InputError:
    with pytest.raises(InputError) as raised:
        serve(ServeRequest(**{"out": Path(), "port": 0, **fields}))  # type: ignore[arg-type]
    return raised.value


HOSTS = ("0.0.0.0", "::", "192.0.2.7", "bench.example.org", "127.0.0.1.example.org", "")
PROXIES = ("http://a.example", "a.example", "https://", "https://u@a.example", "https://a.example:port", "")
PATHS = ("https://a.example/x", "https://a.example?x", "ftp://a.example")


def test_other_machines_need_encryption_and_a_proxy_is_a_whole_server_of_https(tmp_path: Path) -> None:
    assert {host: refused(host=host).code for host in HOSTS} == dict.fromkeys(HOSTS, "B-WEB-001")
    found = {refused(behind_proxy=url, host="127.0.0.1").code for url in (*PROXIES, *PATHS)}
    assert found == {"B-WEB-003"}
    assert refused(out=tmp_path / "x").code == "B-WEB-005"


def test_a_certificate_that_cannot_be_used_b_web_002(tmp_path: Path, certificate: tuple[Path, Path]) -> None:
    cert, key = certificate
    assert "--key" in refused(cert=cert).message
    assert "--cert" in refused(key=key).message
    (tmp_path / "no.pem").write_text("no certificate")
    locked = tmp_path / "locked.pem"
    encrypt = ["openssl", "pkey", "-in", str(key), "-out", str(locked), "-aes256", "-passout", "pass:secret"]
    subprocess.run(encrypt, check=True, capture_output=True)
    for one, other in ((cert, tmp_path / "no.pem"), (tmp_path / "x", key), (key, cert), (cert, cert), (cert, locked)):
        assert refused(cert=one, key=other).code == "B-WEB-002"


def test_a_port_in_use_b_web_004(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    with socket.create_server(("127.0.0.1", 0)) as other:
        wrong = refused(port=other.getsockname()[1], out=tmp_path)
        assert (wrong.code, wrong.exit_status) == ("B-WEB-004", 2)
    assert not (tmp_path / "inertial-bench").exists()  # no tokens are made that nobody would see again


def test_behind_a_proxy(tmp_path: Path) -> None:
    with started(tmp_path, "--behind-proxy", "https://bench.example.org:8443") as (_, said):
        address = re.findall(r"listening for the proxy at (http://127.0.0.1:\d+)", said)[0]
        host = {"Host": "bench.example.org:8443"}
        for headers, status in (({}, 403), ({"Host": "bench.example.org"}, 403), (host, 401)):
            assert httpx.get(address, headers=headers).status_code == status
        token = re.findall(r"operator token: (\S+)", said)[0]
        answer = log_in(address, token, "https://bench.example.org:8443", headers=host)
        assert (answer.status_code, "; Secure" in answer.headers["set-cookie"]) == (303, True)
    lines = (tmp_path / "config" / "inertial-bench" / "serve.jsonl").read_text().splitlines()
    assert json.loads(lines[-1])["name"] == "kim"


def test_an_address_is_written_as_browsers_write_it() -> None:
    assert written(("192.0.2.7", 8321), secure=True) == {"192.0.2.7:8321"}
    assert written(("Bench", 443), secure=True) == {"bench", "bench:443"}
    assert written(("Bench", 443), secure=False) == {"bench:443"}
    assert written(("::1", 80), secure=False) == {"[::1]", "[::1]:80"}
    assert written(("::ffff:192.0.2.7", 8321), secure=False) == {"192.0.2.7:8321"}
    assert written(None, secure=True) == frozenset()


def whole(page: Page) -> bytes:
    return f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{page.port}\r\n\r\n".encode()


def is_cut(stream: socket.socket) -> bool:
    """Wait for the end of a connection; raises TimeoutError if none comes."""
    try:
        while stream.recv(65536):
            pass
    except ConnectionResetError:
        pass
    return True


@pytest.mark.parametrize("begin", [b"", b"G", b"GET / HTTP/1.1\r\nHost: x\r\n", b"answered", b"body"])
def test_a_connection_that_asks_nothing_whole_is_cut(page: Page, monkeypatch: pytest.MonkeyPatch, begin: bytes) -> None:
    monkeypatch.setattr(serving, "HEAD_S", 0.3)
    made = serving.PatientHttp.connection_made

    def hurried(self: serving.PatientHttp, transport: Any) -> None:
        made(self, transport)
        self.timeout_keep_alive = 0.3  # 5 s of uvicorn, behind an answer

    monkeypatch.setattr(serving.PatientHttp, "connection_made", hurried)
    host = f"Host: 127.0.0.1:{page.port}\r\n".encode()
    known = {
        b"answered": whole(page) + b"GET / HT",  # the second request of a connection that had an answer
        b"body": b"POST /api/v1/commands HTTP/1.1\r\n" + host + b"Content-Length: 60000\r\n\r\n{",  # refused meanwhile
    }
    with socket.create_connection(("127.0.0.1", page.port), CUT_S) as stream:
        stream.sendall(known.get(begin, begin))
        assert is_cut(stream)


def test_a_request_that_drips_is_cut_and_one_that_is_whole_is_answered(
    page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(serving, "HEAD_S", 0.5)
    with socket.create_connection(("127.0.0.1", page.port), CUT_S) as stream, suppress(OSError):
        for _ in range(int(CUT_S / 0.05)):
            stream.sendall(b"X")
            WallClock().sleep(0.05)
        pytest.fail("a byte now and then keeps a connection")
    assert page.ask("GET", "/").status == 401


def test_an_answer_that_takes_long_is_waited_for(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serving, "HEAD_S", 0.1)

    async def slow() -> tuple[list[Any], int]:
        await asyncio.sleep(1.0)
        return [], 0

    monkeypatch.setattr(page.app.state.hub, "listed", slow)
    assert page.ask("GET", "/api/v1/runs", page.cookie(VIEWER)).json == {"runs": [], "unread": 0}


def test_an_answer_that_nobody_reads_is_not_kept_for_ever(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serving, "UNREAD_S", 0.5)
    protocols: list[serving.PatientHttp] = []
    made = serving.PatientHttp.connection_made

    def remembered(self: serving.PatientHttp, transport: Any) -> None:
        made(self, transport)
        protocols.append(self)

    monkeypatch.setattr(serving.PatientHttp, "connection_made", remembered)
    head = "".join(f"{name}: {text}\r\n" for name, text in page.cookie(VIEWER).items())
    with socket.socket() as stream:
        stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        stream.connect(("127.0.0.1", page.port))
        ask = f"GET /bokeh/bokeh.min.js HTTP/1.1\r\nHost: 127.0.0.1:{page.port}\r\n{head}\r\n".encode()
        stream.sendall(8 * ask)  # more than the buffers of the system take
        until(lambda: bool(protocols) and protocols[0].transport.get_write_buffer_size() > 0)
        until(lambda: protocols[0] not in protocols[0].connections)


class Wire:
    """A transport that keeps what is written."""

    def __init__(self) -> None:
        self.written: list[bytes] = []
        self.aborted = False

    def write(self, content: bytes) -> None:
        self.written.append(content)

    def is_closing(self) -> bool:
        return False

    def close(self) -> None:
        """Closing waits for what was written to be read."""

    def abort(self) -> None:
        self.aborted = True


async def pinged(page: Page, *, reads: bool) -> Wire:
    """A WebSocket that has got a thousand pings, and then none of the answers it asked for."""
    config = Config(page.app, log_config=None)
    config.load()
    protocol = PatientSocket(config, ServerState(), {})
    protocol.transport = wire = Wire()  # type: ignore[assignment]
    protocol.conn = ServerProtocol(state=State.OPEN)
    if not reads:
        protocol.pause_writing()
    for _ in range(1000):
        protocol.conn.receive_data(Frame(Opcode.PING, b"x" * 125).serialize(mask=True))
        protocol.handle_events()
    protocol.keepalive_timeout()
    return wire


def test_pings_of_somebody_who_does_not_read_pile_up_nothing(page: Page) -> None:
    wire = asyncio.run(pinged(page, reads=True))
    assert sum(map(len, wire.written)) > 127_000
    wire = asyncio.run(pinged(page, reads=False))
    assert sum(map(len, wire.written)) < 100, "the frame that closes, and no pong"
    assert wire.aborted, "or what was never read would be kept"


def test_a_page_that_is_cut_at_the_end_leaves_no_traceback(page: Page, caplog: pytest.LogCaptureFixture) -> None:
    uvicorn = logging.getLogger("uvicorn.error")
    for error in (asyncio.CancelledError(), OSError("something else")):
        uvicorn.error("Exception in ASGI application", exc_info=error)
    assert [str(record.exc_info[1]) for record in caplog.records if record.exc_info] == ["something else"]


def test_a_head_without_end_is_refused(page: Page) -> None:
    with socket.create_connection(("127.0.0.1", page.port), CUT_S) as stream:
        stream.sendall(b"GET / HTTP/1.1\r\nX-Long: ")
        sent = 0
        with suppress(OSError):
            while sent < 100 * serving.LARGEST_HEAD:
                sent += stream.send(b"x" * 4096)
        assert sent < 100 * serving.LARGEST_HEAD, "it does not take for ever what has no end"
    assert page.ask("GET", "/").status == 401


def test_an_address_holds_no_more_connections_than_its_share_and_the_next_one_waits_for_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(serving, "MOST_OF_ADDRESS", 3)
    with served(tmp_path) as page:
        place = ("127.0.0.1", page.port)
        held = [socket.create_connection(place, CUT_S) for _ in range(3)]
        for stream in held:
            stream.sendall(whole(page))
            assert stream.recv(12) == b"HTTP/1.1 401"
        with socket.create_connection(place, CUT_S) as beyond:
            assert is_cut(beyond)
        with socket.create_connection(place, CUT_S, source_address=("127.0.0.2", 0)) as other:
            other.sendall(whole(page))
            assert other.recv(12) == b"HTTP/1.1 401"
        held.pop().close()
        until(lambda: page.ask("GET", "/").status == 401)
        for stream in held:
            stream.close()


def test_pages_that_come_and_go_leave_no_connection_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serving, "MOST_OF_ADDRESS", 2)
    with served(tmp_path) as page:
        for _ in range(5):
            assert page.close_code(page.cookie(VIEWER), origin=page.origin) == 4404  # there is no such run
        assert page.ask("GET", "/").status == 401
