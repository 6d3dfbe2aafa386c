"""Parts of the served bench one by one: terminals, control socket, output watch, station, rate, time constants."""

import json
import socket
from collections.abc import Iterator
from datetime import date
from pathlib import Path
from typing import Any

import pytest
import serial
from sim_bench import Bench, descriptors, open_bench

from bench.model.clock import NS, WallClock
from bench.model.errors import InputError, InputErrors
from bench.model.lab import find_shipped
from bench.plan import check_plan, compile_sequence, load_station
from bench.plan.check.stations import check_station
from bench.plan.findings import Findings
from bench.plan.served import served_station
from sim_instruments.faults.switchboard import LinkFaults
from sim_instruments.served.process import ControlSocket, OutputWatch, PtyLink
from sim_instruments.worlds.common.thermal import UNIT_LAG_S, Thermal

TODAY = date(2031, 5, 7)


class Line:
    """A world with a port that gives what it is told to, and keeps what it is sent."""

    def __init__(self) -> None:
        self.unit = self.faults = self
        self.arriving = self.sent = b""
        self.port_at = lambda name: (self, name)
        self._link = LinkFaults(1, "port_a")

    def link(self, name: str) -> LinkFaults:
        assert name == "port_a"
        return self._link

    def connect(self, name: str, baud: int, faults: LinkFaults) -> None:
        assert (name, baud, faults) == ("port_a", 921_600, self._link)

    def read(self, name: str, size: int) -> bytes:
        chunk, self.arriving = self.arriving[:size], self.arriving[size:]
        return chunk

    def write(self, name: str, sent: bytes) -> None:
        self.sent += sent


@pytest.fixture
def line(tmp_path: Path) -> Iterator[tuple[Line, PtyLink]]:
    line: Any = Line()
    before = descriptors()
    link = PtyLink(line, "port_a", tmp_path / "port_a", 921_600)
    yield line, link
    link.close()
    link.close()
    assert not (tmp_path / "port_a").is_symlink()
    assert descriptors() == before


def give(line: Line, link: PtyLink, chunk: bytes) -> None:
    line.arriving = chunk
    link.pump()


def test_every_byte_value_passes_in_both_directions(line: tuple[Line, PtyLink]) -> None:
    world, link = line
    every = bytes(range(256))
    with serial.Serial(str(link.path), timeout=0.5) as port:
        give(world, link, every)
        assert port.read(256) == every
        port.write(every)
        port.flush()
        link.pump()
        assert world.sent == every
    assert (link.sent_bytes, link.lost_bytes) == (256, 0)


def test_nobody_listens_and_the_bytes_are_gone(line: tuple[Line, PtyLink]) -> None:
    world, link = line
    give(world, link, b"never heard")
    with serial.Serial(str(link.path), timeout=0.1) as port:
        give(world, link, b"heard")
        assert port.read(100) == b"heard"
    give(world, link, b"nor this")
    assert (link.sent_bytes, link.lost_bytes) == (5, 19)
    with serial.Serial(str(link.path), timeout=0.05) as port:
        assert port.read(100) == b""


@pytest.fixture
def control(tmp_path: Path) -> Iterator[Path]:
    path = tmp_path / "control.sock"
    path.write_text("left by one that was killed")

    def answer(words: Any) -> dict[str, Any]:
        if words == ["wrong"]:
            raise InputError("B-SIM-010", "no", where="here", next_step="another")
        return {"lines": list(words)}

    opened = ControlSocket(path, answer)
    yield path
    opened.close()
    opened.close()
    assert not path.exists()


def say(path: Path, line: bytes) -> Any:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
        client.connect(str(path))
        client.sendall(line)
        client.shutdown(socket.SHUT_WR)
        with client.makefile("rb") as stream:
            return json.loads(stream.readline())


def test_the_control_socket_answers_and_survives_nonsense(control: Path) -> None:
    assert (control.stat().st_mode & 0o777) == 0o600
    assert say(control, b'{"words": ["a", "b"]}\n') == {"lines": ["a", "b"]}
    refused = {"code": "B-SIM-010", "message": "no", "where": "here", "next_step": "another"}
    assert say(control, b'{"words": ["wrong"]}\n') == {"error": refused}
    for nonsense in (b"\n", b"{", b"[]\n", b'{"words": 3}\n', b"\xff\xfe\n", b"x" * 100_000):
        try:
            assert "not understood" in say(control, nonsense)["error"]["message"]
        except (ConnectionError, ValueError):  # it hung up before the end of what was too long
            assert len(nonsense) > 65_536
    assert say(control, b'{"words": []}\n') == {"lines": []}


def test_the_watch_tells_when_an_output_last_changed(bench: Bench) -> None:
    watch = OutputWatch(bench.world)
    bench.clock.every(0.02, watch.look)
    bench.clock.sleep(5.0)
    bench.send("switch", ":CLOS (@1!2!7)")
    bench.clock.sleep(3.0)
    state = watch.state()
    assert state["instruments"]["switch"]["closed"] == ["1!2!7"]
    assert state["instruments"]["switch"]["unchanged_s"] == pytest.approx(3.0, abs=0.03)
    assert state["instruments"]["calibrator"]["unchanged_s"] == pytest.approx(8.0, abs=0.03)
    assert state["unit"]["inputs_A"]["7"] == bench.world.wiring.leakage_A[1, 6]
    assert (state["unit"]["powered"], state["faults"]) == (False, [])
    bench.send("supply", "VOLT 18", "CURR 2", "OUTP ON")
    bench.send("calibrator", "OUT 1.0E-03 A, 0 HZ", "OPER")
    bench.clock.sleep(10.0)
    state = watch.state()
    assert state["unit"]["powered"]
    assert state["loop_current_A"] == pytest.approx(1e-3, rel=1e-3)
    json.dumps(state)


@pytest.mark.parametrize("name", ["af_bench_sim", "af_rack_sim"])
def test_a_served_station_says_the_same_but_where_and_when(name: str, tmp_path: Path) -> None:
    source = load_station(find_shipped("stations", name))
    resources = {
        role: f"TCPIP0::127.0.0.1::hislip{number},41000::INSTR" for number, role in enumerate(source.instruments)
    }
    path = tmp_path / "station.yaml"
    urls = {link: f"{tmp_path}/a place/{link}" for link in source.links}
    path.write_text(served_station(source, resources, urls, tmp_path / "a place" / "control.sock", TODAY))
    served = load_station(path)
    assert served.file.control == str(tmp_path / "a place" / "control.sock")
    assert (served.simulated, served.in_process, served.file.visa) == (True, False, "@py")
    assert served.file.model_dump(exclude=CHANGED) == source.file.model_dump(exclude=CHANGED)
    for role, entry in served.instruments.items():
        before = source.instruments[role]
        assert entry.resource == resources[role]
        assert entry.model_dump(exclude=MOVED) == before.model_dump(exclude=MOVED)
        assert (entry.standard.calibrated, entry.standard.due) == (date(2031, 4, 7), date(2032, 4, 6))
    findings = Findings()
    check_station(served, findings)
    assert findings.sorted() == []


CHANGED = {"title": True, "visa": True, "control": True, "world": True, "instruments": True, "links": True}
MOVED = {"resource": True, "standard": {"calibrated", "due"}}


def test_numbers_of_the_register_are_served_to_the_last_digit(tmp_path: Path) -> None:
    text = find_shipped("stations", "af_bench_sim").read_text()
    text = text.replace("gain: 0 ppm, offset: 0 A", "gain: 1.23456789 ppm, offset: 0.1234567 nA", 1)
    more = "      degrees_of_freedom: 7\n      drift: 0.7 ppm\n      corrections:"
    text = text.replace("      corrections:", more, 1).replace(
        "8 ppm, common_with: SIM-0001", "8 ppm, k: 2.1, common_with: R 1", 1
    )
    (tmp_path / "source.yaml").write_text(text)
    source = load_station(tmp_path / "source.yaml")
    places = {role: f"GPIB0::{number}::INSTR" for number, role in enumerate(source.instruments, 1)}
    served_text = served_station(source, places, {"port_a": "/dev/a", "port_b": "/dev/b"}, Path("/c"), TODAY)
    (tmp_path / "served.yaml").write_text(served_text)
    before, after = source.standards(), load_station(tmp_path / "served.yaml").standards()
    for register in (before, after):
        for standard in register.values():
            del standard["calibrated"], standard["due"]
    assert after == before
    assert after["calibrator"]["drift_relative"] == 7e-7


def refused(tmp_path: Path, text: str) -> str:
    (tmp_path / "station.yaml").write_text(text)
    with pytest.raises(InputErrors) as caught:
        load_station(tmp_path / "station.yaml")
    return str(caught.value)


def test_a_station_is_real_served_or_simulated_here(tmp_path: Path) -> None:
    text = find_shipped("stations", "af_rack_sim").read_text()
    without = text[: text.index("\nworld:")] + text[text.index("\nbus_time_factor") :]
    assert "a real station has no 'world'" in refused(tmp_path, text.replace("simulated: true", "simulated: false"))
    assert "served by another process" in refused(tmp_path, without)
    assert "'control' is for a simulated station" in refused(tmp_path, f"{text}\ncontrol: /c\n")
    served = without.replace('"@bench"', '"@py"')
    assert "the url of link 'port_a' is missing" in refused(tmp_path, served)
    real = served.replace("simulated: true", "simulated: false").replace("baud:", "url: /dev/null, baud:")
    assert "'bus_time_factor' is for simulated stations" in refused(tmp_path, real)
    assert "bus_time_factor" in refused(tmp_path, text.replace("bus_time_factor: 0.12", "bus_time_factor: 0.001"))


def test_bus_times_are_those_of_the_station(tmp_path: Path) -> None:
    text = find_shipped("stations", "af_rack_sim").read_text()
    slow = tmp_path / "slow.yaml"
    slow.write_text(text.replace("bus_time_factor: 0.12", "bus_time_factor: 1"))
    sequence = find_shipped("sequences", "scale_factor_wall")
    plan = compile_sequence(sequence, load_station(slow))
    fast_s, slow_s = (
        [step.bus_s for step in one.steps if step.kind == "settle"] for one in (compile_sequence(sequence), plan)
    )
    assert fast_s == pytest.approx([0.12 * one for one in slow_s])
    assert "B-PLAN-060" in {error.code for error in check_plan(plan)}


def test_a_clock_with_a_rate() -> None:
    clock, real = WallClock(rate=50.0), WallClock()
    seen: list[int] = []
    real_ns, began_ns = real.now_ns(), clock.now_ns()
    ticking = clock.every(1.0, lambda: seen.append(clock.now_ns()))
    clock.sleep(10.0)
    passed_ns, took_ns = clock.now_ns() - began_ns, real.now_ns() - real_ns
    assert 10 * NS <= passed_ns <= 50 * took_ns
    while not seen:
        clock.sleep(1.0)
    ticking.cancel()
    assert seen[0] - began_ns >= NS
    assert clock.utc_ns() <= real.utc_ns()  # UTC is the real one
    for rate in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="rate"):
            WallClock(rate)


@pytest.mark.parametrize("factor", [10.0, 200.0])
def test_time_constants_divide_every_lag(factor: float) -> None:
    slow, fast = Thermal(), Thermal(factor)
    assert fast.unit_lag_s == UNIT_LAG_S / factor
    for thermal, scale in ((slow, 1.0), (fast, factor)):
        thermal.ramp(33.0, 1.0 * scale, 0)
        thermal.hold(round(900 * NS / scale))
        thermal.stop(round(3000 * NS / scale))
    for t_s in (100.0, 700.0, 900.0, 2500.0, 3000.0, 4000.0, 9000.0):
        t_ns = round(t_s * NS), round(t_s * NS / factor)
        assert float(fast.air_degC(t_ns[1])) == pytest.approx(float(slow.air_degC(t_ns[0])), abs=1e-6)
        assert float(fast.unit_degC(t_ns[1])) == pytest.approx(float(slow.unit_degC(t_ns[0])), abs=1e-6)


def test_the_calibrator_settles_as_fast_as_the_world_is() -> None:
    with open_bench(options={"time_constants": "100"}) as bench:
        bench.send("switch", ":CLOS (@1!1!1)")
        bench.send("calibrator", "OUT 1.0E-03 A, 0 HZ", "OPER")
        assert bench.ask("calibrator", "ISR?") == "1"
        bench.clock.sleep(0.06)
        assert bench.ask("calibrator", "ISR?") == "4097"
