"""Unix sockets for the owner of a run and root alone: where they listen, and who connects."""

from __future__ import annotations

import os
import pwd
import socket
import struct
from pathlib import Path

BACKLOG = 128  # clients that may wait to be accepted; more are turned away by the system


def listen(path: Path) -> socket.socket:
    """A socket that listens at a path, without waiting; what was left there is replaced. Raises: OSError."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        path.unlink(missing_ok=True)
        before = os.umask(0o177)
        try:
            listener.bind(str(path))
        finally:
            os.umask(before)
        listener.listen(BACKLOG)
        listener.setblocking(False)
    except OSError:
        listener.close()
        raise
    return listener


def peer_of(connection: socket.socket) -> str | None:
    """Name and process of who connected; None for another user, who is not heard (root is)."""
    try:
        raw = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
    except OSError:
        return None
    pid, uid, _ = struct.unpack("3i", raw)
    if uid not in (os.getuid(), 0):
        return None
    try:
        name = pwd.getpwuid(uid).pw_name
    except KeyError:
        name = f"uid {uid}"
    return f"{name} (process {pid})"
