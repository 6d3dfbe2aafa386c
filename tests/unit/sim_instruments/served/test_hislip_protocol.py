"""The HiSLIP server against bytes made by hand from IVI-6.1, for what PyVISA does not let a user send."""

import socket
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from sim_bench import RawClient, Served, Wire, serve, session_count
from waiting import until

from sim_instruments.served.hislip_server import MOST_SESSIONS, MOST_WAITING
from sim_instruments.served.hislip_wire import FatalProtocolError, Inbox, Message

FIRST = 0xFFFFFF00
IDENTITY = b"HEWLETT-PACKARD,6632B,SIM6632,A.03.01\n"


@contextmanager
def client(served: Served, name: bytes = b"hislip6") -> Iterator[RawClient]:
    made = RawClient(served.servers.hislip_port, name)
    try:
        yield made
    finally:
        made.close()


@pytest.fixture
def one(served: Served) -> Iterator[RawClient]:
    with client(served) as made:
        yield made


def test_messages_are_as_specified_and_found_in_pieces_of_any_size() -> None:
    message = Message(7, 1, 0xFFFFFF02, b"*IDN?")
    assert message.packed() == bytes.fromhex("4853 07 01 ffffff02 0000000000000005") + b"*IDN?"
    rng = np.random.default_rng(3)
    sent = [Message(int(rng.integers(0, 256)), 1, number, rng.bytes(int(rng.integers(0, 40)))) for number in range(200)]
    stream = b"".join(message.packed() for message in sent)
    for _ in range(20):
        inbox, found, at = Inbox(), [], 0
        while at < len(stream):
            size = int(rng.integers(1, 60))
            found += inbox.feed(stream[at : at + size])
            at += size
        assert found == sent


def test_too_large_a_message_is_skipped_without_being_kept() -> None:
    inbox = Inbox()
    found = inbox.feed(bytes.fromhex("4853 07 00 00000001 0000000000200000"))
    for _ in range(32):
        found += inbox.feed(bytes(65536))
    found += inbox.feed(Message(12, 0, 2).packed())
    assert [(message.type, message.too_large) for message in found] == [(7, True), (12, False)]
    with pytest.raises(FatalProtocolError, match="begins with"):
        inbox.feed(bytes(16))


def test_a_command_comes_in_several_messages_or_ends_with_a_line_feed(one: RawClient) -> None:
    one.sync.say(6, 0, FIRST, b"*I")
    one.sync.say(6, 0, FIRST + 2, b"DN")
    assert one.sync.silent()
    one.sync.say(7, 0, FIRST + 4, b"?")
    assert one.sync.hear() == (7, 0, FIRST + 4, IDENTITY)
    one.sync.say(6, 0, FIRST, b"*IDN?\n")
    assert one.sync.hear() == (7, 0, FIRST, IDENTITY)


def test_question_before_the_reply_is_sent_interrupts_it_on_both_channels(served: Served, one: RawClient) -> None:
    served.world.faults.instrument("supply").late_s = 30.0
    served.world.faults.instrument("supply").late_replies = 1
    one.send(b"*IDN?", FIRST)
    one.send(b"VOLT?", FIRST + 2)
    assert one.asynchronous.hear() == (14, 0, FIRST + 2, b"")
    assert one.sync.hear() == (13, 0, FIRST + 2, b"")
    assert one.sync.hear() == (7, 0, FIRST + 2, b"0.00000E+00\n")


def test_question_after_the_reply_is_sent_but_not_read_is_the_instruments_error_only(one: RawClient) -> None:
    one.send(b"*IDN?", FIRST)
    assert one.sync.hear()[2] == FIRST
    one.send(b"SYST:ERR?", FIRST + 2, delivered=False)
    assert one.sync.hear() == (7, 0, FIRST + 2, b'-410,"Query INTERRUPTED"\n')
    one.send(b"SYST:ERR?", FIRST + 4, delivered=True)
    assert one.sync.hear() == (7, 0, FIRST + 4, b'+0,"No error"\n')
    assert one.asynchronous.silent()


def test_status_tells_a_reply_until_it_is_said_to_be_delivered(one: RawClient) -> None:
    one.send(b"*IDN?", FIRST)
    one.sync.hear()
    assert [one.status(FIRST), one.status(FIRST), one.status(FIRST, delivered=True), one.status(FIRST)] == [
        16,
        16,
        0,
        0,
    ]
    one.send(b"SYST:ERR?", FIRST + 2)
    assert one.sync.hear()[3] == b'+0,"No error"\n'


def test_commands_that_have_arrived_come_before_the_poll(one: RawClient) -> None:
    for number in range(100):
        one.send(b"NONSENSE", FIRST)
        assert one.status() == 4, number
        one.send(b"*CLS", FIRST)
        assert one.status() == 0, number


def test_a_device_clear_drops_input_output_late_replies_and_what_comes_meanwhile(
    one: RawClient, served: Served
) -> None:
    one.asynchronous.say(19)
    assert one.asynchronous.hear()[0] == 23
    one.send(b"VOLT 9", FIRST + 8)
    one.send(b"*IDN?", FIRST + 10)
    one.sync.say(8, 1)
    assert one.sync.hear() == (9, 0, 0, b"")
    one.send(b"VOLT?", FIRST)
    assert one.sync.hear() == (7, 0, FIRST, b"0.00000E+00\n")
    one.sync.say(8)
    assert one.sync.hear()[:2] == (3, 0)
    faults = served.world.faults.instrument("supply")
    faults.late_s, faults.late_replies = 0.3, 1
    one.sync.say(6, 0, FIRST, b"VOLT 12;")
    one.send(b"*IDN?", FIRST + 2)
    one.sync.say(6, 0, FIRST + 4, b"VOLT 19")
    one.clear()
    one.send(b"VOLT?", FIRST)
    assert one.sync.hear() == (7, 0, FIRST, b"1.20000E+01\n")
    assert one.sync.silent(0.5)


def test_a_meter_is_triggered_by_message_and_its_reply_has_no_end() -> None:
    with serve() as served, client(served, b"hislip2") as one:
        one.send(b"ID?", FIRST)
        assert one.sync.hear() == (6, 0, FIRST, b"HP3458A\r\n")
        for number, command in enumerate((b"END ALWAYS", b"NPLC 1", b"TRIG HOLD")):
            one.send(command, FIRST + 2 * number)
        one.sync.say(12, 0, 0x42)
        kind, _, number, reading = one.sync.hear()
        assert (kind, number) == (7, 0x42)
        float(reading)


@pytest.mark.parametrize("control", range(7))
def test_remote_and_local_are_accepted(one: RawClient, control: int) -> None:
    one.asynchronous.say(10, control, FIRST)
    assert one.asynchronous.hear() == (11, 0, 0, b"")


def test_messages_that_are_refused_leave_the_session_open(one: RawClient) -> None:
    for wire in (one.sync, one.asynchronous):
        for kind, reason in ((99, 1), (26, 1), (200, 3), (5, 1)):
            wire.say(kind, 0, 0, b"whatever")
            answer, control, _, text = wire.hear()
            assert (answer, control) == (3, reason)
            assert str(kind) in text.decode()
    one.asynchronous.say(10, 7)
    assert one.asynchronous.hear()[:2] == (3, 2)
    one.asynchronous.say(4, 2)
    assert one.asynchronous.hear()[:2] == (3, 2)
    one.sync.say(7, 0, FIRST, bytes(1 << 20))
    assert one.sync.hear()[:2] == (3, 4)
    one.sync.say(3, 0, 0, b"the client did not like something")
    one.send(b"*IDN?", FIRST)
    assert one.sync.hear() == (7, 0, FIRST, IDENTITY)
    for _ in range(2):
        one.sync.say(6, 0, FIRST, b"x" * 600_000)
    assert one.sync.hear()[:2] == (3, 4)
    one.send(b"*IDN?", FIRST)
    assert one.sync.hear() == (7, 0, FIRST, IDENTITY)


@pytest.mark.parametrize("channel", ["sync", "asynchronous"])
def test_bad_header_ends_the_session_on_both_channels(served: Served, one: RawClient, channel: str) -> None:
    getattr(one, channel).sock.sendall(b"GET / HTTP/1.1\r\n\r\n")
    for wire in (one.sync, one.asynchronous):
        assert wire.hear()[:2] == (2, 1)
        assert wire.ended()
    with client(served) as another:
        assert another.status() == 0


def test_fatal_errors_end_the_session(served: Served) -> None:
    port = served.servers.hislip_port
    for kind, payload, reason in ((7, b"*IDN?", 3), (17, b"", 3), (0, b"hislip10", 3), (0, b"inst0", 3), (0, b"", 3)):
        wire = Wire(port)
        wire.say(kind, 0, 0x0100_0000, payload)
        assert wire.hear()[:2] == (2, reason)
        assert wire.ended()
        wire.sock.close()
    half = Wire(port)
    half.say(0, 0, 0x0200_0000, b"hislip0")
    assert half.hear()[2] >> 16 == 0x0100
    half.say(7, 0, FIRST, b"*IDN?")
    assert half.hear()[:2] == (2, 2)
    assert half.ended()
    half.sock.close()
    for kind, payload, reason in ((0, b"hislip6", 3), (17, b"", 3), (15, b"1234", 1)):
        with client(served) as one:
            one.asynchronous.say(kind, 0, 0, payload)
            assert one.asynchronous.hear()[:2] == (2, reason)
            assert one.asynchronous.ended()


def test_locks_exclusive_shared_and_their_answers(served: Served, one: RawClient) -> None:
    with client(served) as two, client(served) as three:
        assert one.lock() == 1
        assert (one.lock(), two.lock(), two.lock(b"key")) == (3, 0, 0)
        assert (one.unlock(), one.unlock()) == (1, 3)
        assert (one.lock(b"key"), two.lock(b"key"), three.lock(b"other")) == (2, 2, 0)
        two.asynchronous.say(24)
        assert two.asynchronous.hear() == (25, 0, 2, b"")
        assert (two.lock(b"key"), three.lock(), two.lock()) == (3, 0, 1)
        two.asynchronous.say(24)
        assert two.asynchronous.hear() == (25, 1, 2, b"")
        assert (two.unlock(), two.unlock(), one.unlock()) == (1, 2, 2)
        assert three.lock() == 1


def test_lock_is_waited_for_and_given_back_by_a_client_that_goes(served: Served, one: RawClient) -> None:
    with client(served) as two:
        assert one.lock() == 1
        assert two.lock(timeout_ms=50) == 0
        two.asynchronous.say(4, 1, 60_000)
        assert two.asynchronous.silent()
        one.close()
        assert two.locked() == 1


def test_commands_of_a_client_that_is_shut_out_wait_and_its_polls_do_not(served: Served, one: RawClient) -> None:
    with client(served) as two, client(served, b"hislip4") as neighbour:
        assert one.lock() == 1
        two.send(b"VOLT?", FIRST)
        assert two.status() == 0
        two.asynchronous.say(15, 0, 0, bytes(7) + b"\xff")
        assert two.asynchronous.hear()[0] == 16
        assert two.sync.silent()
        neighbour.send(b"*IDN?", FIRST)
        assert neighbour.sync.hear()[3].startswith(b"Agilent")
        one.send(b"VOLT 4", FIRST)
        assert one.status() == 0
        assert one.unlock() == 1
        assert two.sync.hear() == (7, 0, FIRST, b"4.00000E+00\n")
        assert one.lock() == 1
        two.clear()


def test_commands_of_a_client_that_died_while_shut_out_are_not_carried_out(served: Served, one: RawClient) -> None:
    assert one.lock() == 1
    two = RawClient(served.servers.hislip_port)
    two.send(b"VOLT 19", FIRST)
    assert two.status() == 0
    two.close()
    until(lambda: session_count() == 1)
    assert one.unlock() == 1
    one.send(b"VOLT?", FIRST)
    assert one.sync.hear()[3] == b"0.00000E+00\n"


def test_clients_have_a_limit_and_places_become_free(served: Served) -> None:
    clients = [RawClient(served.servers.hislip_port) for _ in range(MOST_SESSIONS)]
    wire = Wire(served.servers.hislip_port)
    wire.say(0, 0, 0x0100_0000, b"hislip0")
    assert wire.hear()[:2] == (2, 4)
    wire.sock.close()
    for one in clients:
        one.close()
    until(lambda: session_count() == 0)
    with client(served) as one:
        assert one.status() == 0


def test_connections_that_never_begin_give_way(served: Served) -> None:
    idle = [
        socket.create_connection(("127.0.0.1", served.servers.hislip_port), timeout=10)
        for _ in range(MOST_WAITING + 10)
    ]
    with client(served) as one:
        assert one.status() == 0
    assert idle[0].recv(1) == b""
    for sock in idle:
        sock.close()
