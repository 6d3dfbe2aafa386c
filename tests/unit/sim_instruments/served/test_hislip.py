"""Simulated instruments over HiSLIP and raw sockets, reached by stock PyVISA with pyvisa-py; late replies."""

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from pyvisa.errors import VisaIOError
from sim_bench import DRIVERS, LIMIT_S, RawClient, Served, descriptors, serve, threads

from bench.model.clock import VirtualClock
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


IDENTITY = b"HEWLETT-PACKARD,6632B,SIM6632,A.03.01\n"


@contextmanager
def plain(served: Served, role: str = "supply") -> Iterator[socket.socket]:
    """A plain TCP connection, as netcat makes one."""
    port = int(served.servers.sockets()[role].split("::")[2])
    with socket.create_connection(("127.0.0.1", port), timeout=LIMIT_S) as sock:
        yield sock


@pytest.fixture
def sock(served: Served) -> Iterator[socket.socket]:
    with plain(served) as opened:
        yield opened


def lines(sock: socket.socket, count: int) -> list[bytes]:
    received = b""
    while received.count(b"\n") < count:
        chunk = sock.recv(4096)
        if not chunk:
            break
        received += chunk
    return received.splitlines(keepends=True)


def test_commands_sent_at_once_are_answered_in_order(sock: socket.socket) -> None:
    sock.sendall(b"VOLT 3\nVOLT?\r\n*IDN?\n\nSYST:ERR?\n")
    assert lines(sock, 3) == [b"3.00000E+00\n", IDENTITY, b'+0,"No error"\n']
    sock.sendall(b"*IDN?\nVOLT?\nVOLT")
    sock.shutdown(socket.SHUT_WR)
    assert lines(sock, 3) == [IDENTITY, b"3.00000E+00\n"]


def test_more_commands_than_are_taken_in_advance(served: Served, sock: socket.socket) -> None:
    served.no_latency()
    sock.sendall(b"".join(b"*ESE %d;*ESE?\n" % (number % 256) for number in range(2000)))
    assert lines(sock, 2000) == [b"%d\n" % (number % 256) for number in range(2000)]


def test_line_without_an_end_closes_the_connection(served: Served, sock: socket.socket) -> None:
    with pytest.raises(OSError, match=r"reset|pipe"):
        sock.sendall(bytes(64 << 20))
    with plain(served) as another:
        another.sendall(b"*IDN?\n")
        assert lines(another, 1) == [IDENTITY]


def test_lock_over_hislip_keeps_a_raw_socket_waiting(served: Served, sock: socket.socket) -> None:
    holder = RawClient(served.servers.hislip_port)
    assert holder.lock() == 1
    sock.sendall(b"VOLT?\n")
    sock.settimeout(0.1)
    with pytest.raises(TimeoutError):
        sock.recv(1)
    sock.settimeout(LIMIT_S)
    holder.close()
    assert lines(sock, 1) == [b"0.00000E+00\n"]
