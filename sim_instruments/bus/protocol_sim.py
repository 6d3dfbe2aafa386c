"""pySerial URL handler of the simulated bench: ``sim://<world>/<port>`` opens a port of its unit under test.

pySerial finds it once this package's name is in ``serial.protocol_handler_packages``. Time is the bench clock of the
world, so a blocking read under a virtual clock lets that clock go on. The receive buffer has no limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from serial.serialutil import PortNotOpenError, SerialBase, SerialException, to_bytes

from bench.model.clock import NS, to_ns
from bench.model.errors import ExitStatus, LinkError
from sim_instruments.worlds.common.world import live_world

_POLL_NS = NS // 1000


class SimulatedPortError(LinkError, SerialException):
    """A simulated port that does not exist; a SerialException too, as users of pySerial expect."""

    exit_status = ExitStatus.SAFE_AFTER_FAULT


class Serial(SerialBase):
    """One port of the simulated unit with pySerial's interface; line settings but the baud rate are taken as right."""

    _unit: Any = None
    _world: Any = None
    _name = _port_of_unit = ""
    _plug = 0  # which appearance of the port this is: one that was unplugged never comes back

    def open(self) -> None:
        """Open the port. Raises: SimulatedPortError B-NGU-002, no live world or no such port."""
        if self.is_open:
            raise SerialException("the port is already open")
        parts = urlsplit(str(self._port))
        self._world = live_world(parts.netloc)
        self._name = parts.path.strip("/")
        place = None if self._world is None else self._world.unit.port_at(self._name)
        if place is None:
            raise SimulatedPortError(
                "B-NGU-002",
                "no simulated bench is open that has this port",
                where=str(self._port),
                next_step="take the URL from the world: world.link_url('port_a') or world.link_url('port_b')",
            )
        self._unit, self._port_of_unit = place
        if self._world.faults.link(self._name).unplugged:
            raise SerialException(f"{self._port}: no such port, it is unplugged")
        self._plug = self._world.faults.link(self._name).plugs
        self._reconfigure_port()
        self.is_open = True

    def close(self) -> None:
        """Stop listening."""
        if self.is_open:
            self.is_open = False
            if self._world.faults.link(self._name).plugs == self._plug:  # else another one may listen there now
                self._unit.disconnect(self._port_of_unit)

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""
        self._require_open()
        return int(self._unit.waiting(self._port_of_unit))

    def arrivals(self, turns_ns: Sequence[int]) -> Sequence[int]:
        """Return bytes that can be read at each of the coming times if nobody reads or does anything else before.

        Only as far as the unit knows them now: the answer may be shorter.
        """
        self._require_open()
        coming: Sequence[int] = self._unit.arrivals(self._port_of_unit, np.asarray(turns_ns, np.int64)).tolist()
        return coming

    def read(self, size: int = 1) -> bytes:
        """Return up to ``size`` bytes; waits for them as long as ``timeout`` says (None: until all are there)."""
        self._require_open()
        received = self._unit.read(self._port_of_unit, size)
        if len(received) == size or self._timeout == 0:
            return bytes(received)
        clock = self._world.clock
        deadline_ns = None if self._timeout is None else clock.now_ns() + to_ns(self._timeout)
        parts = [received]
        missing = size - len(received)
        while missing > 0 and (deadline_ns is None or clock.now_ns() < deadline_ns):
            wake_ns = clock.now_ns() + _POLL_NS
            clock.sleep_until_ns(wake_ns if deadline_ns is None else min(wake_ns, deadline_ns))
            self._require_open()
            parts.append(self._unit.read(self._port_of_unit, missing))
            missing -= len(parts[-1])
        return b"".join(parts)

    def write(self, data: Any) -> int:
        """Send bytes to the unit at once; returns how many."""
        self._require_open()
        sent = to_bytes(data)
        self._unit.write(self._port_of_unit, bytes(sent))
        return len(sent)

    def flush(self) -> None:
        """Everything written is already sent."""
        self._require_open()

    def reset_input_buffer(self) -> None:
        """Lose what has arrived."""
        self._require_open()
        self._unit.discard(self._port_of_unit)

    def reset_output_buffer(self) -> None:
        """Nothing waits to be sent."""
        self._require_open()

    @property
    def out_waiting(self) -> int:
        """Bytes not yet sent: none."""
        self._require_open()
        return 0

    def _reconfigure_port(self) -> None:
        self._unit.connect(self._port_of_unit, self._baudrate, self._world.faults.link(self._name))

    def _require_open(self) -> None:
        if not self.is_open:
            raise PortNotOpenError()
        faults = self._world.faults.link(self._name)
        if faults.unplugged or faults.plugs != self._plug:
            raise SerialException("the device is gone: its port was unplugged")
