"""Simulated instruments over HiSLIP, reached by stock PyVISA with pyvisa-py."""

from __future__ import annotations

import gc
import socket
import subprocess
import sys
import warnings
from pathlib import Path

import pytest
from pyvisa.constants import StatusCode
from pyvisa.errors import VisaIOError
from pyvisa_py.common import LOGGER
from sim_bench import DRIVERS
from sim_served import RawClient, Served, descriptors, serve, threads

from bench.model.clock import VirtualClock, WallClock
from sim_instruments.served.process import InstrumentServers
from sim_instruments.worlds.simulation import open_world


def test_addresses_follow_the_order_of_the_roles_and_everyone_answers(served: Served) -> None:
    resources = served.servers.resources()
    assert list(resources) == list(DRIVERS)
    for number, (role, driver) in enumerate(DRIVERS.items()):
        assert resources[role] == f"TCPIP0::127.0.0.1::hislip{number},{served.servers.hislip_port}::INSTR"
        session = served.open(role)
        if role == "dmm":
            session.write("END ALWAYS")
        answer = session.query({"dmm": "ID?", "chamber": "IDEN?"}.get(role, "*IDN?"))
        assert driver.rpartition("_")[2].upper()[:4] in answer.upper()


def test_only_the_loopback_interface_is_bound_and_only_real_time_is_served() -> None:
    with serve() as served:
        ports = {served.servers.hislip_port}
        ports |= {int(address.split("::")[2]) for address in served.servers.sockets().values()}
        bound = {}
        for line in Path("/proc/self/net/tcp").read_text(encoding="ascii").splitlines()[1:]:
            address, port = line.split()[1].split(":")
            if line.split()[3] == "0A" and int(port, 16) in ports:
                bound[int(port, 16)] = address
        assert bound == dict.fromkeys(ports, "0100007F")
        with pytest.raises(ValueError, match="loopback"):
            InstrumentServers(served.world, host="0.0.0.0")
    world = open_world("af_converter", clock=VirtualClock(), seed=1, station={"instruments": {}})
    with pytest.raises(ValueError, match="virtual"):
        InstrumentServers(world)
    world.close()


def test_port_can_be_chosen_and_a_taken_one_is_an_error_that_leaves_nothing(served: Served) -> None:
    before = descriptors()
    with pytest.raises(OSError, match="in use"):
        InstrumentServers(served.world, ports={"hislip": served.servers.hislip_port})
    assert descriptors() == before
    port = served.servers.hislip_port
    served.servers.close()
    again = InstrumentServers(served.world, ports={"hislip": port})
    assert again.hislip_port == port
    again.close()


def test_serial_poll_shows_message_available_until_it_is_read_and_errors(served: Served) -> None:
    supply = served.open("supply")
    assert supply.read_stb() == 0
    supply.write("*IDN?")
    while not supply.read_stb() & 16:
        pass
    assert supply.read_stb() == 16
    assert supply.read().startswith("HEWLETT-PACKARD,6632B")
    assert supply.read_stb() == 0
    supply.write("NONSENSE")
    assert supply.read_stb() == 4
    assert supply.query("SYST:ERR?") == '-113,"Undefined header"'


def test_serial_poll_while_a_reply_is_pending(served: Served) -> None:
    dmm = served.open("dmm")
    for command in ("END ALWAYS", "NPLC 50", "TRIG HOLD"):
        dmm.write(command)
    dmm.write("TRIG SGL")
    polls = [dmm.read_stb()]
    while not polls[-1] & 128:
        polls.append(dmm.read_stb())
    assert polls[0] == 16
    assert len(polls) > 2
    assert abs(float(dmm.read())) < 1.0
    assert dmm.read_stb() == 16


def test_reply_in_parts_and_its_end(served: Served) -> None:
    counter = served.open("counter")
    counter.write("*IDN?")
    assert counter.read_bytes(7) == b"Agilent"
    assert counter.read_raw().endswith(b"-35\n")
    assert counter.query("*IDN?").startswith("Agilent Technologies,53230A")


def test_a_small_largest_message_cuts_the_reply(served: Served) -> None:
    client = RawClient(served.servers.hislip_port)
    client.asynchronous.say(15, 0, 0, (16 + 10).to_bytes(8, "big"))
    assert client.asynchronous.hear() == (16, 0, 0, (1 << 20).to_bytes(8, "big"))
    client.send(b"*IDN?", 0xFFFFFF00)
    pieces = [client.sync.hear()]
    while pieces[-1][0] == 6:
        pieces.append(client.sync.hear())
    assert [len(piece[3]) for piece in pieces[:-1]] == [10] * (len(pieces) - 1)
    assert len(pieces) > 2
    assert pieces[-1][0] == 7
    assert b"".join(piece[3] for piece in pieces) == b"HEWLETT-PACKARD,6632B,SIM6632,A.03.01\n"
    client.close()


def test_device_clear_drops_what_was_said_and_what_was_asked(served: Served) -> None:
    supply = served.open("supply")
    served.world.faults.instrument("supply").late_s = 0.2
    served.world.faults.instrument("supply").late_replies = 1
    supply.write("*IDN?")
    supply.clear()
    assert supply.read_stb() == 0
    supply.timeout = 400
    with pytest.raises(VisaIOError) as caught:
        supply.read()
    assert caught.value.error_code == StatusCode.error_timeout
    supply.timeout = 5000
    assert supply.query("SYST:ERR?") == '+0,"No error"'


def test_mute_instrument_times_out_is_polled_and_answers_again(served: Served) -> None:
    supply = served.open("supply", 200)
    served.world.faults.instrument("supply").mute = True
    with pytest.raises(VisaIOError) as caught:
        supply.query("VOLT?")
    assert caught.value.error_code == StatusCode.error_timeout
    assert supply.read_stb() == 0
    served.world.faults.instrument("supply").mute = False
    supply.clear()
    assert supply.query("VOLT?") == "0.00000E+00"


def test_hung_instrument_answers_not_even_a_poll_and_its_neighbour_does(served: Served) -> None:
    supply, counter = served.open("supply", 200), served.open("counter")
    served.world.faults.instrument("supply").hang = True
    supply.write("VOLT 5")
    with pytest.raises(OSError, match="timed out"):
        supply.read_stb()
    assert counter.query("*IDN?").startswith("Agilent")
    supply.close()
    again = served.open("supply", 200)
    with pytest.raises(VisaIOError):
        again.query("VOLT?")
    served.world.faults.instrument("supply").hang = False
    assert again.query("VOLT?") == "0.00000E+00"


def test_one_instrument_does_not_wait_for_another(served: Served) -> None:
    slow, quick = served.open("dmm"), served.open("supply")
    for command in ("END ALWAYS", "NPLC 100", "TRIG HOLD", "TRIG SGL"):
        slow.write(command)
    for _ in range(20):
        assert quick.query("VOLT?") == "0.00000E+00"
    assert not slow.read_stb() & 128


def test_two_sessions_on_one_instrument_share_its_state_and_not_their_replies(served: Served) -> None:
    controller, guard = served.open("supply"), served.open("supply")
    controller.write("VOLT 7")
    assert controller.query("VOLT?") == "7.00000E+00"
    assert guard.query("VOLT?") == "7.00000E+00"
    controller.write("*IDN?")
    assert guard.query("CURR?") == "5.12000E-01"
    guard.clear()
    assert controller.read().startswith("HEWLETT-PACKARD")
    assert guard.query("SYST:ERR?") == '+0,"No error"'


def test_unknown_sub_address_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LOGGER.logger, "disabled", True)  # a log that is kept would keep the traceback, and its socket
    with serve() as served:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ResourceWarning)  # pyvisa-py leaves the socket of a failed opening open
            with pytest.raises(VisaIOError) as caught:
                served.visa.open_resource(f"TCPIP0::127.0.0.1::hislip10,{served.servers.hislip_port}::INSTR")
            assert caught.value.error_code == StatusCode.error_resource_not_found
            del caught
            gc.collect()
        assert served.open("supply").query("VOLT?") == "0.00000E+00"


KILLED = """
import os, signal, sys, pyvisa
r = pyvisa.ResourceManager("@py").open_resource(sys.argv[1], write_termination="\\n", read_termination="\\n")
assert r.visalib.sessions[r.session].interface.async_lock_request(1.0) == "success"
r.write("VOLT 3")
assert r.query("VOLT?") == "3.00000E+00"
r.write("*IDN?")
interface = r.visalib.sessions[r.session].interface
interface._sync.sendall(b"HS\\x07\\x00" + bytes(11) + b"\\x20" + b"VOLT 19")
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_client_killed_in_the_middle_leaves_the_instrument_free(served: Served) -> None:
    address = served.servers.resources()["supply"]
    died = subprocess.run([sys.executable, "-c", KILLED, address], check=False, timeout=60)
    assert died.returncode == -9
    client = RawClient(served.servers.hislip_port)
    assert client.lock(timeout_ms=5000) == 1
    client.close()
    supply = served.open("supply")
    assert supply.query("VOLT?") == "3.00000E+00"
    assert supply.query("SYST:ERR?") == '+0,"No error"'


def test_closing_leaves_no_thread_no_port_and_no_descriptor() -> None:
    with serve() as served:  # whatever is made once per process is made now
        served.open("supply").query("*IDN?")
    before = descriptors()
    for _ in range(3):
        with serve() as served:
            sessions = [served.open(role) for role in DRIVERS] + [served.open_socket("supply")]
            half_open = socket.create_connection(("127.0.0.1", served.servers.hislip_port))
            sessions[0].write("*IDN?")
            port = served.servers.hislip_port
            assert len(threads()) > len(DRIVERS)
            served.servers.close()
            served.servers.close()
            half_open.close()
            with pytest.raises(ConnectionRefusedError):
                socket.create_connection(("127.0.0.1", port))
        assert threads() == set()
        assert descriptors() == before


def test_sessions_that_come_and_go_leave_nothing(served: Served) -> None:
    served.open("supply").close()
    before = descriptors()
    for _ in range(200):
        session = served.open("supply")
        session.write("*IDN?")
        session.close()
    wait = WallClock()
    for _ in range(1000):
        if descriptors() <= before:
            break
        wait.sleep(0.01)
    assert descriptors() <= before
    assert served.open("supply").query("VOLT?") == "0.00000E+00"
