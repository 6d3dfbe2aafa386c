"""Opening a bench: what is refused, what is closed again, and who is asked before a library that waits long."""

from __future__ import annotations

import socket
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import pyvisa
import serial
from pyvisa.constants import InterfaceType
from pyvisa_py.sessions import Session, UnavailableSession

from bench.model.clock import VirtualClock, WallClock
from bench.model.errors import BenchError, ExitStatus
from bench.plan import Plan, Station, compile_sequence, load_station
from bench.run.bench import opener
from bench.run.bench.opener import OpenBench, check_answers, missing_buses, open_bench, port_of
from bench.run.bench.transcript import HeldTranscript, new_folder
from bench.run.control.operator import SimulatedOperator
from bench.run.observers import Observers, Recorder
from bench.run.session import conduct

ROOT = Path(__file__).resolve().parents[4]
SIMULATED = (ROOT / "stations" / "af_bench_sim.yaml").read_text()
WORLD = SIMULATED[SIMULATED.index("world:") : SIMULATED.index("instruments:")]


def station(folder: Path, *changes: tuple[str, str]) -> Station:
    text = SIMULATED
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / "station.yaml"
    path.write_text(text)
    return load_station(path)


def real(folder: Path, *changes: tuple[str, str]) -> Station:
    urls = (("baud: 921600", "baud: 921600, url: /dev/nowhere_a"), ("baud: 115200", "baud: 115200, url: loop://"))
    return station(folder, ("simulated: true", "simulated: false"), ('"@bench"', '"@py"'), (WORLD, ""), *urls, *changes)


def refusal(bench: Station, **options: Any) -> BenchError:
    with pytest.raises(BenchError) as caught:
        open_bench(bench, options.pop("clock", WallClock()), HeldTranscript(), seed=1, **options)
    return caught.value


def test_the_virtual_clock_is_refused_on_a_real_station(tmp_path: Path) -> None:
    error = refusal(real(tmp_path), clock=VirtualClock())
    assert (error.code, error.exit_status) == ("B-RUN-001", ExitStatus.BAD_INPUT)


class Visa:
    """A bus with nothing on it."""

    def open_resource(self, *_: object, **__: object) -> None:
        raise pyvisa.VisaIOError(pyvisa.constants.StatusCode.error_resource_not_found)

    def close(self) -> None:
        return None


@pytest.fixture
def empty_bus(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opener.pyvisa, "ResourceManager", lambda library: Visa())
    monkeypatch.setattr(opener, "_unserved", lambda *_, **__: "")  # whether linux-gpib is here


@pytest.fixture
def full_bus(empty_bus: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opener, "open_instrument", lambda *_, **__: Visa())


@pytest.mark.usefixtures("empty_bus")
def test_a_resource_that_does_not_open(tmp_path: Path) -> None:
    error = refusal(real(tmp_path))
    assert (error.code, error.where, error.exit_status) == ("B-RUN-002", "calibrator", ExitStatus.SAFE_AFTER_FAULT)
    assert "GPIB0::4::INSTR" in error.message


def test_a_bench_without_a_visa_library(tmp_path: Path) -> None:
    bench = real(tmp_path, ('"@py"', '"@ivi"'))
    error = refusal(bench)
    assert error.code == "B-RUN-002"
    assert error.where.startswith(str(tmp_path / "station.yaml"))
    assert "@ivi" in error.message
    assert set(missing_buses(bench)) == set(bench.instruments)


def test_a_kind_of_interface_without_its_library_is_one_error_for_all_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What linux-gpib would serve is named once; an instrument of the network beside it is not missing."""
    session = type("Unavailable", (UnavailableSession,), {"session_issue": "install linux-gpib. It has more to say"})
    monkeypatch.setitem(Session._session_classes, (InterfaceType.gpib, "INTFC"), session)
    bench = real(tmp_path, ("GPIB0::22::INSTR", "TCPIP::127.0.0.1::hislip0::INSTR"))
    missing = missing_buses(bench)
    (lan,) = set(bench.instruments) - set(missing)
    assert bench.instruments[lan].resource.startswith("TCPIP")
    (error,) = {id(error): error for error in missing.values()}.values()
    others = len(missing) - 1
    assert error.message == f"the VISA library @py cannot reach GPIB0::4::INSTR and {others} more: install linux-gpib"
    assert refusal(bench).message == error.message


@pytest.mark.usefixtures("full_bus")
def test_a_port_that_does_not_open(tmp_path: Path) -> None:
    error = refusal(real(tmp_path))
    assert (error.code, error.where, error.exit_status) == ("B-RUN-003", "port_a", ExitStatus.SAFE_AFTER_FAULT)
    assert "/dev/nowhere_a" in error.message


@pytest.mark.usefixtures("full_bus")
def test_a_real_port_is_opened_for_this_run_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[dict[str, Any]] = []
    monkeypatch.setattr(serial, "serial_for_url", lambda url, **options: asked.append(options) or Visa())
    open_bench(real(tmp_path), WallClock(), HeldTranscript(), seed=1).close()
    assert [options["exclusive"] for options in asked] == [True, True]
    assert all(options["timeout"] == 0 and options["write_timeout"] > 0 for options in asked)


def test_a_station_without_the_link_that_is_counted(tmp_path: Path) -> None:
    plan: Plan = compile_sequence(ROOT / "sequences" / "timeline_example.yaml", None, {})
    poor = station(tmp_path, ("  port_a: {frame: ngu_a, baud: 921600}\n", ""))
    with pytest.raises(BenchError) as caught:
        conduct(replace(plan, station=poor), clock=VirtualClock(), seed=1, out=tmp_path / "out",
                operator=SimulatedOperator(), listener=None)  # type: ignore[arg-type]  # fmt: skip
    assert (caught.value.code, caught.value.where) == ("B-RUN-004", "port_a")
    assert not (tmp_path / "out").exists()


def test_everything_is_closed_whatever_fails(tmp_path: Path) -> None:
    closed: list[str] = []

    class Closing:
        def __init__(self, name: str, error: Exception | None) -> None:
            self.name, self.error = name, error

        def close(self) -> None:
            closed.append(self.name)
            if self.error is not None:
                raise self.error

    gone = pyvisa.VisaIOError(pyvisa.constants.StatusCode.error_connection_lost)
    instruments: Any = {"a": Closing("a", gone), "b": Closing("b", OSError("gone"))}
    links: Any = {"c": Closing("c", serial.SerialException("gone")), "d": Closing("d", None)}
    world: Any = Closing("world", None)
    OpenBench(station(tmp_path), instruments, links, world, Closing("visa", gone).close).close()
    assert closed == ["a", "b", "c", "d", "visa", "world"]


def test_a_taken_folder_gets_a_suffix(tmp_path: Path) -> None:
    names = []
    for _ in range(3):
        folder = new_folder(tmp_path, "session")
        folder.mkdir()
        names.append(folder.name)
    assert names == ["session", "session-2", "session-3"]


def test_a_full_disk_keeps_no_command_from_an_instrument() -> None:
    from bench.record import RecordError

    class Full:
        def command(self, *_: object) -> None:
            raise RecordError("B-REC-003", "64 MB wait", where="session")

    transcript = HeldTranscript()
    transcript.attach(Observers(VirtualClock(), Recorder(Full())))  # type: ignore[arg-type]
    transcript("calibrator", "tx", "STBY", 0)


@pytest.mark.parametrize(
    ("resource", "found"),
    [
        ("TCPIP0::127.0.0.1::hislip3,41234::INSTR", ("127.0.0.1", 41234)),
        ("TCPIP::meter.lab::hislip0::INSTR", ("meter.lab", 4880)),
        ("TCPIP0::10.0.0.7::inst0::INSTR", ("10.0.0.7", 111)),
        ("TCPIP0::10.0.0.7::5025::SOCKET", ("10.0.0.7", 5025)),
        ("GPIB0::4::INSTR", None),
        ("ASRL/dev/ttyS0::INSTR", None),
    ],
)
def test_host_and_port(resource: str, found: tuple[str, int] | None) -> None:
    assert port_of(resource) == found


def test_somebody_answers_or_not() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        check_answers(f"TCPIP0::127.0.0.1::{port}::SOCKET")
    with pytest.raises(OSError, match=r"refused|timed out"):
        check_answers(f"TCPIP0::127.0.0.1::{port}::SOCKET")
    check_answers("GPIB0::4::INSTR")
