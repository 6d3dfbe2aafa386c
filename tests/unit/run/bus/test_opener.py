"""The bench of a run: opened, asked side by side, made safe, served; the first contact with an instrument."""

import socket
import threading
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import pyvisa
import serial
from plan_sample import reworded
from pyvisa.constants import InterfaceType
from pyvisa_py.sessions import Session, UnavailableSession

from bench.model.clock import NS, VirtualClock, WallClock
from bench.model.errors import BenchError, ExitStatus, InputError, InstrumentError
from bench.model.ports import Identity
from bench.plan import Plan, Station, compile_sequence, load_station
from bench.run.bus import opener
from bench.run.bus.beginning import begin_safely
from bench.run.bus.opener import OpenBench, check_answers, missing_buses, open_bench, port_of
from bench.run.bus.safety import LATE_S, PAUSE_S, QUICK_S, WayToSafe, make_safe, states_of
from bench.run.bus.served_world import ask, told
from bench.run.bus.side_by_side import asked, bus_of
from bench.run.observers import HeldTranscript, Observers, Recorder, new_folder
from bench.run.operator import SimulatedOperator
from bench.run.session import conduct
from sim_instruments.served.process import ControlSocket

ROOT = Path(__file__).resolve().parents[4]
SIMULATED = (ROOT / "stations" / "af_bench_sim.yaml").read_text()
WORLD = SIMULATED[SIMULATED.index("world:") : SIMULATED.index("instruments:")]


def station(folder: Path, *changes: tuple[str, str]) -> Station:
    path = folder / "station.yaml"
    path.write_text(reworded(SIMULATED, *changes))
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


@pytest.mark.parametrize(
    ("bus", "code", "where", "named"),
    [
        ("empty_bus", "B-RUN-002", "calibrator", "GPIB0::4::INSTR"),
        ("full_bus", "B-RUN-003", "port_a", "/dev/nowhere_a"),
    ],
)
def test_a_resource_or_a_port_that_does_not_open(
    tmp_path: Path, request: pytest.FixtureRequest, bus: str, code: str, where: str, named: str
) -> None:
    request.getfixturevalue(bus)
    error = refusal(real(tmp_path))
    assert (error.code, error.where, error.exit_status) == (code, where, ExitStatus.SAFE_AFTER_FAULT)
    assert named in error.message


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


HEARD: list[list[str]] = []


def answer(words: Sequence[str]) -> dict[str, Any]:
    HEARD.append(list(words))
    if words[1] != "unit":
        raise InputError("B-SIM-018", "nobody can do this", where="here", next_step="leave it")
    return {"lines": []}


@pytest.fixture
def control(tmp_path: Path) -> Iterator[Path]:
    HEARD.clear()
    socket = ControlSocket(tmp_path / "control.sock", answer)
    yield tmp_path / "control.sock"
    socket.close()


def bench_at(control: Path | None) -> OpenBench:
    station: Any = SimpleNamespace(file=SimpleNamespace(control=None if control is None else str(control)))
    return OpenBench(station, {}, {}, None, lambda: None)


def test_what_a_person_does_is_told_to_the_process_that_serves_the_bench(control: Path) -> None:
    bench_at(control).operate("unit", "GNC-05")
    bench_at(control).operate("unit", 5)
    assert HEARD == [["operate", "unit", "GNC-05"], ["operate", "unit", "5"]]


def test_a_person_has_done_it_on_a_real_bench_and_one_that_is_gone_is_one_clear_error(
    control: Path, tmp_path: Path
) -> None:
    bench_at(None).operate("unit", "GNC-05")
    assert HEARD == []
    with pytest.raises(InputError, match="B-SIM-015"):
        told(tmp_path / "none.sock", ["operate", "unit", "GNC-05"])


def test_its_error_is_the_run_s_error(control: Path) -> None:
    with pytest.raises(InputError, match="nobody can do this") as caught:
        bench_at(control).operate("chamber", "1")
    assert (caught.value.code, caught.value.where, caught.value.next_step) == ("B-SIM-018", "here", "leave it")
    assert "error" in ask(control, ["operate", "chamber", "1"])


RESOURCES = {"a": "GPIB0::4::INSTR", "b": "TCPIP0::1.2.3.4::INSTR", "c": "gpib0::5::INSTR", "d": "GPIB1::4::INSTR"}


def test_a_board_is_one_bus_and_everything_else_its_own() -> None:
    assert [bus_of(resource) for resource in RESOURCES.values()] == ["GPIB0", RESOURCES["b"].upper(), "GPIB0", "GPIB1"]


def test_different_buses_are_asked_at_the_same_time_and_one_bus_in_order() -> None:
    together = threading.Barrier(3, timeout=10.0)  # of a, b and d; c waits for a
    heard: list[str] = []

    def ask(role: str) -> str:
        if role != "c":
            together.wait()
        heard.append(role)
        return role.upper()

    assert asked(RESOURCES, ask, WallClock()) == {"a": "A", "b": "B", "c": "C", "d": "D"}
    assert heard.index("a") < heard.index("c")


def test_a_rehearsal_asks_in_the_order_of_the_station() -> None:
    heard: list[str] = []
    asked(RESOURCES, heard.append, VirtualClock())
    assert heard == list(RESOURCES)


class Mute:
    """Never safe; ``limits_s`` holds the time it was given in each attempt, None: as long as it takes."""

    role = "mute"

    def __init__(self) -> None:
        self.limits_s: list[float | None] = []
        self._limit_s: float | None = None

    def quick(self, limit_s: float) -> "Mute":
        self._limit_s = limit_s
        return self

    def __enter__(self) -> None:
        return None

    def __exit__(self, *_: object) -> None:
        return None

    def make_safe(self) -> None:
        self.limits_s.append(self._limit_s)
        self._limit_s = None
        raise RuntimeError("no answer")


def test_one_that_was_mute_to_everything_is_not_waited_for_again() -> None:
    for mute, limits_s in (((), [QUICK_S, None, None]), (("mute",), [QUICK_S] * 3)):
        instrument = Mute()
        failures = make_safe({"mute": instrument}, [], VirtualClock(), mute)  # type: ignore[dict-item]
        assert [failure.code for failure in failures] == ["B-RUN-060"]
        assert instrument.limits_s == limits_s


class Instrument:
    """Fails with each error of a list in turn (None: it answers), then answers for good."""

    def __init__(self, clock: VirtualClock, *errors: str) -> None:
        self._clock, self._errors = clock, list(errors)
        self.calls_s: list[float] = []

    def make_safe(self) -> None:
        self.calls_s.append(self._clock.now_ns() / NS)
        if self._errors and (code := self._errors.pop(0)):
            raise InstrumentError(code, "nobody there")


def test_everybody_is_told_in_order_and_who_answers_at_once_is_done() -> None:
    clock = VirtualClock()
    bench = {role: Instrument(clock) for role in ("supply", "switch", "calibrator")}
    assert make_safe(bench, ("calibrator", "switch"), clock) == []  # type: ignore[arg-type]
    assert [len(one.calls_s) for one in bench.values()] == [1, 1, 1]
    assert list(WayToSafe(bench, ("calibrator", "switch"), clock).left) == ["calibrator", "switch", "supply"]


def test_who_was_away_is_confirmed_by_a_second_answer() -> None:
    """What it was told before it was away may come late: between the answers it has time to take effect."""
    clock = VirtualClock()
    calibrator = Instrument(clock, "B-INST-003", "")
    way = WayToSafe({"calibrator": calibrator}, (), clock)
    way.attempt()
    assert way.left == {"calibrator": "unreachable"}
    clock.sleep(1.0)
    way.attempt()
    assert (way.left, way.failures) == ({"calibrator": "commanded"}, {})
    way.attempt()  # too soon: it is not even asked
    assert calibrator.calls_s == [0.0, 1.0]
    clock.sleep(LATE_S)
    way.attempt()
    assert way.left == {}


def test_what_fails_to_the_end_is_told_with_what_is_known_of_it() -> None:
    clock, live = VirtualClock(), []
    gone, mute = Instrument(clock, *["B-RUN-002"] * 9), Instrument(clock, *["B-INST-001"] * 9)
    failures = make_safe({"gone": gone, "mute": mute}, (), clock, live=live.append)  # type: ignore[arg-type]
    assert states_of(failures) == {"gone": "unreachable", "mute": "commanded"}
    assert {failure.code for failure in failures} == {"B-RUN-060"}
    assert len(live) >= 4  # a guard takes a silence of 1.5 s for a run that hangs
    assert PAUSE_S / 4 < 1.5 > QUICK_S


class _Order:
    """An instrument that notes what it is asked for."""

    def __init__(self, role: str, notes: list[str]) -> None:
        self.role, self._notes = role, notes

    def introduce(self, note: str = "who") -> Identity:
        self._notes.append(note)
        return Identity("maker", self.role, "1", "1")

    def make_safe(self) -> None:
        self._notes.append("safe")

    def identify(self) -> Identity:
        return self.introduce("prepared")


def test_a_run_prepares_nothing_before_the_whole_bench_is_safe() -> None:
    notes: list[str] = []
    entries = {role: SimpleNamespace(resource=f"GPIB0::{at}::INSTR", standard=None) for at, role in enumerate("ab", 1)}
    station: Any = SimpleNamespace(instruments=entries, safe_order=("a", "b"))
    instruments: Any = {role: _Order(role, notes) for role in entries}
    opened = OpenBench(station, instruments, {}, None, lambda: None)
    begin_safely(opened, VirtualClock(), lambda: notes.append("what was left"))
    assert notes == ["who", "who", "safe", "safe", "what was left", "prepared", "prepared"]
