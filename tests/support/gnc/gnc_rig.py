"""What the tests of the simulated GNC bench share: a bench on a virtual clock, and a host that packs bytes itself.

Frames and payloads are packed and taken apart here by hand, with the check of the standard library (crc_hqx is
CRC-16/CCITT-FALSE with 0xFFFF to begin with): not with the frame file that the simulated board uses.
"""

from __future__ import annotations

import binascii
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

import pyvisa

from bench.model.clock import VirtualClock
from sim_instruments.worlds.gnc.board import GncBoard
from sim_instruments.worlds.simulation import open_world

SUPPLY, DMM = "GPIB0::5::INSTR", "GPIB0::23::INSTR"
STATION = {
    "instruments": {
        "supply": {"driver": "hp_6632b", "resource": SUPPLY},
        "rail_dmm": {"driver": "agilent_34401a", "resource": DMM},
    },
    "links": {"rs422": {"frame": "gnc_422", "baud": 921600}},
}
COMMAND, ANSWER, STREAM, REFUSAL = 0x01, 0x81, 0x02, 0x7F
BAUD = 921_600
STEP_S = 0.002
PATIENCE_S = 2.5


@dataclass(frozen=True)
class Frame:
    """One frame from the board."""

    destination: int
    source: int
    sequence: int
    kind: int
    command: int
    payload: bytes


def packed(command: int, payload: bytes = b"", *, sequence: int = 0, destination: int = 0x10, source: int = 1) -> bytes:
    body = struct.pack("<6BH", 1, destination, source, sequence, COMMAND, command, len(payload)) + payload
    return b"\xeb\x90" + body + struct.pack("<H", binascii.crc_hqx(body, 0xFFFF))


def frames_in(received: bytes) -> list[Frame]:
    """All sound frames, found by going on one byte behind anything else."""
    found, at = [], 0
    while (at := received.find(b"\xeb\x90", at)) >= 0:
        if at + 12 <= len(received):
            stop = at + 10 + int.from_bytes(received[at + 8 : at + 10], "little")
            body = received[at + 2 : stop]
            if (
                stop + 2 <= len(received)
                and struct.pack("<H", binascii.crc_hqx(body, 0xFFFF)) == received[stop : stop + 2]
            ):
                found.append(Frame(*body[1:6], body[8:]))
                at = stop + 2
                continue
        at += 1
    return found


class Host:
    """A bench with a GNC module, and what a person and a controller do with it."""

    def __init__(self, seed: int, options: Mapping[str, str], serial: str) -> None:
        self.clock = VirtualClock()
        self.world = open_world("gnc_module", clock=self.clock, seed=seed, station=STATION, options=options)
        self.world.operate("unit", serial)
        self.board: GncBoard = self.world.unit
        self.board.connect("rs422", BAUD, self.world.faults.link("rs422"))
        self._sequence = 0
        self._manager: pyvisa.ResourceManager | None = None

    def close(self) -> None:
        if self._manager is not None:
            self._manager.close()
        self.world.close()

    def instrument(self, address: str):
        self._manager = self._manager or pyvisa.ResourceManager(self.world.visa_library)
        return self._manager.open_resource(address, read_termination="\n", write_termination="\n")

    def power(self, on: bool = True) -> None:
        self.board.set_power(on, self.clock.now_ns(), 5.0 if on else 0.0)

    def read(self) -> bytes:
        return self.board.read("rs422", 10_000_000)

    def exchange(self, command: int, payload: bytes = b"", sequence: int | None = None) -> Frame | None:
        """Send a command and wait for the frame that belongs to it; None if nothing comes."""
        if sequence is None:
            self._sequence = sequence = (self._sequence + 1) % 256
        self.board.write("rs422", packed(command, payload, sequence=sequence))
        deadline_ns = self.clock.now_ns() + int(PATIENCE_S * 1e9)
        received = b""
        while self.clock.now_ns() < deadline_ns:
            self.clock.sleep(STEP_S)
            if fresh := self.read():
                received += fresh
                for frame in frames_in(received):
                    if frame.kind != STREAM and (frame.sequence, frame.command) == (sequence, command):
                        return frame
        return None

    def ask(self, command: int, form: str = "", *values: int, extra: bytes = b"") -> tuple[int, bytes]:
        """Status and payload behind it; (-1, b"") if nobody answers."""
        frame = self.exchange(command, struct.pack("<" + form, *values) + extra)
        return (-1, b"") if frame is None else (frame.payload[0], frame.payload[1:])


@contextmanager
def open_host(
    seed: int = 1, serial: str = "GNC-01", *, on: bool = True, options: Mapping[str, str] | None = None
) -> Iterator[Host]:
    """A host whose module has booted."""
    host = Host(seed, options or {}, serial)
    try:
        if on:
            host.power()
            host.clock.sleep(1.6)
        yield host
    finally:
        host.close()
