"""Documents of calibrations that never were: one unit with a plausible drift, seen through one calibrator; a process
that writes them into a history until it is killed."""

import atexit
import functools
import itertools
import os
import pwd
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sqlalchemy import event
from sqlalchemy.engine import Engine

from bench.model.clock import utc_text
from bench.store import record_calibration

CHANNELS = range(1, 11)
TEMPERATURES_degC = (-10.0, 5.0, 20.0, 35.0, 50.0)
GAIN_ppm, OWN_ppm, BIAS_NOISE_A = 10.0, 2.0, 2e-10
START_NS = 1_400_000_000_000_000_000
DAY_NS = 86_400_000_000_000
FACTOR = 1.959963984540054


@dataclass(frozen=True)
class Drift:
    """How a unit changes, per year, and from which calibration on another calibrator certificate is used."""

    dsf_ppm: float = 12.0
    bias_A: float = 1e-9
    certificate_days: int = 365


def kind_of(channel: int) -> str:
    return "gyro" if channel <= 6 else "accelerometer"


def estimate(quantity: str, unit: str, value: float, std: float, conditions: dict[str, Any], **more: Any) -> Any:
    return {
        "quantity": quantity, "unit": unit, "value": value, "std_uncertainty": std, "coverage_factor": FACTOR,
        "expanded_uncertainty": FACTOR * std, "conditions": conditions, "n": 14, "dropped": 0, "limit": None,
        "verdict": "none", **more,
    }  # fmt: skip


def standards(certificate: str = "C-0") -> dict[str, Any]:
    relative = [{"range_A": 2.2e-4, "relative": 2e-5, "floor_A": 6e-9}, {"range_A": 2.2, "relative": 3.2e-5}]
    entry = {"model": "5720A", "serial": "77", "certificate": certificate, "calibrated": "2014-01-01"}
    return {"calibrator": {**entry, "due": "2015-01-01", "uncertainty": relative}}


def manifest(certificate: str = "C-0") -> dict[str, Any]:
    channels = [{"number": one, "stability_limit_ppm": 100.0 if one <= 6 else 200.0} for one in CHANNELS]
    return {
        "sequence": "scale_factor_38h", "station": "made_up", "standards": standards(certificate),
        "campaign": {"analysis": "scale_factor", "channels": channels},
    }  # fmt: skip


def document(session: str, sha256: str, estimates: list[Any], **changes: Any) -> dict[str, Any]:
    provenance = {
        "simulated": False, "plan_sha256": "p", "frame_sha256": "f", "session_sha256": sha256, "software": "made up 1",
    }  # fmt: skip
    return {
        "schema": 1, "session": session, "campaign": "scale_factor", "method": "gls",
        "uut": {"model": "NGU", "serial": "A1"}, "estimates": estimates,
        "quality": {"records": 750, "frames": 10, "frames_bad": 0, "frames_lost": 0, "splices": 0, "retaken": 0},
        "provenance": provenance, "notes": ["made up"], **changes,
    }  # fmt: skip


def calibrations(
    count: int, every_days: float, seed: int, drift: Drift | None = None
) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """(results.json, manifest) of ``count`` calibrations, 200 estimates each, in order of time.

    Every certificate of the calibrator has one gain error that all results share; the rest is noise of each.
    """
    rng = np.random.default_rng(seed)
    drift = drift or Drift()
    truth = {key: rng.normal(0.0, 400.0, 2) for key in ((c, t) for c in CHANNELS for t in TEMPERATURES_degC)}
    gains: dict[int, float] = {}
    found = []
    for number in range(count):
        years = number * every_days / 365.25
        certificate = int(number * every_days // drift.certificate_days)
        gain_ppm = gains.setdefault(certificate, rng.normal(0.0, GAIN_ppm))
        estimates = [
            one
            for (channel, warmth), dsf in truth.items()
            for one in _place(rng, channel, warmth, dsf + drift.dsf_ppm * years + gain_ppm, drift.bias_A * years)
        ]
        started_ns = START_NS + round(number * every_days * DAY_NS)
        stamp = utc_text(started_ns).replace("-", "").replace(":", "")
        name = f"{stamp}_scale_factor_38h_A1"
        found.append((document(name, f"{number:064x}", estimates), manifest(f"C-{certificate}")))
    return found


def _place(rng: Any, channel: int, warmth_degC: float, dsf_ppm: Any, bias_A: float) -> list[Any]:
    where = {"channel": channel, "kind": kind_of(channel), "temperature_degC": warmth_degC}
    where["unit_temperature_degC"] = warmth_degC + rng.normal(0.0, 0.01)
    std_ppm = float(np.hypot(OWN_ppm, GAIN_ppm))
    n_ppm, p_ppm = dsf_ppm + rng.normal(0.0, OWN_ppm, 2)
    return [
        estimate("dsf_n", "ppm", float(n_ppm), std_ppm, where),
        estimate("dsf_p", "ppm", float(p_ppm), std_ppm, where),
        estimate("dsf_asymmetry", "ppm", float(n_ppm - p_ppm), OWN_ppm * 2**0.5, where),
        estimate("bias", "A", 4e-7 + bias_A + rng.normal(0.0, BIAS_NOISE_A), BIAS_NOISE_A, where),
    ]


STARTS_WITHIN_S = 30.0
BACKENDS = ("sqlite", "postgresql")


@dataclass
class Server:
    """A running server; every test gets a database of its own."""

    port: int
    user: str
    numbers: "itertools.count[int]" = field(default_factory=itertools.count)

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


Documents = list[tuple[dict[str, Any], dict[str, Any]]]


def unit(
    serial: str, days: np.ndarray, seed: int, gains_ppm: np.ndarray, steps_ppm: np.ndarray | None = None, **more: Any
) -> Documents:
    """(results.json, manifest) of a unit, a certificate of the calibrator each year, off by ``gains_ppm``.

    ``steps_ppm`` (n,) is what each calibration is off beside that; ``more``: station, simulated.
    """
    rng = np.random.default_rng(seed)
    level, rate = rng.normal(0.0, 300.0), rng.normal(0.0, 10.0)
    steps = np.zeros(days.size) if steps_ppm is None else steps_ppm
    return [
        _calibration(rng, serial, float(day), level + rate * float(day) / 365.25 + float(step), gains_ppm, more)
        for day, step in zip(days, steps, strict=True)
    ]


def _calibration(
    rng: np.random.Generator, serial: str, day: float, dsf_ppm: float, gains_ppm: np.ndarray, more: dict[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    year = int(day // 365)
    where = {"channel": 1, "kind": "gyro", "temperature_degC": 20.0}
    std = float(np.hypot(OWN_ppm, GAIN_ppm))
    n_ppm, p_ppm = (dsf_ppm + gains_ppm[year] + rng.normal(0.0, OWN_ppm, 2)).tolist()
    estimates = [
        estimate("dsf_n", "ppm", n_ppm, std, where),
        estimate("dsf_p", "ppm", p_ppm, std, where),
        estimate("bias", "A", 4e-7 + float(rng.normal(0.0, 2e-10)), 2e-10, where),
    ]
    stamp = utc_text(START_NS + round(day * DAY_NS)).replace("-", "").replace(":", "")
    one = document(f"{stamp}_scale_factor_{serial}", f"{serial.lower()}{round(day * 1440):x}".rjust(64, "0"), estimates)
    one["uut"] = {"model": "NGU", "serial": serial}
    one["provenance"]["simulated"] = more.get("simulated", False)
    return one, manifest(f"C-{year}") | {"station": more.get("station", "bench_1")}


def written(url: str, *histories: Documents) -> Documents:
    """Enter calibrations in order of time; return them so."""
    ordered = sorted((entry for history in histories for entry in history), key=lambda entry: entry[0]["session"])
    for document, manifest in ordered:
        record_calibration(url, document, manifest, None)
    return ordered


@functools.cache
def every_document(seed: int, count: int) -> list[tuple[dict[str, Any], dict[str, Any], str]]:
    """What is written: (results.json, manifest, report hash); every third session twice, with other results."""
    found = []
    for number, (document, manifest) in enumerate(calibrations(count, 30.0, seed)):
        found.append((document, manifest, f"report {number}"))
        if number % 3 == 0:
            found.append(({**document, "method": "paper"}, manifest, f"report {number} again"))
    return found


def die_at(statement: int) -> None:
    """Kill this process before a statement is executed."""
    left = [statement]

    @event.listens_for(Engine, "before_cursor_execute")
    def count(*_: object) -> None:
        left[0] -= 1
        if left[0] == 0:
            os.kill(os.getpid(), signal.SIGKILL)


def write(url: str, seed: int, count: int, statement: int = 0, told: Connection | None = None) -> None:
    """Write; ``told`` hears when it begins. Before ``statement``, if it is not 0, this process kills itself."""
    documents = every_document(seed, count)
    if statement:
        die_at(statement)
    if told is not None:
        told.send("ready")
    for document, manifest, report in documents:
        record_calibration(url, document, manifest, report)
