"""Simulated instruments behind raw sockets, for other people's drivers."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from pyvisa.constants import StatusCode
from pyvisa.errors import VisaIOError
from sim_bench import DRIVERS
from sim_served import LIMIT_S, RawClient, Served

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


def test_every_instrument_has_a_port_of_its_own(served: Served) -> None:
    sockets = served.servers.sockets()
    assert list(sockets) == list(DRIVERS)
    assert len(set(sockets.values())) == len(DRIVERS)
    for role, driver in DRIVERS.items():
        answer = served.open_socket(role).query({"dmm": "ID?", "chamber": "IDEN?"}.get(role, "*IDN?"))
        assert driver.rpartition("_")[2].upper()[:4] in answer.upper()


def test_commands_sent_at_once_are_answered_in_order(sock: socket.socket) -> None:
    sock.sendall(b"VOLT 3\nVOLT?\r\n*IDN?\n\nSYST:ERR?\n")
    assert lines(sock, 3) == [b"3.00000E+00\n", IDENTITY, b'+0,"No error"\n']


def test_more_commands_than_are_taken_in_advance(served: Served, sock: socket.socket) -> None:
    served.no_latency()
    sock.sendall(b"".join(b"*ESE %d;*ESE?\n" % (number % 256) for number in range(2000)))
    assert lines(sock, 2000) == [b"%d\n" % (number % 256) for number in range(2000)]


def test_client_that_has_sent_everything_and_closes_its_side_is_still_answered(sock: socket.socket) -> None:
    sock.sendall(b"*IDN?\nVOLT?\nVOLT")
    sock.shutdown(socket.SHUT_WR)
    assert lines(sock, 3) == [IDENTITY, b"0.00000E+00\n"]


def test_client_that_goes_in_the_middle_leaves_the_instrument_usable(served: Served) -> None:
    with plain(served) as sock:
        sock.sendall(b"*IDN?\nVOLT 19")
    with plain(served) as sock:
        sock.sendall(b"VOLT?\nSYST:ERR?\n")
        assert lines(sock, 2) == [b"0.00000E+00\n", b'+0,"No error"\n']


def test_line_without_an_end_closes_the_connection(served: Served, sock: socket.socket) -> None:
    with pytest.raises(OSError, match=r"reset|pipe"):
        sock.sendall(bytes(64 << 20))
    with plain(served) as another:
        another.sendall(b"*IDN?\n")
        assert lines(another, 1) == [IDENTITY]


def test_late_reply_comes_late_and_a_mute_instrument_says_nothing(served: Served) -> None:
    supply = served.open_socket("supply", 100)
    faults = served.world.faults.instrument("supply")
    faults.late_s, faults.late_replies = 0.3, 1
    with pytest.raises(VisaIOError) as caught:
        supply.query("VOLT?")
    assert caught.value.error_code == StatusCode.error_timeout
    supply.timeout = 5000
    assert supply.read() == "0.00000E+00"
    faults.mute = True
    supply.timeout = 100
    with pytest.raises(VisaIOError):
        supply.query("VOLT?")
    faults.mute = False
    supply.timeout = 5000
    assert supply.query("VOLT?") == "0.00000E+00"


def test_hung_instrument_forgets_what_it_is_told(served: Served, sock: socket.socket) -> None:
    served.world.faults.instrument("supply").hang = True
    sock.sendall(b"VOLT 9\nVOLT?\n")
    sock.settimeout(0.2)
    with pytest.raises(TimeoutError):
        sock.recv(1)
    sock.settimeout(LIMIT_S)
    served.world.faults.instrument("supply").hang = False
    sock.sendall(b"VOLT?\n")
    assert lines(sock, 1) == [b"0.00000E+00\n"]


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
