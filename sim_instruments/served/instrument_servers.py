"""Simulated instruments served on this machine: HiSLIP for our own drivers, raw sockets for other people's."""

from __future__ import annotations

import ipaddress

from sim_instruments.served.hislip_exchange import ServedInstrument
from sim_instruments.served.hislip_server import HislipServer
from sim_instruments.served.socket_server import SocketServer
from sim_instruments.worlds.common.world import World


class InstrumentServers:
    """Serves every instrument of a world that runs on a wall clock, until ``close``.

    Args: world: the bench; close the servers before it.   host: a loopback address; nobody else's instruments.
          hislip_port: 0 takes any free port; raw sockets always do.
    Raises: ValueError for another host or a virtual clock, OSError if the port is taken.
    """

    def __init__(self, world: World, *, host: str = "127.0.0.1", hislip_port: int = 0) -> None:
        if not ipaddress.ip_address(host).is_loopback:
            raise ValueError(f"simulated instruments are served on the loopback interface only, not on {host}")
        if world.clock.virtual:
            raise ValueError("instruments are served in real time; this world has a virtual clock")
        self._host = host
        self._roles = tuple(world.instruments)
        served = [ServedInstrument(world, device) for device in world.instruments.values()]
        self._hislip = HislipServer(served, host, hislip_port)
        self._sockets = SocketServer(served, host)

    @property
    def hislip_port(self) -> int:
        """The one port of all HiSLIP instruments."""
        return self._hislip.port

    def resources(self) -> dict[str, str]:
        """VISA address of each role over HiSLIP; the sub-address counts the roles in their order."""
        return {
            role: f"TCPIP0::{self._host}::hislip{number},{self.hislip_port}::INSTR"
            for number, role in enumerate(self._roles)
        }

    def sockets(self) -> dict[str, str]:
        """VISA address of each role's raw socket; both terminators are line feeds."""
        return {
            role: f"TCPIP0::{self._host}::{port}::SOCKET"
            for role, port in zip(self._roles, self._sockets.ports, strict=True)
        }

    def close(self) -> None:
        """End all sessions and free the ports; idempotent."""
        self._hislip.close()
        self._sockets.close()
