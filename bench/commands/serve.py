"""``bench serve``: the live page of one bench, or of many, as a process that no run waits for."""

from __future__ import annotations

import ipaddress
import os
import socket
import ssl
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from urllib.parse import urlsplit

import typer

from bench.commands.requests import ServeRequest
from bench.model.clock import WallClock
from bench.model.errors import InputError
from bench.web.app import create_app
from bench.web.security.audit import Audit
from bench.web.security.tokens import FILE, Tokens, obtain_tokens, private_folder
from bench.web.serving import Serving, serve_until_told, server_of, written
from bench.web.telemetry import Lookout

BACKLOG = 128
LOOPBACK_NAMES = {"localhost", "127.0.0.1", "::1"}


def serve(request: ServeRequest) -> None:
    """Serve until Ctrl-C or SIGTERM.

    Raises: InputError B-WEB-001 to B-WEB-007, B-WEB-025, B-WEB-026, StoreError B-STORE-001, before
    anything is served.
    """
    _check_reach(request)
    proxy = _proxy(request.behind_proxy)
    _check_certificate(request.cert, request.key)
    shown = _shown(request)
    clock, folder = WallClock(), private_folder()
    with _broker(request.mqtt) as tell, _listen(request.host, request.port) as listener:
        tokens, clear = obtain_tokens(folder, request.rotate)
        serving = _serving(request, shown, listener, tokens, Audit(folder, clock), clock, proxy)
        app = create_app(serving, tell)
        announce = partial(_announce, serving, listener, clear, proxy)
        serve_until_told(server_of(app, request.cert, request.key), listener, announce)


def _shown(request: ServeRequest) -> Path:
    """Return the folder of the sessions to show. Raises: InputError B-WEB-005."""
    out = request.out or Path("sessions")
    if not out.is_dir():
        advice = "name the folder of the sessions with --out; 'bench run' makes one"
        raise InputError("B-WEB-005", "there is no such folder", where=out, next_step=advice)
    return out


@contextmanager
def _broker(url: str | None) -> Iterator[Callable[[Lookout], Awaitable[None]] | None]:
    """Keep the connection to a broker; yields what tells it of the runs, None without a broker."""
    if url is None:
        yield None
        return
    from bench.web.telemetry import broker as mqtt  # an extra

    broker = mqtt.Broker(mqtt.address_of(url), os.environ.get(mqtt.PASSWORD))
    typer.echo(broker.start())
    try:
        yield broker.tell
    finally:
        broker.stop()


def _check_reach(request: ServeRequest) -> None:
    tls = request.cert is not None
    if (request.cert is None) != (request.key is None):
        given, due = ("--cert", "--key") if tls else ("--key", "--cert")
        raise InputError("B-WEB-002", f"{given} is given without {due}", where=given, next_step="give both")
    if not (_is_loopback(request.host) or tls or request.behind_proxy):
        message = f"{request.host} is reached from other machines, and nothing would be encrypted"
        advice = "keep 127.0.0.1 and use 'ssh -L', or give --cert and --key, or --behind-proxy (docs/live-page.md)"
        raise InputError("B-WEB-001", message, where="--host", next_step=advice)


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _proxy(url: str | None) -> str | None:
    """Return the host, and port if it is not 443, of the address people use."""
    if url is None:
        return None
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError:
        parts, port = urlsplit(""), None
    bare = not (parts.query or parts.fragment or parts.username or parts.password) and parts.path in ("", "/")
    if parts.scheme != "https" or not parts.hostname or not bare:
        message = f"{url[:100]!r} is not the address of a whole https server"
        raise InputError(
            "B-WEB-003", message, where="--behind-proxy", next_step="for example https://bench.example.org"
        )
    host = f"[{parts.hostname}]" if ":" in parts.hostname else parts.hostname
    return host if port in (None, 443) else f"{host}:{port}"


def _check_certificate(cert: Path | None, key: Path | None) -> None:
    if cert is None:
        return
    try:
        # a key with a password would be asked for on the terminal: an empty one is tried instead
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(cert, key, password="")
    except (OSError, ValueError) as error:
        message = f"certificate and key cannot be used: {getattr(error, 'strerror', None) or error}"
        advice = "give PEM files that belong together, the key without a password"
        raise InputError("B-WEB-002", message, where=f"{cert}, {key}", next_step=advice) from error


def _listen(host: str, port: int) -> socket.socket:
    listener = None
    try:
        family, kind, _, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
        listener = socket.socket(family, kind)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        # head and body of an answer are two packets: the second would wait 40 ms for the other side's word on the first
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        listener.bind(place)
        listener.listen(BACKLOG)
    except OSError as error:
        if listener is not None:
            listener.close()
        message = f"cannot listen there: {error.strerror or error}"
        advice = "another 'bench serve' may be running; --port 0 takes any free port"
        raise InputError("B-WEB-004", message, where=f"{host} port {port}", next_step=advice) from error
    return listener


def _serving(
    request: ServeRequest,
    shown: Path,
    listener: socket.socket,
    tokens: Tokens,
    audit: Audit,
    clock: WallClock,
    proxy: str | None,
) -> Serving:
    place = listener.getsockname()[:2]
    secure = request.cert is not None or proxy is not None
    names = {place[0], request.host}
    any_address = ipaddress.ip_address(place[0]).is_unspecified
    if _is_loopback(request.host) or any_address:
        names |= LOOPBACK_NAMES
    if not _is_loopback(request.host):
        names |= {socket.gethostname(), socket.getfqdn()}
    hosts = frozenset({proxy}) if proxy else frozenset().union(*(written((name, place[1]), secure) for name in names))
    return Serving(
        shown.absolute(),
        tokens,
        audit,
        clock,
        hosts,
        place[1],
        secure=secure,
        behind_proxy=proxy is not None,
        history=request.history,
        any_address=any_address and proxy is None,
    )


def _announce(serving: Serving, listener: socket.socket, clear: dict[str, str], proxy: str | None) -> None:
    host, port = listener.getsockname()[:2]
    here = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
    typer.echo(f"live page of {serving.out}: {serving.scheme}://{proxy or here}/")
    if proxy:
        typer.echo(f"listening for the proxy at http://{here}")
    for role, token in clear.items():
        typer.echo(f"{role} token: {token}")
    if clear:
        typer.echo(f"these are shown only now; hashes are kept in {private_folder() / FILE}, --rotate makes new ones")
    typer.echo("Ctrl-C ends the page, never a run. The web Abort is not an emergency stop.")
