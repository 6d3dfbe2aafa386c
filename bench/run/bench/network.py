"""Whether somebody listens at a VISA address on the network, asked before a VISA library that may wait long for it."""

from __future__ import annotations

import re
import socket

CONNECT_S = 1.0
_ADDRESS = re.compile(r"TCPIP\d*::([^:]+)::(.+)::(INSTR|SOCKET)", re.IGNORECASE)
_HISLIP = re.compile(r"hislip\d*(?:,(\d+))?", re.IGNORECASE)
_HISLIP_PORT = 4880
_PORTMAP = 111  # VXI-11 asks there for its own port


def port_of(resource: str) -> tuple[str, int] | None:
    """Host and TCP port of a VISA address; None for one that is not on the network.

    Source: VPP-4.3 (address strings), IVI-6.1 (HiSLIP port 4880), VXI-11 (port mapper).
    """
    address = _ADDRESS.fullmatch(resource)
    if address is None:
        return None
    host, device, kind = address.groups()
    if kind.upper() == "SOCKET":
        return (host, int(device)) if device.isdigit() else None
    hislip = _HISLIP.fullmatch(device)
    return (host, _PORTMAP if hislip is None else int(hislip[1] or _HISLIP_PORT))


def check_answers(resource: str) -> None:
    """Return if somebody accepts a connection within ``CONNECT_S``, or if the address is not on the network.

    Raises: OSError if nobody does.
    """
    found = port_of(resource)
    if found is not None:
        socket.create_connection(found, CONNECT_S).close()
