"""``bench serve`` as people start it: a process, its errors, TLS, and its end."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import socket
import ssl
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from http.client import HTTPConnection, HTTPSConnection
from pathlib import Path
from typing import NamedTuple

import pytest

from bench.commands.serve import Request, serve
from bench.model.errors import InputError
from bench.web.serving import written

END_S = 20.0


class Reply(NamedTuple):
    status: int
    cookie: str


@contextmanager
def started(top: Path, *options: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The process and what it has printed until it says how it ends."""
    (top / "sessions").mkdir(exist_ok=True)
    environment = {**os.environ, "XDG_CONFIG_HOME": str(top / "config"), "PYTHONUNBUFFERED": "1"}
    command = [sys.executable, "-m", "bench", "serve", "--out", str(top / "sessions"), "--port", "0", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment) as one:
        try:
            said = ""
            assert one.stdout is not None
            for line in one.stdout:
                said += line
                if "Ctrl-C" in line:
                    break
            yield one, said
        finally:
            one.kill()


def port_of(said: str) -> int:
    found = re.search(r"https?://[^/]*:(\d+)/", said)
    assert found is not None, said
    return int(found[1])


def ask(connection: HTTPConnection, method: str = "GET", path: str = "/", body: str = "", **headers: str) -> Reply:
    """One request on a connection of its own."""
    with closing(connection):
        connection.request(method, path, body or None, {name.replace("_", "-"): text for name, text in headers.items()})
        reply = connection.getresponse()
        reply.read()
        return Reply(reply.status, reply.getheader("set-cookie", ""))


def log_in(connection: HTTPConnection, token: str, origin: str, **headers: str) -> Reply:
    kind = {"Content_Type": "application/x-www-form-urlencoded", "Origin": origin}
    return ask(connection, "POST", "/login", f"name=kim&token={token}", **kind, **headers)


def test_tokens_are_printed_once_and_the_end_is_quiet(tmp_path: Path) -> None:
    with started(tmp_path) as (server, said):
        assert len(re.findall(r"^(viewer|operator) token: [\w-]{32}$", said, re.MULTILINE)) == 2
        assert "not an emergency stop" in said
        assert ask(HTTPConnection("127.0.0.1", port_of(said))).status == 401
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
        assert len(new) == 2
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
        port = port_of(said)
        assert f"https://0.0.0.0:{port}/" in said
        trusted = ssl.create_default_context(cafile=str(cert))
        assert ask(HTTPSConnection("127.0.0.1", port, context=trusted)).status == 401
        assert ask(HTTPSConnection("127.0.0.1", port, context=trusted), Host="evil.example").status == 403
        token = re.findall(r"viewer token: (\S+)", said)[0]
        secret = HTTPSConnection("127.0.0.1", port, context=trusted)
        answer = log_in(secret, token, f"https://127.0.0.1:{port}")
        assert answer.status == 303
        assert answer.cookie.startswith("__Host-bench_login_")
        assert answer.cookie.endswith("; Secure")
        secret = HTTPSConnection("127.0.0.1", port, context=trusted)
        assert log_in(secret, token, f"http://127.0.0.1:{port}").status == 403


def refused(**fields: object) -> InputError:
    with pytest.raises(InputError) as raised:
        serve(Request(**{"out": Path(), "port": 0, **fields}))  # type: ignore[arg-type]
    return raised.value


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.0.2.7", "bench.example.org", "127.0.0.1.example.org", ""])
def test_other_machines_need_encryption_b_web_001(host: str) -> None:
    assert refused(host=host).code == "B-WEB-001"


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


@pytest.mark.parametrize("url", ["http://a.example", "a.example", "https://", "https://a.example/x", "https://u@a.example",
                                 "https://a.example:port", "https://a.example?x", "ftp://a.example", ""])  # fmt: skip
def test_a_proxy_is_a_whole_https_server_b_web_003(url: str) -> None:
    assert refused(behind_proxy=url, host="127.0.0.1").code == "B-WEB-003"


def test_a_port_in_use_b_web_004(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    with socket.create_server(("127.0.0.1", 0)) as other:
        wrong = refused(port=other.getsockname()[1], out=tmp_path)
        assert (wrong.code, wrong.exit_status) == ("B-WEB-004", 2)
    assert not (tmp_path / "inertial-bench").exists()  # no tokens are made that nobody would see again


def test_a_folder_that_is_not_there_b_web_005(tmp_path: Path) -> None:
    assert refused(out=tmp_path / "x").code == "B-WEB-005"


def test_behind_a_proxy(tmp_path: Path) -> None:
    with started(tmp_path, "--behind-proxy", "https://bench.example.org:8443") as (_, said):
        found = re.search(r"listening for the proxy at http://127.0.0.1:(\d+)", said)
        assert found is not None
        port = int(found[1])
        assert ask(HTTPConnection("127.0.0.1", port)).status == 403
        assert ask(HTTPConnection("127.0.0.1", port), Host="bench.example.org:8443").status == 401
        assert ask(HTTPConnection("127.0.0.1", port), Host="bench.example.org").status == 403
        token = re.findall(r"operator token: (\S+)", said)[0]
        answer = log_in(
            HTTPConnection("127.0.0.1", port), token, "https://bench.example.org:8443", Host="bench.example.org:8443"
        )
        assert (answer.status, "; Secure" in answer.cookie) == (303, True)
    lines = (tmp_path / "config" / "inertial-bench" / "serve.jsonl").read_text().splitlines()
    assert json.loads(lines[-1])["name"] == "kim"


def test_an_address_is_written_as_browsers_write_it() -> None:
    assert written(("192.0.2.7", 8321), secure=True) == {"192.0.2.7:8321"}
    assert written(("Bench", 443), secure=True) == {"bench", "bench:443"}
    assert written(("Bench", 443), secure=False) == {"bench:443"}
    assert written(("::1", 80), secure=False) == {"[::1]", "[::1]:80"}
    assert written(("::ffff:192.0.2.7", 8321), secure=False) == {"192.0.2.7:8321"}
    assert written(None, secure=True) == frozenset()
