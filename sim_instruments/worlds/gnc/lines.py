"""Digital interfaces of the simulated GNC module on its test board: four IO lines, SPI, SCI, CAN.

The four lines are nets of pins: a driver that pulls low wins (so a short is an AND), and a line that nobody drives is
pulled down. SPI's CS, CLK, SDIN and SDOUT run over the same four lines, so what is wrong with a line is wrong there.
Paper 001, section 3 (2) 1-3.
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass

LINES = (1, 2, 3, 4)
CS, CLK, SDIN, SDOUT = LINES
SPI_BITS = 16


@dataclass(frozen=True)
class Wires:
    """Where the lines of the module really go, by its faults."""

    faults: Set[str]

    def pin(self, line: int) -> int | None:
        """Pin of the socket at which a line of the module arrives; None: at none."""
        if "io_open" in self.faults and line == 4:
            return None
        if "io_swapped" in self.faults and line in (3, 4):
            return 7 - line
        return line

    def pins(
        self, driven: Mapping[int, int], outside: Mapping[int, int], joined: Set[int] = frozenset()
    ) -> dict[int, int]:
        """Level at each pin of the socket.

        Args: driven: level by line of the module.   outside: level by pin, driven from elsewhere.
            joined: pins the board connects with each other.
        """
        nets = self._nets(joined)
        drivers: dict[int, list[int]] = {number: [] for number in nets.values()}
        for line, level in driven.items():
            if (pin := self.pin(line)) is not None:
                drivers[nets[pin]].append(level)
        for pin, level in outside.items():
            drivers[nets[pin]].append(level)
        if "io_stuck_low" in self.faults:
            drivers[nets[2]].append(0)
        return {pin: min(drivers[number], default=0) for pin, number in nets.items()}

    def read(self, pins: Mapping[int, int]) -> list[int]:
        """Return what the module reads on its lines 1 to 4; one that reaches no pin is pulled down inside."""
        places = (self.pin(line) for line in LINES)
        return [0 if pin is None else pins[pin] for pin in places]

    def _nets(self, joined: Set[int]) -> dict[int, int]:
        """Return number of the net of each pin."""
        nets = {pin: pin for pin in LINES}
        groups = [set(joined)] + ([{2, 3}] if "io_short" in self.faults else [])
        for group in groups:
            numbers = {nets[pin] for pin in group}
            for pin, number in nets.items():
                if number in numbers:
                    nets[pin] = min(numbers)
        return nets


def io_test(faults: Set[str], output: int, source: int, level: int) -> tuple[int, int]:
    """Level read at line ``source`` while line ``output`` is driven, and the bits of the two other lines.

    The board joins the two pins; the other lines are driven low.
    """
    wires = Wires(faults)
    driven = {line: 0 for line in LINES if line not in (output, source)} | {output: level}
    read = wires.read(wires.pins(driven, {}, frozenset((output, source))))
    others = sum(bit << (line - 1) for line, bit in zip(LINES, read, strict=True) if line not in (output, source))
    return read[source - 1], others


def spi_test(faults: Set[str], word: int) -> tuple[int, int]:
    """Return a word sent by the SPI and seen by the IO lines, then sent back by them: what came back, what was seen.

    The SPI has its own way to the socket's pins 1 to 4, where the IO lines of the module end.
    """
    wires = Wires(faults)
    clocks = SPI_BITS - 1 if "spi_lost_clock" in faults else SPI_BITS
    observed = 0
    for bit in _bits(word)[:clocks]:
        low, high = (wires.read(wires.pins({SDIN: 0}, {CS: 0, CLK: clock, SDOUT: bit})) for clock in (0, 1))
        if high[CS - 1] == 0 and (low[CLK - 1], high[CLK - 1]) == (0, 1):  # an edge of the clock while selected
            observed = observed << 1 | high[SDOUT - 1]
    received = 0
    for bit in _bits(observed):
        received = received << 1 | wires.pins({SDIN: bit}, {CS: 0, CLK: 1, SDOUT: 0})[SDIN]
    if "spi_receive_bit" in faults:
        received &= ~(1 << 5)
    return received, observed


def _bits(word: int) -> list[int]:
    return [word >> place & 1 for place in reversed(range(SPI_BITS))]


def sci_test(faults: Set[str], pattern: bytes) -> bytes:
    """Return what comes back over the asynchronous interface."""
    if "sci_silent" in faults:
        return b""
    if "sci_bit_errors" not in faults:
        return pattern
    return bytes(byte ^ (0x08 if place % 4 == 0 else 0) for place, byte in enumerate(pattern))


def can_test(faults: Set[str], identifier: int, pattern: bytes) -> tuple[int, bytes] | None:
    """Identifier and bytes that come back over the CAN bus; None: bus off."""
    if "can_bus_off" in faults:
        return None
    return (identifier ^ 0b100 if "can_identifier" in faults else identifier), pattern
