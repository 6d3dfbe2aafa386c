"""A simulated unit with one serial port, as the URL handler and the world ask for it."""

from __future__ import annotations

import threading
from typing import ClassVar

from sim_instruments.faults.switchboard import LinkFaults
from sim_instruments.worlds.common.port import Int64, Port


class OnePortUnit:
    """Base of such units: they say how their port is called, and send what is due in ``_upto_now``.

    Attributes: port: the port.   lock: held while the unit does anything.
    """

    port_name: ClassVar[str]

    def __init__(self) -> None:
        self.port = Port()
        self.lock = threading.RLock()

    def has_port(self, name: str) -> bool:
        """Return whether the unit has a port of this name."""
        return name == self.port_name

    def connect(self, name: str, baud: int, faults: LinkFaults | None = None) -> None:
        """Listen to the port from now on; ``faults`` damages what is sent from now on."""
        del name
        with self.lock:
            self._upto_now()
            self.port.connect(baud, faults)

    def disconnect(self, name: str) -> None:
        """Stop listening."""
        del name
        with self.lock:
            self._upto_now()
            self.port.disconnect()

    def waiting(self, name: str) -> int:
        """Bytes that have arrived by now and are not read."""
        del name
        with self.lock:
            return self.port.waiting(self._upto_now())

    def read(self, name: str, size: int) -> bytes:
        """Up to ``size`` bytes of those that have arrived by now."""
        del name
        with self.lock:
            return self.port.read(size, self._upto_now())

    def arrivals(self, name: str, t_ns: Int64) -> Int64:
        """Bytes that can be read at each of the coming times, as far as the unit knows them now: none."""
        del name
        return t_ns[:0]

    def discard(self, name: str) -> None:
        """Lose what has arrived by now."""
        del name
        with self.lock:
            self.port.discard(self._upto_now())

    def write(self, name: str, sent: bytes) -> None:
        """The unit does not listen."""

    def _upto_now(self) -> int:
        """Send everything that is due; returns the time of now."""
        raise NotImplementedError
