"""The simulated bench as a process of its own: real time, real sockets, real terminals, a socket for its faults."""

from __future__ import annotations

import contextlib
import ipaddress
import json
import os
import select
import signal
import socket
import threading
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.model.clock import NS, WallClock
from bench.model.errors import BenchError, InputError
from bench.model.posix import ALONE, lock_file, make_raw, unix_socket
from sim_instruments.faults.named import listing
from sim_instruments.served.hislip_exchange import ServedInstrument
from sim_instruments.served.hislip_server import HislipServer
from sim_instruments.served.socket_server import AdapterServer, LoopbackServer, SocketServer
from sim_instruments.worlds.common.world import World
from sim_instruments.worlds.simulation import open_world, possible_faults

LOCK, CONTROL, STATION, PORTS = "sim.lock", "control.sock", "station.yaml", "ports.json"
LOOPBACK, HISLIP, ADAPTER, MOST_PORT = "127.0.0.1", "hislip", "adapter", 1 << 16
STOPPING = (signal.SIGINT, signal.SIGTERM)
OPERATE, OPERATE_WORDS = "operate", 3
WATCH_S = 0.02
LOOK_S = 0.5  # how often the main thread looks whether a thread of the bench has failed


class InstrumentServers:
    """Serves every instrument of a world until ``close``: HiSLIP for our drivers, raw sockets for other people's.

    Args: world: the bench; close the servers before it.   host: a loopback address; nobody else's instruments.
          ports: of the raw socket of each role, and of "hislip"; what is not named takes any free one.
    Raises: ValueError for another host or a virtual clock, OSError if a port is taken.
    """

    def __init__(self, world: World, *, host: str = LOOPBACK, ports: Mapping[str, int] | None = None) -> None:
        if not ipaddress.ip_address(host).is_loopback:
            raise ValueError(f"simulated instruments are served on the loopback interface only, not on {host}")
        if world.clock.virtual:
            raise ValueError("instruments are served in real time; this world has a virtual clock")
        self._host = host
        served = [ServedInstrument(world, device) for device in world.instruments.values()]
        wanted = defaultdict(int, ports or {})
        with contextlib.ExitStack() as opened:
            begin = opened.enter_context
            self._hislip = begin(contextlib.closing(HislipServer(served, host, wanted[HISLIP])))
            self._adapter = begin(contextlib.closing(AdapterServer(served, host, wanted[ADAPTER])))
            self._sockets = {
                role: begin(contextlib.closing(SocketServer(instrument, host, wanted[role])))
                for role, instrument in zip(world.instruments, served, strict=True)
            }
            self.close = opened.pop_all().close  # ends all sessions and frees the ports; idempotent

    @property
    def ports(self) -> dict[str, int]:
        """Every port that is listened at: of "hislip", of the adapter, and of the raw socket of each role."""
        return {
            name: server.port
            for name, server in {HISLIP: self._hislip, ADAPTER: self._adapter, **self._sockets}.items()
        }

    @property
    def hislip_port(self) -> int:
        """The one port of all HiSLIP instruments."""
        return self._hislip.port

    def resources(self) -> dict[str, str]:
        """Return the VISA address of each role over HiSLIP; the sub-address counts the roles in their order."""
        return {
            role: f"TCPIP0::{self._host}::hislip{number},{self.hislip_port}::INSTR"
            for number, role in enumerate(self._sockets)
        }

    def sockets(self) -> dict[str, str]:
        """Return the VISA address of each role's raw socket; both terminators are line feeds."""
        return {role: f"TCPIP0::{self._host}::{server.port}::SOCKET" for role, server in self._sockets.items()}

    @property
    def adapter(self) -> str:
        """Address of the GPIB adapter, behind which the roles stand at 1, 2, ... in their order."""
        return f"PRLGX-TCPIP0::{self._host}::{self._adapter.port}::INTFC"


class OutputWatch:
    """The true output of a bench, and since when; ``look`` is called each ``WATCH_S`` of the bench."""

    def __init__(self, world: World) -> None:
        self._world = world
        now_ns = world.clock.now_ns()
        self._since = {role: (device.outputs(), now_ns) for role, device in world.instruments.items()}

    def look(self) -> None:
        """Compare all outputs with what they were."""
        with self._world.lock:
            now_ns = self._world.clock.now_ns()
            for role, device in self._world.instruments.items():
                if (outputs := device.outputs()) != self._since[role][0]:
                    self._since[role] = outputs, now_ns

    def state(self) -> dict[str, Any]:
        """Return what the bench does at this moment, as plain values: no readback, the simulated truth itself.

        Units are in the names; ``unchanged_s`` is the bench's time since an output of that role last changed, second.
        """
        self.look()
        world = self._world
        with world.lock:
            now_ns = world.clock.now_ns()
            roles = {
                role: {
                    "model": type(device).__name__,
                    **device.outputs(),
                    "unchanged_s": (now_ns - self._since[role][1]) / NS,
                }
                for role, device in world.instruments.items()
            }
            return {
                "time_s": now_ns / NS,
                "instruments": roles,
                "loop_current_A": world.wiring.loop_current_A,
                "chamber_air_degC": float(world.thermal.air_degC(now_ns)),
                "unit": {
                    "powered": world.supplied_V > 0.0,
                    "temperature_degC": float(world.thermal.unit_degC(now_ns)),
                    "inputs_A": {str(channel): value for channel, value in world.wiring.channel_inputs_A().items()},
                },
                "faults": world.switches.on,
            }


class ServedBench:
    """A simulated bench that others reach; made in the main thread, ended by ``close``.

    Args:
        world: kind of world.   wiring, options: as for ``open_world``.
        seed: of every random draw.   rate: how many times faster than real time the bench runs.
        folder: holds the terminals, the control socket, the lock and the ports; made if it is missing. A bench that is
            begun again in it has the ports it had, so that sessions can be resumed; ``moved`` says which were taken.
        clean: instruments are as after power-on; else as their last user left them, by the seed.
    Raises: InputError B-SIM-013 (another simulated bench lives in the folder), B-SIM-014 (folder or socket cannot be
        made), and those of ``open_world``.
    """

    def __init__(
        self, world: str, wiring: Mapping[str, Any], options: Mapping[str, str], *, seed: int, rate: float,
        folder: Path, clean: bool = False,
    ) -> None:  # fmt: skip
        self.folder = folder
        self._ends = contextlib.ExitStack()
        with contextlib.ExitStack() as opened:
            signal.pthread_sigmask(signal.SIG_BLOCK, STOPPING)  # before any thread: the main one alone waits for them
            opened.callback(_listen_again)
            opened.callback(os.close, _locked(folder))
            self.clock = WallClock(rate)
            self._world = open_world(world, clock=self.clock, seed=seed, station=wiring, options=options)
            opened.callback(self._world.close)
            if not clean:
                self._world.use_up()
            before = _ports_before(folder / PORTS)
            ports = {name: port for name, port in before.items() if _is_free(port)}
            self.moved = {name: port for name, port in before.items() if name not in ports}
            self.servers = InstrumentServers(self._world, ports=ports)
            opened.callback(self.servers.close)
            (folder / PORTS).write_text(json.dumps(self.servers.ports), encoding="utf-8")
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
    def urls(self) -> dict[str, str]:
        """Path of each link's terminal."""
        return {name: str(link.path) for name, link in self.links.items()}

    def answer(self, words: Sequence[str]) -> dict[str, Any]:
        """Switch a fault, clear all, tell the state, or ``operate NAME VALUE``: what a person does at the bench.

        Raises: InputError B-SIM-010, B-SIM-011, B-SIM-012, B-SIM-018, B-SIM-019.
        """
        if list(words) == ["state"]:
            links = {name: {"sent": link.sent_bytes, "lost": link.lost_bytes} for name, link in self.links.items()}
            return {"state": {**self._watch.state(), "link_bytes": links}}
        if len(words) == OPERATE_WORDS and words[0] == OPERATE:
            self._world.operate(words[1], words[2])
        elif list(words) == ["clear"]:
            self._world.switches.clear()
        else:
            self._world.switches.switch(*words)
        return {"lines": self._world.switches.on}

    def wait(self) -> None:
        """Return at SIGINT or SIGTERM. Raises: whatever a thread of the bench has failed with."""
        while (found := signal.sigtimedwait(STOPPING, LOOK_S)) is None or found.si_signo not in STOPPING:
            self.clock.sleep(0.0)  # Python gives a signal that is none where the process was stopped for longer

    def close(self) -> None:
        """End everything, remove terminals and socket; idempotent."""
        self._ends.close()


def fault_listing() -> list[str]:
    """Return one line for each fault that can be switched."""
    return listing(possible_faults())


def _listen_again() -> None:
    """Let signals act as before; those that came while the bench was ending are done with."""
    while signal.sigtimedwait(STOPPING, 0) is not None:
        pass
    signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPPING)


def _ports_before(path: Path) -> dict[str, int]:
    """Return the ports that the bench of a folder had; none of a folder that remembers nothing."""
    try:
        remembered = json.loads(path.read_text(encoding="utf-8"))
        return {str(name): int(port) for name, port in remembered.items() if int(port) in range(1, MOST_PORT)}
    except (OSError, ValueError, TypeError, AttributeError):  # the first one, or killed while it wrote
        return {}


def _is_free(port: int) -> bool:
    try:
        socket.create_server((LOOPBACK, port)).close()
    except OSError:
        return False
    return True


def _locked(folder: Path) -> int:
    """Return the descriptor of the folder's lock file, which is locked and holds our process id."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT | ALONE, 0o600)
    except OSError as error:
        message = f"the folder cannot be used: {error.strerror or error}"
        raise InputError("B-SIM-014", message, where=str(folder), next_step="give another --dir") from error
    try:
        lock_file(lock)
    except OSError as error:
        holder = os.read(lock, 32).decode("ascii", "replace").strip() or "unknown"
        os.close(lock)
        message = f"a simulated bench lives here already, process {holder}"
        raise InputError("B-SIM-013", message, where=str(folder), next_step="end it, or give another --dir") from error
    os.ftruncate(lock, 0)
    os.write(lock, f"{os.getpid()}\n".encode())
    return lock


MOST_BYTES = 65_536
PATIENCE_S = 5.0  # for a client that connects and says nothing

Answer = Callable[[Sequence[str]], dict[str, Any]]


class ControlSocket(LoopbackServer):
    """Answers one request after the other until it is closed.

    Args: path: of the socket.   answer: from the words of a request to the reply; its BenchErrors become error replies.
    Raises: InputError B-SIM-014 if the socket cannot be made.
    """

    def __init__(self, path: Path, answer: Answer) -> None:
        self._path, self._answer = path, answer
        self._turn = threading.Lock()
        listener = unix_socket()
        before = os.umask(0o177)
        try:
            path.unlink(missing_ok=True)
            listener.bind(str(path))
        except OSError as error:
            listener.close()
            message = f"the control socket cannot be made: {error}"
            raise InputError("B-SIM-014", message, where=str(path), next_step="give a shorter --dir") from error
        finally:
            os.umask(before)
        listener.listen()
        super().__init__("control socket", listener)

    def close(self) -> None:
        """Answer nothing more and remove the socket; idempotent."""
        super().close()
        self._path.unlink(missing_ok=True)

    def serve(self, sock: socket.socket) -> None:
        """Answer one client; one that says nothing is not waited for."""
        with self._turn:
            sock.settimeout(PATIENCE_S)
            sock.sendall(json.dumps(self._reply(sock)).encode() + b"\n")

    def _reply(self, client: socket.socket) -> dict[str, Any]:
        with client.makefile("rb") as stream:
            line = stream.readline(MOST_BYTES)
        try:
            return self._answer([str(word) for word in json.loads(line)["words"]])
        except BenchError as error:
            wrong = error
        except (ValueError, KeyError, TypeError) as error:
            wrong = InputError("B-SIM-014", f"not understood: {error}")
        return {"error": {name: getattr(wrong, name) for name in ("code", "message", "where", "next_step")}}


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
            self.close() if self._faults.unplugged else self._plug()
        arrived = self._unit.read(self._port, READ_BYTES)
        if self._master is None:
            self.lost_bytes += len(arrived)
            return
        if arrived:
            self._send(self._master, arrived)
        with contextlib.suppress(OSError):  # nothing written, or nobody there
            self._unit.write(self._port, os.read(self._master, READ_BYTES))

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

    def close(self) -> None:
        """Take the terminal and its name away; idempotent."""
        if self._master is not None:
            self.path.unlink(missing_ok=True)
            os.close(self._master)
            self._master = None
