"""The simulated GNC bench as a process of its own: a terminal for its link, a socket for what a person does."""

from __future__ import annotations

import binascii
import struct
from collections.abc import Iterator

import pytest
import serial
from served_bench import CLOCK, Served

PATIENCE_S = 10.0


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    bench = Served(tmp_path_factory.mktemp("bench") / "sim", "gnc_bench_sim")
    for message in ("VOLT 5", "CURR 0.6", "OUTP ON"):
        bench["supply"].write(message)
    yield bench
    assert bench.end() == 0


def frame(command: int, payload: bytes, sequence: int) -> bytes:
    body = struct.pack("<6BH", 1, 0x10, 0x01, sequence, 0x01, command, len(payload)) + payload
    return b"\xeb\x90" + body + struct.pack("<H", binascii.crc_hqx(body, 0xFFFF))


def serial_number(served: Served, sequence: int) -> str:
    """Ask the module who it is until it has booted."""
    head = b"\xeb\x90\x01\x01\x10" + bytes([sequence])
    end_ns = CLOCK.now_ns() + round(PATIENCE_S * 1e9)
    received = b""
    with serial.Serial(str(served.folder / "rs422"), timeout=0.2, exclusive=True) as port:
        while CLOCK.now_ns() < end_ns:
            port.write(frame(0x01, b"", sequence))
            received += port.read(40)
            at = received.find(head)
            if at >= 0 and len(received) >= at + 40:
                return received[at + 24 : at + 36].decode().strip()
    raise AssertionError(f"no answer: {received!r}")


def test_a_module_answers_at_its_terminal_and_another_one_after_a_change(served: Served) -> None:
    assert serial_number(served, 1) == "GNC-01"
    served.fault("operate", "unit", "GNC-05")
    assert serial_number(served, 2) == "GNC-05"


def test_what_nobody_can_do_comes_back_as_an_error(served: Served) -> None:
    with pytest.raises(AssertionError, match="B-SIM-018"):
        served.fault("operate", "chamber", "1")
    with pytest.raises(AssertionError, match="B-SIM-019"):
        served.fault("operate", "dip_switch", "7")


def test_the_state_tells_that_the_module_is_powered(served: Served) -> None:
    assert served.state()["unit"]["powered"]
