"""The local socket through which a simulated bench is told its faults and asked for its state; for its owner only.

One request on a connection, one reply, each a line of JSON: ``{"words": ["mute", "dmm"]}`` gives ``{"lines": [...]}``,
``{"state": {...}}`` or ``{"error": {"code", "message", "where", "next_step"}}``.
"""

from __future__ import annotations

import json
import os
import socket
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from bench.model.errors import BenchError, InputError
from bench.model.posix import unix_socket

MOST_BYTES = 65_536
PATIENCE_S = 5.0  # for a client that connects and says nothing

Answer = Callable[[Sequence[str]], dict[str, Any]]


class ControlSocket:
    """Answers requests on a thread of its own until it is closed.

    Args: path: of the socket.   answer: from the words of a request to the reply; its BenchErrors become error replies.
    Raises: InputError B-SIM-014 if the socket cannot be made.
    """

    def __init__(self, path: Path, answer: Answer) -> None:
        self._path, self._answer = path, answer
        self._socket = unix_socket()
        before = os.umask(0o177)
        try:
            path.unlink(missing_ok=True)
            self._socket.bind(str(path))
        except OSError as error:
            self._socket.close()
            message = f"the control socket cannot be made: {error}"
            raise InputError("B-SIM-014", message, where=str(path), next_step="give a shorter --dir") from error
        finally:
            os.umask(before)
        self._socket.listen()
        self._thread = threading.Thread(target=self._serve, name="control socket", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Answer nothing more and remove the socket; idempotent."""
        if self._socket.fileno() >= 0:
            self._socket.shutdown(socket.SHUT_RDWR)
            self._thread.join()
            self._socket.close()
            self._path.unlink(missing_ok=True)

    def _serve(self) -> None:
        while True:
            try:
                client, _ = self._socket.accept()
            except OSError:  # closed
                return
            with client:
                client.settimeout(PATIENCE_S)
                try:
                    client.sendall(json.dumps(self._reply(client)).encode() + b"\n")
                except OSError:  # it went away, or says nothing
                    continue

    def _reply(self, client: socket.socket) -> dict[str, Any]:
        with client.makefile("rb") as stream:
            line = stream.readline(MOST_BYTES)
        try:
            return self._answer([str(word) for word in json.loads(line)["words"]])
        except BenchError as error:
            fields = {"code": error.code, "message": error.message, "where": error.where, "next_step": error.next_step}
            return {"error": fields}
        except (ValueError, KeyError, TypeError) as error:
            return {"error": {"code": "B-SIM-014", "message": f"not understood: {error}", "where": "", "next_step": ""}}
