"""``sim://`` ports through pySerial, as the bench opens them."""

import numpy as np
import pytest
import serial

from bench.frame import load_frame
from bench.model.clock import NS, VirtualClock
from bench.model.errors import LinkError
from bench.model.shipped import find_shipped
from sim_instruments.worlds.af_converter.ngu import Ngu
from sim_instruments.worlds.af_converter.world import AfWorld


@pytest.fixture
def world(monkeypatch):
    monkeypatch.setattr(serial, "protocol_handler_packages", [*serial.protocol_handler_packages, "sim_instruments.bus"])
    opened = AfWorld(clock=VirtualClock(), seed=1, options={}, unit_factory=unit_at_23_degC)
    opened.unit.set_power(True, 0)
    opened.url = f"sim://{opened.id}/"
    yield opened
    opened.close()


def unit_at_23_degC(clock, seed, _thermal, _options):
    return Ngu(clock, seed, lambda t_ns: np.full(len(t_ns), 23.0))


def test_reads_what_has_arrived(world):
    with serial.serial_for_url(world.url + "port_a", baudrate=115_200, timeout=0) as port:
        world.clock.sleep(11.006)
        waiting = port.in_waiting
        received = port.read(waiting)
        assert len(received) == waiting == 57 * 1000
        assert port.in_waiting == 0
        assert port.read(100) == b""


def test_a_blocking_read_waits_in_bench_time(world):
    with serial.serial_for_url(world.url + "port_a", baudrate=115_200, timeout=0.5) as port:
        assert port.read(10) == b""
        assert world.clock.now_ns() == NS // 2
        port.timeout = None
        assert port.read(57)[:2] == b"\xeb\x90"
        assert NS + 14_000_000 < world.clock.now_ns() < NS + 17_000_000


def test_line_speed_is_the_one_the_port_was_opened_with(world):
    with serial.serial_for_url(world.url + "port_a", baudrate=921_600, timeout=0) as port:
        world.clock.sleep(1.0112)
        assert port.in_waiting == 57
        port.baudrate = 115_200
        world.clock.sleep(0.010)
        assert 57 < port.in_waiting < 57 + 20


def test_the_input_buffer_can_be_emptied(world):
    with serial.serial_for_url(world.url + "port_a", timeout=0) as port:
        world.clock.sleep(5)
        port.reset_input_buffer()
        assert port.in_waiting == 0


def test_commands_are_answered_on_port_b(world):
    definition = load_frame(find_shipped("frames", "ngu_b"))
    with serial.serial_for_url(world.url + "port_b", baudrate=115_200, timeout=0) as port:
        world.clock.sleep(2)
        port.reset_input_buffer()
        request = definition.encode_one({"command": 1, "payload": b""}, "command")
        assert port.write(request) == len(request)
        port.flush()
        assert port.out_waiting == 0
        world.clock.sleep(0.05)
        answer = definition.decoder().feed(port.read(1000)).messages["answer"]
        assert answer.raw("payload")[0] == b"NGU SIM-1 1.0"


def test_link_faults_of_the_world_damage_the_port(world):
    world.faults.link("port_a").silent = True
    with serial.serial_for_url(world.url + "port_a", baudrate=115_200, timeout=0) as port:
        world.clock.sleep(5)
        assert port.in_waiting == 0
        world.faults.link("port_a").silent = False
        world.clock.sleep(1)
        received = port.read(10_000)
    first = load_frame(find_shipped("frames", "ngu_a")).decoder().feed(received).messages["frame"]
    assert int(first.raw("counter")[0]) == 400


@pytest.mark.parametrize("place", ["port_c", "", "port_a/x"])
def test_a_port_that_does_not_exist_is_refused(world, place):
    with pytest.raises(LinkError) as caught:
        serial.serial_for_url(world.url + place)
    assert caught.value.code == "B-NGU-002"
    assert isinstance(caught.value, serial.SerialException)
    assert world.url in str(caught.value)


def test_a_world_that_is_gone_is_refused(world):
    world.close()
    with pytest.raises(serial.SerialException, match="B-NGU-002"):
        serial.serial_for_url(world.url + "port_a")


def test_a_closed_port_cannot_be_used(world):
    port = serial.serial_for_url(world.url + "port_a")
    with pytest.raises(serial.SerialException, match="already open"):
        port.open()
    port.close()
    for use in (lambda: port.in_waiting, lambda: port.read(1), lambda: port.write(b"x"), port.reset_input_buffer):
        with pytest.raises(serial.PortNotOpenError):
            use()
