"""TCP proxies in front of a served bench, one port for each role, which lose their connections when they are told to.

All of them are served by one thread. ``refused``: connections are reset, new ones are refused. ``reset``: new ones are
taken and reset at once, as by a box between. ``cut``: connections are reset, new ones work. ``mute``: connections stay
or are taken, and nothing is forwarded; what is held meanwhile comes through afterwards, late and in order, as TCP
brings it when a network is back.
"""

import asyncio
import socket
import struct
import threading
from collections.abc import Collection, Coroutine, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

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
