"""Histories for the tests: a SQLite file, and a PostgreSQL server of our own on loopback where the package is there."""

from __future__ import annotations

import atexit
import functools
import itertools
import os
import pwd
import shutil
import socket
import subprocess
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import pytest

STARTS_WITHIN_S = 30.0
BACKENDS = ("sqlite", "postgresql")


@dataclass
class Server:
    """A running server; every test gets a database of its own."""

    port: int
    user: str
    numbers: itertools.count[int] = field(default_factory=itertools.count)

    def url(self, database: str) -> str:
        return f"postgresql://{self.user}@127.0.0.1:{self.port}/{database}"

    def new_database(self) -> str:
        """URL of an empty database."""
        import psycopg

        name = f"history_{next(self.numbers)}"
        with psycopg.connect(self.url("postgres"), autocommit=True) as connection:
            connection.execute(f"CREATE DATABASE {name}")
        return self.url(name)


def new_history(backend: str, folder: Path) -> str:
    """URL of a history that does not exist yet; skips the test where there is no PostgreSQL."""
    if backend == "sqlite":
        return f"sqlite:///{folder / 'history.sqlite'}"
    started = server()
    if isinstance(started, str):
        pytest.skip(started)
    return started.new_database()


@functools.cache
def server() -> Server | str:
    """The server of this test process, or why there is none."""
    programs = sorted(Path("/usr/lib/postgresql").glob("*/bin/postgres"))
    setpriv = shutil.which("setpriv")
    try:
        import psycopg  # noqa: F401
    except ImportError:
        return "PostgreSQL tests skipped: the driver psycopg is not installed"
    if not programs:
        return "PostgreSQL tests skipped: no server below /usr/lib/postgresql (Debian: apt-get install postgresql)"
    if setpriv is None:
        return "PostgreSQL tests skipped: no setpriv (package util-linux), which ends the server with the tests"
    return _start(programs[-1].parent, setpriv)


def _start(programs: Path, setpriv: str) -> Server | str:
    """Make a cluster in a temporary folder and serve it; the server dies with this process, whatever happens."""
    owner = _unprivileged()
    if owner is None:
        return "PostgreSQL tests skipped: running as root, and there is neither a user postgres nor nobody"
    folder = Path(tempfile.mkdtemp(prefix="bench-postgres-"))
    prefix = [setpriv]
    if os.getuid() == 0:
        os.chown(folder, owner.pw_uid, owner.pw_gid)
        prefix += [f"--reuid={owner.pw_uid}", f"--regid={owner.pw_gid}", "--clear-groups"]
    cluster = folder / "cluster"
    make = [str(programs / "initdb"), "--no-sync", "--auth=trust", "--encoding=UTF8", "--locale=C", "-U", "bench"]
    subprocess.run([*prefix, *make, "-D", str(cluster)], check=True, capture_output=True, cwd=folder)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])
    serve = [str(programs / "postgres"), "-D", str(cluster), "-p", str(port), "-c", "listen_addresses=127.0.0.1"]
    serve += ["-c", "unix_socket_directories=", "-c", "fsync=off"]
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen([*prefix, "--pdeathsig=INT", *serve], stdout=log, stderr=log, cwd=folder)
    atexit.register(_stop, process, folder)
    found = Server(port, "bench")
    _wait_for(found, process, folder / "log")
    return found


def _unprivileged() -> pwd.struct_passwd | None:
    """Who runs the server: ourselves, but never root."""
    if os.getuid() != 0:
        return pwd.getpwuid(os.getuid())
    known = {one.pw_name: one for one in pwd.getpwall()}
    return known.get("postgres") or known.get("nobody")


def _wait_for(found: Server, process: subprocess.Popen[bytes], log: Path) -> None:
    import psycopg

    deadline = time.monotonic() + STARTS_WITHIN_S
    while True:
        try:
            psycopg.connect(found.url("postgres"), connect_timeout=2).close()
            return
        except psycopg.OperationalError:
            if process.poll() is not None or time.monotonic() > deadline:
                raise AssertionError(log.read_text(errors="replace")) from None
            time.sleep(0.05)


def _stop(process: subprocess.Popen[bytes], folder: Path) -> None:
    process.terminate()
    process.wait()
    shutil.rmtree(folder, ignore_errors=True)
