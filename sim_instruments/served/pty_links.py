"""A port of the simulated unit as a real pseudo-terminal, in real time.

Bytes that come out of the unit go to the terminal when the line has carried them; what is written to the terminal goes
to the unit. Nobody listening, or somebody who listens too slowly, loses bytes, as on a real cable: nothing piles up and
nothing blocks.

Source: pty(7), tty_ioctl(4); POLLHUP on the master side means that nobody has the slave side open (poll(2) on Linux).
"""

from __future__ import annotations

import contextlib
import os
import select
from pathlib import Path

from bench.model.posix import make_raw
from sim_instruments.worlds.common.world import World

PUMP_S = 0.004  # real time between two looks at the line
READ_BYTES = 65_536


class PtyLink:
    """One port of the unit behind the name ``path``; ``pump`` moves what has arrived, in both directions.

    Args: world: its unit has the port ``name``.   path: symbolic link to the terminal, replaced if it exists.
    """

    def __init__(self, world: World, name: str, path: Path, baud: int) -> None:
        self.name, self.path = name, path
        self.sent_bytes = self.lost_bytes = 0
        self._unit, self._port = world.unit.port_at(name)  # type: ignore[attr-defined]
        self._faults = world.faults.link(name)
        self._master: int | None = None
        self._unit.connect(self._port, baud, self._faults)
        self._plug()

    def pump(self) -> None:
        """Move bytes both ways, and follow the fault switches of the port."""
        if self._faults.unplugged != (self._master is None):
            self._unplug() if self._faults.unplugged else self._plug()
        arrived = self._unit.read(self._port, READ_BYTES)
        if self._master is None:
            self.lost_bytes += len(arrived)
            return
        if arrived:
            self._send(self._master, arrived)
        with contextlib.suppress(OSError):  # nothing written, or nobody there
            self._unit.write(self._port, os.read(self._master, READ_BYTES))

    def close(self) -> None:
        """Take the terminal and its name away; idempotent."""
        self._unplug()

    def _send(self, master: int, arrived: bytes) -> None:
        sent = 0
        if not self._nobody_listens(master):
            with contextlib.suppress(OSError):  # the terminal's buffer is full, or it was closed just now
                sent = os.write(master, arrived)
        self.sent_bytes += sent
        self.lost_bytes += len(arrived) - sent

    @staticmethod
    def _nobody_listens(master: int) -> bool:
        poll = select.poll()
        poll.register(master, 0)
        return any(event & select.POLLHUP for _, event in poll.poll(0))

    def _plug(self) -> None:
        """A new terminal in raw mode behind the name; its slave side was open once, so that POLLHUP tells."""
        self._master, slave = os.openpty()
        os.set_blocking(self._master, False)
        make_raw(slave)
        target = os.ttyname(slave)
        os.close(slave)
        new = self.path.with_name(self.path.name + ".new")
        new.unlink(missing_ok=True)
        new.symlink_to(target)
        new.replace(self.path)

    def _unplug(self) -> None:
        if self._master is not None:
            self.path.unlink(missing_ok=True)
            os.close(self._master)
            self._master = None
