"""The simulated bench as a process of its own: real time, real sockets, real terminals, a socket for its faults."""

from __future__ import annotations

import contextlib
import fcntl
import os
import signal
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.model.clock import WallClock
from bench.model.errors import InputError
from sim_instruments.faults.named import listing
from sim_instruments.served.control_socket import ControlSocket
from sim_instruments.served.instrument_servers import InstrumentServers
from sim_instruments.served.pty_links import PUMP_S, PtyLink
from sim_instruments.served.state import WATCH_S, OutputWatch, bench_state
from sim_instruments.worlds.simulation import open_world, possible_faults

LOCK, CONTROL, STATION = "sim.lock", "control.sock", "station.yaml"
STOPPING = (signal.SIGINT, signal.SIGTERM)
OPERATE, OPERATE_WORDS = "operate", 3
LOOK_S = 0.5  # how often the main thread looks whether a thread of the bench has failed


class ServedBench:
    """A simulated bench that others reach; made in the main thread, ended by ``close``.

    Args:
        world: kind of world.   wiring, options: as for ``open_world``.
        seed: of every random draw.   rate: how many times faster than real time the bench runs.
        folder: holds the terminals, the control socket and the lock; made if it is missing.
    Raises: InputError B-SIM-013 (another simulated bench lives in the folder), B-SIM-014 (folder or socket cannot be
        made), and those of ``open_world``.
    """

    def __init__(
        self, world: str, wiring: Mapping[str, Any], options: Mapping[str, str], *, seed: int, rate: float, folder: Path
    ) -> None:
        self.folder = folder
        self._ends = contextlib.ExitStack()
        with contextlib.ExitStack() as opened:
            signal.pthread_sigmask(signal.SIG_BLOCK, STOPPING)  # before any thread: the main one alone waits for them
            opened.callback(_listen_again)
            opened.callback(os.close, _locked(folder))
            self.clock = WallClock(rate)
            self._world = open_world(world, clock=self.clock, seed=seed, station=wiring, options=options)
            opened.callback(self._world.close)
            self._servers = InstrumentServers(self._world)
            opened.callback(self._servers.close)
            self.links = self._open_links(wiring["links"], rate, opened)
            self._watch = OutputWatch(self._world)
            opened.callback(self.clock.every(WATCH_S * rate, self._watch.look).cancel)
            control = ControlSocket(folder / CONTROL, self.answer)
            opened.callback(control.close)
            self._ends = opened.pop_all()

    def _open_links(self, entries: Mapping[str, Any], rate: float, opened: contextlib.ExitStack) -> dict[str, PtyLink]:
        links = {}
        for name, entry in entries.items():
            if entry.get("instrument") is not None:  # read over the bus, not over a terminal
                continue
            link = links[name] = PtyLink(self._world, name, self.folder / name, int(entry["baud"]))
            opened.callback(link.close)
            opened.callback(self.clock.every(PUMP_S * rate, link.pump).cancel)
        return links

    @property
    def resources(self) -> dict[str, str]:
        """VISA address of each role over HiSLIP."""
        return self._servers.resources()

    @property
    def sockets(self) -> dict[str, str]:
        """VISA address of each role's raw socket."""
        return self._servers.sockets()

    @property
    def urls(self) -> dict[str, str]:
        """Path of each link's terminal."""
        return {name: str(link.path) for name, link in self.links.items()}

    def answer(self, words: Sequence[str]) -> dict[str, Any]:
        """Switch a fault, clear all, tell the state, or ``operate NAME VALUE``: what a person does at the bench.

        Raises: InputError B-SIM-010, B-SIM-011, B-SIM-012, B-SIM-018, B-SIM-019.
        """
        if list(words) == ["state"]:
            links = {name: {"sent": link.sent_bytes, "lost": link.lost_bytes} for name, link in self.links.items()}
            return {"state": {**bench_state(self._world, self._watch), "link_bytes": links}}
        if len(words) == OPERATE_WORDS and words[0] == OPERATE:
            self._world.operate(words[1], words[2])
        elif list(words) == ["clear"]:
            self._world.switches.clear()
        else:
            self._world.switches.switch(*words)
        return {"lines": self._world.switches.on}

    def wait(self) -> None:
        """Return at SIGINT or SIGTERM. Raises: whatever a thread of the bench has failed with."""
        while signal.sigtimedwait(STOPPING, LOOK_S) is None:
            self.clock.sleep(0.0)

    def close(self) -> None:
        """End everything, remove terminals and socket; idempotent."""
        self._ends.close()


def fault_listing() -> list[str]:
    """Return one line for each fault that can be switched."""
    return listing(possible_faults())


def _listen_again() -> None:
    """Signals act as before; those that came while the bench was ending are done with."""
    while signal.sigtimedwait(STOPPING, 0) is not None:
        pass
    signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPPING)


def _locked(folder: Path) -> int:
    """Descriptor of the folder's lock file, which is locked and holds our process id."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError as error:
        message = f"the folder cannot be used: {error.strerror or error}"
        raise InputError("B-SIM-014", message, where=str(folder), next_step="give another --dir") from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        holder = os.read(lock, 32).decode("ascii", "replace").strip() or "unknown"
        os.close(lock)
        message = f"a simulated bench lives here already, process {holder}"
        raise InputError("B-SIM-013", message, where=str(folder), next_step="end it, or give another --dir") from error
    os.ftruncate(lock, 0)
    os.write(lock, f"{os.getpid()}\n".encode())
    return lock
