"""A page server on a real port of this machine, spoken to by clients that know nothing of its framework."""

import json
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http.client import HTTPConnection
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from bench.model.clock import WallClock
from bench.web.app import create_app
from bench.web.security.audit import FILE, Audit
from bench.web.security.logins import LOGOUTS, Login
from bench.web.security.tokens import obtain_tokens
from bench.web.serving import Serving, server_of, written

RUN = "20000101T000000Z_scale_factor_short_SIM-1"
COMMAND = {"X-Bench-Command": "1", "Content-Type": "application/json"}
FORM = {"Content-Type": "application/x-www-form-urlencoded"}


@dataclass
class Answer:
    """What came back; header names are in small letters."""

    status: int
    headers: dict[str, str]
    body: bytes

    @property
    def json(self) -> Any:
        return json.loads(self.body)


@dataclass
class Page:
    """A running server and its secrets."""

    serving: Serving
    clear: dict[str, str]
    folder: Path
    app: Any

    @property
    def port(self) -> int:
        return self.serving.port

    @property
    def origin(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def forget(self) -> None:
        """Nobody has logged in or out, commanded or failed; the tokens stay."""
        (self.folder / LOGOUTS).unlink(missing_ok=True)
        self.serving.__post_init__()
        self.app.state.hub.lease = self.serving.lease.document
        (self.folder / FILE).unlink(missing_ok=True)

    def cookie(self, role: str, name: str = "kim", login_id: str = "") -> dict[str, str]:
        """Header of a login that was made without the form."""
        login = Login(name, role, login_id or f"{name}-{role}")
        return {"Cookie": self.serving.cookies.header(login).partition(";")[0]}

    def ask(self, method: str, path: str, headers: dict[str, str] | None = None, body: bytes = b"") -> Answer:
        """One request, its path sent byte for byte as it is; Host is right unless ``headers`` has another one."""
        connection = HTTPConnection("127.0.0.1", self.port, timeout=10)
        sent = {"Host": f"127.0.0.1:{self.port}", **(headers or {})}
        try:
            connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
            for name, value in sent.items():
                connection.putheader(name, value)
            if body or method == "POST":
                connection.putheader("Content-Length", str(len(body)))
            connection.endheaders(body or None)
            reply = connection.getresponse()
            return Answer(reply.status, {k.lower(): v for k, v in reply.getheaders()}, reply.read())
        finally:
            connection.close()

    def post(self, path: str, role: str, document: Any, *, name: str = "kim", login_id: str = "") -> Answer:
        """A POST as the page sends it."""
        headers = {**self.cookie(role, name, login_id), **COMMAND, "Origin": self.origin}
        return self.ask("POST", path, headers, json.dumps(document).encode())

    def login(self, name: str, token: str, **fields: str) -> Answer:
        """What the form sends."""
        body = urlencode({"name": name, "token": token, **fields}).encode()
        return self.ask("POST", "/login", {**FORM, "Origin": self.origin}, body)

    def close_code(self, headers: dict[str, str], run: str = "", origin: str | None = None) -> int:
        """Code that a WebSocket is closed with before anything is sent on it."""
        url = f"ws://127.0.0.1:{self.port}/ws?run={run}"
        page = connect(url, origin=origin, additional_headers=headers, proxy=None)  # type: ignore[arg-type]
        with page, pytest.raises(ConnectionClosed) as closed:
            page.recv(timeout=10)
        return closed.value.rcvd.code

    def audit(self) -> list[dict[str, Any]]:
        """Every line of the audit."""
        path = self.folder / FILE
        return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


@contextmanager
def served(top: Path, **options: Any) -> Iterator[Page]:
    """A server for the sessions in ``top/sessions``, where one is, without a run. ``tell``: as of ``create_app``."""
    out, folder = top / "sessions", top / "private"
    (out / RUN).mkdir(parents=True)
    (out / RUN / "session.0001.mcap").touch()
    tokens, clear = obtain_tokens(folder)
    clock = WallClock()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        place = listener.getsockname()
        hosts = options.pop("hosts", written(place, secure=options.get("secure", False)))
        tell = options.pop("tell", None)
        serving = Serving(out, tokens, Audit(folder, clock), clock, hosts, place[1], **options)
        app = create_app(serving, tell)
        server = server_of(app)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        try:
            yield Page(serving, clear, folder, app)
        finally:
            server.stop()
            thread.join()


@contextmanager
def started(top: Path, *options: str, **environment: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """``bench serve`` as a process, and what it has printed until it says how it ends, or has ended."""
    (top / "sessions").mkdir(exist_ok=True)
    environment = {**os.environ, "XDG_CONFIG_HOME": str(top / "config"), "PYTHONUNBUFFERED": "1", **environment}
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
