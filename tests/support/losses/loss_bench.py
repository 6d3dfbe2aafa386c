"""A served bench whose network can be taken away: its process, the ways to it, and somebody who looks at its world."""

import asyncio
import os
import re
import shutil
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Collection, Coroutine, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from block_rows import ROOT
from loss_schedule import ALL, Kind, Loss
from waiting import until

from bench.model.errors import BenchError
from bench.run.bus.served_world import ask

START_S = 60.0
LOOK_S = 0.2
_HISLIP = re.compile(r'^  (\w+): .*?"TCPIP0::127\.0\.0\.1::hislip(\d+),(\d+)::INSTR"', re.MULTILINE)
_BLOCKS = 64  # of the private network 10.192.0.0/10, one for each process number


class Namespace:
    """A network of its own for the run, with two cables to this machine: of what is to be lost, and of the rest.

    Raises: CalledProcessError or FileNotFoundError where that is not permitted, or not possible.
    """

    def __init__(self) -> None:
        high, low = divmod(os.getpid() % (_BLOCKS << 8), 256)
        self._name, self._net = f"loss{os.getpid()}", f"10.{192 + high}.{low}"
        self._cables = {"lost": (f"la{os.getpid()}", 1), "rest": (f"lb{os.getpid()}", 5)}
        self.hosts = {which: f"{self._net}.{last}" for which, (_, last) in self._cables.items()}
        _remove_those_of_the_dead()
        _ip("netns", "add", self._name)
        try:
            _ip("-n", self._name, "link", "set", "lo", "up")
            for cable, last in self._cables.values():
                _ip("link", "add", cable, "type", "veth", "peer", "name", "far", "netns", self._name)
                _ip("-n", self._name, "link", "set", "far", "name", f"far{last}")
                _ip("addr", "add", f"{self._net}.{last}/30", "dev", cable)
                _ip("-n", self._name, "addr", "add", f"{self._net}.{last + 1}/30", "dev", f"far{last}")
                _ip("link", "set", cable, "up")
                _ip("-n", self._name, "link", "set", f"far{last}", "up")
        except subprocess.CalledProcessError:
            self.close()
            raise
        self.inside = ["ip", "netns", "exec", self._name]

    def link(self, state: str, whole: bool) -> None:
        """Set the cable of what is lost, or both, "down" or "up"."""
        for which, (cable, _) in self._cables.items():
            if whole or which == "lost":
                _ip("link", "set", cable, state)

    def close(self) -> None:
        """Take it away, cables and all; a process that is still in it keeps it until it ends."""
        for cable, _ in self._cables.values():
            subprocess.run(["ip", "link", "del", cable], capture_output=True, check=False)
        subprocess.run(["ip", "netns", "del", self._name], capture_output=True, check=False)


def _remove_those_of_the_dead() -> None:
    """Remove the networks of drills that were killed: another process number may come to the same addresses."""
    listed = subprocess.run(["ip", "netns", "list"], capture_output=True, text=True, check=True).stdout
    for number in re.findall(r"^loss(\d+)\b", listed, re.MULTILINE):
        if not Path(f"/proc/{number}").exists():
            subprocess.run(["ip", "netns", "del", f"loss{number}"], capture_output=True, check=False)


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], capture_output=True, check=True)


def possible_kinds(kinds: tuple[Kind, ...]) -> tuple[Kind, ...]:
    """Return the kinds that this machine can do; a link goes down only where a network can be made."""
    try:
        if shutil.which("ip") is None:
            raise FileNotFoundError("ip")
        Namespace().close()
    except (OSError, subprocess.CalledProcessError) as error:
        print(f"no losses of the kind 'down' here: {error}")
        return tuple(kind for kind in kinds if kind != "down")
    return kinds


class LossyBench:
    """``bench sim`` behind proxies, and what is true of its world, sampled by a thread each 0.2 s.

    Args: apart: the role (or ``ALL``) whose cable goes down, where one does.   saw: takes each sample: monotonic
    second and the roles that drive something, None while there is no world.
    """

    def __init__(
        self, folder: Path, seed: int, apart: str | None, saw: Callable[[float, frozenset[str] | None], None]
    ) -> None:
        self.folder, self._seed, self._saw = folder, seed, saw
        self._ends = ExitStack()
        self._sim: subprocess.Popen[bytes] | None = None
        self._ended = threading.Event()
        try:
            self._ends.callback(self._kill)
            port = self._begin()
            self._space = Namespace() if apart is not None else None
            if self._space is not None:
                self._ends.callback(self._space.close)
            self.proxies = Proxies({role: self._host(role, apart) for role in self._numbers}, port)
            self._ends.callback(self.proxies.close)
            self.station = self._proxied()
            watch = threading.Thread(target=self._look, name="world", daemon=True)
            watch.start()
            self._ends.callback(watch.join)
            self._ends.callback(self._ended.set)
        except BaseException:
            self._ends.close()
            raise

    @property
    def roles(self) -> tuple[str, ...]:
        """Return the roles of all instruments."""
        return tuple(self._numbers)

    @property
    def inside(self) -> list[str]:
        """Return what a command begins with that is to use the lossy network."""
        return [] if self._space is None else self._space.inside

    def lose(self, loss: Loss) -> None:
        """Take the network away, as the loss says."""
        roles = self.roles if loss.target == ALL else (loss.target,)
        match loss.kind:
            case "none":
                return
            case "refused":
                self.proxies.refuse(roles)
            case "reset":
                self.proxies.reset(roles)
            case "cut":
                self.proxies.cut(roles)
            case "mute":
                self.proxies.mute(roles)
            case "down":
                self._cable("down", loss)
            case "server":
                self._kill()

    def restore(self, loss: Loss) -> None:
        """Give it back."""
        if loss.kind == "server":
            self.proxies.upstream = self._begin()
        elif loss.kind == "down":
            self._cable("up", loss)
        else:
            self.proxies.restore(self.roles)

    def close(self) -> None:
        """End everything that was begun here."""
        self._ends.close()

    def _cable(self, state: str, loss: Loss) -> None:
        self._space.link(state, whole=loss.target == ALL)

    def _host(self, role: str, apart: str | None) -> str:
        if self._space is None:
            return "127.0.0.1"
        return self._space.hosts["lost" if role == apart else "rest"]

    def _begin(self) -> int:
        """Start the simulated bench in its folder; return the port of its instruments."""
        log = self.folder.with_name(f"{self.folder.name}.log")
        words = ["sim", "af_rack_sim", "--clean", "--dir", str(self.folder), "--seed", str(self._seed)]
        with log.open("wb") as stream:
            command = [sys.executable, "-m", "bench", *words]
            self._sim = subprocess.Popen(command, stdout=stream, stderr=stream, stdin=subprocess.DEVNULL, cwd=ROOT)
        until(lambda: self._has_begun(log), lambda: f"a simulated bench: {log.read_text()[-600:]}", START_S)
        found = _HISLIP.findall((self.folder / "station.yaml").read_text())
        self._numbers = {role: int(number) for role, number, _ in found}
        return int(found[0][2])

    def _has_begun(self, log: Path) -> bool:
        assert self._sim.poll() is None, log.read_text()[-600:]
        return "ready" in log.read_text().split("\n")

    def _kill(self) -> None:
        if self._sim is not None:
            self._sim.kill()
            self._sim.wait()

    def _proxied(self) -> Path:
        """Write the station whose instruments are behind the proxies; return its file."""
        text = (self.folder / "station.yaml").read_text()
        for role, (host, port) in self.proxies.places.items():
            old = re.compile(rf"TCPIP0::127\.0\.0\.1::hislip{self._numbers[role]},\d+::INSTR")
            text, count = old.subn(f"TCPIP0::{host}::hislip{self._numbers[role]},{port}::INSTR", text)
            assert count == 1, role
        path = self.folder.parent / "proxied.yaml"
        path.write_text(text)
        return path

    def _look(self) -> None:
        while not self._ended.wait(LOOK_S):
            state: Mapping[str, Any] | None = None
            with suppress(BenchError, KeyError):
                state = ask(self.folder / "control.sock", ["state"])["state"]
            self._saw(time.monotonic(), None if state is None else driving(state["instruments"]))


def driving(instruments: Mapping[str, Mapping[str, Any]]) -> frozenset[str]:
    """Return the roles that drive something, lead it to the unit, heat or cool: of the simulated truth."""
    return frozenset(role for role, outputs in instruments.items() if _drives(outputs))


def _drives(outputs: Mapping[str, Any]) -> bool:
    on: Collection[bool] = [bool(outputs.get(name)) for name in ("operating", "on", "closed")]
    return any(on) or outputs.get("mode") == "running"


CHUNK_BYTES = 65536
PATIENCE_S = 10.0
_RESET = struct.pack("ii", 1, 0)  # SO_LINGER: close by RST, as a host does that is gone and back


@dataclass(eq=False)
class _Proxy:
    """One role: where it listens, whether it forwards, its open connections on both sides."""

    host: str
    port: int = 0
    server: asyncio.Server | None = None
    forwards: asyncio.Event = field(default_factory=asyncio.Event)
    writers: set[asyncio.StreamWriter] = field(default_factory=set)
    resets: bool = False


class Proxies:
    """Forwards from a port for each role to one port of this machine, until ``close``.

    One thread serves all. ``refused``: connections are reset, new ones are refused. ``reset``: new ones are taken and
    reset at once, as by a box between. ``cut``: connections are reset, new ones work. ``mute``: connections stay or are
    taken, and nothing is forwarded; what is held meanwhile comes through afterwards, late and in order, as TCP brings
    it when a network is back.

    Args: hosts: address at which the proxy of each role listens.   upstream: port of the served bench; may be set anew.
    """

    def __init__(self, hosts: Mapping[str, str], upstream: int) -> None:
        self.upstream = upstream
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="proxies", daemon=True)
        self._thread.start()
        self._proxies = {role: _Proxy(host) for role, host in hosts.items()}
        for proxy in self._proxies.values():
            self._do(self._listen(proxy))
        self._do(self._restore(self._proxies))

    @property
    def places(self) -> dict[str, tuple[str, int]]:
        """Host and port of each role."""
        return {role: (proxy.host, proxy.port) for role, proxy in self._proxies.items()}

    def refuse(self, roles: Collection[str]) -> None:
        """Reset what is connected and refuse new connections."""
        self._do(self._lose(roles, closed=True))

    def reset(self, roles: Collection[str]) -> None:
        """Reset what is connected, and every new connection as soon as it is taken."""
        for role in roles:
            self._proxies[role].resets = True
        self._do(self._lose(roles, closed=False))

    def cut(self, roles: Collection[str]) -> None:
        """Reset what is connected; new connections work."""
        self._do(self._lose(roles, closed=False))

    def mute(self, roles: Collection[str]) -> None:
        """Forward nothing."""
        self._do(self._mute(roles))

    def restore(self, roles: Collection[str]) -> None:
        """Let everything through again, at the same ports."""
        self._do(self._restore(roles))

    def close(self) -> None:
        """End all connections and the thread."""
        with suppress(OSError):  # a port that was refused may be somebody else's by now
            self._do(self._restore(self._proxies))  # who waits for the way to be open again may end
        self._do(self._lose(self._proxies, closed=True))
        self._do(self._over())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def _do(self, work: Coroutine[Any, Any, None]) -> None:
        asyncio.run_coroutine_threadsafe(work, self._loop).result(PATIENCE_S)

    async def _listen(self, proxy: _Proxy) -> None:
        async def connected(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            await self._connected(proxy, reader, writer)

        proxy.server = await asyncio.start_server(connected, proxy.host, proxy.port)
        proxy.port = proxy.server.sockets[0].getsockname()[1]

    async def _lose(self, roles: Collection[str], closed: bool) -> None:
        for proxy in (self._proxies[role] for role in roles):
            if closed and proxy.server is not None:
                proxy.server.close()
                proxy.server = None
            for writer in list(proxy.writers):
                _reset(writer)

    async def _mute(self, roles: Collection[str]) -> None:
        for role in roles:
            self._proxies[role].forwards.clear()

    async def _restore(self, roles: Collection[str]) -> None:
        for proxy in (self._proxies[role] for role in roles):
            proxy.forwards.set()
            proxy.resets = False
            if proxy.server is None:
                await self._listen(proxy)

    async def _over(self) -> None:
        if others := asyncio.all_tasks() - {asyncio.current_task()}:
            await asyncio.wait(others, timeout=PATIENCE_S / 2)

    async def _connected(self, proxy: _Proxy, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if proxy.resets:
            _reset(writer)
            return
        ends = [writer]
        proxy.writers.add(writer)
        try:
            await proxy.forwards.wait()
            far_reader, far_writer = await asyncio.open_connection("127.0.0.1", self.upstream)
            ends.append(far_writer)
            proxy.writers.add(far_writer)
            await asyncio.gather(_pump(proxy, reader, far_writer), _pump(proxy, far_reader, writer))
        except OSError:  # no bench there, or one end is gone
            for end in ends:
                _reset(end)
        finally:
            for end in ends:
                proxy.writers.discard(end)
                end.close()


async def _pump(proxy: _Proxy, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while chunk := await reader.read(CHUNK_BYTES):
        await proxy.forwards.wait()
        writer.write(chunk)
        await writer.drain()
    await proxy.forwards.wait()
    if writer.can_write_eof():
        writer.write_eof()


def _reset(writer: asyncio.StreamWriter) -> None:
    with suppress(OSError):
        writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
    writer.transport.abort()
