"""A feed made from docs/live-protocol.md alone: answers on a Unix socket what a test puts into it."""

from __future__ import annotations

import socket
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from shown_run import first_state as shown_state
from shown_run import packed, serve

NAMES = tuple(f"port_a.npp[{index + 1}]" for index in range(20))
T0 = 946_684_800.0


def first_state(names: tuple[str, ...] = NAMES) -> dict[str, Any]:
    """A state document with every key, of a run that begins."""
    soak = {"number": 1, "of": 9, "phase": "campaign", "kind": "soak", "what": "soak", "conditions": {"channel": 1}}
    return shown_state("r") | {
        "title": "t", "sequence": "s", "station": "b", "uut": {"model": "NGU", "serial": "1"}, "t_utc_s": T0,
        "started_utc_s": T0, "step": {**soak, "where": "s.yaml:3:1", "since_utc_s": T0, "until_utc_s": T0 + 60},
        "wait": None, "progress": 0.1, "eta": None,
        "records": {"done": 3, "planned": 9, "retaken": 0, "flagged": 0, "last": []},
        "links": {"port_a": {"state": "open", "frames": 10}}, "instruments": {},
        "log": [{"t_utc_s": T0, "kind": "phase", "text": "campaign"}] * 50,
        "signals": [{"name": name, "unit": "1", "decimals": 0} for name in names], "graphs": [],
        "timetable": {"t_utc_s": [T0, T0 + 60], "temperature_degC": [23.0, 50.0]},
    }  # fmt: skip


class FeedStandIn:
    """Serves the feed of a folder. Point k has time T0 + k / 10 and in column c the pair (k + c, k + c + 1)."""

    def __init__(self, folder: Path) -> None:
        self.state = first_state()
        self.made = 0  # points so far
        self.asked: list[dict[str, Any]] = []
        self._open: list[socket.socket] = []
        self._place = TemporaryDirectory()  # the folders of tests are too deep for the path of a socket
        self.pointer = folder / "live.path"
        self.path = Path(self._place.name) / "live.sock"
        self.pointer.write_text(str(self.path))
        self._server = serve(self.path, self.reply, self._open.append)

    def reply(self, request: dict[str, Any]) -> bytes:
        self.asked.append(request)
        since = request["since"] if request["since"] <= self.made else 0
        first = max(since, self.made - 600)
        count = np.arange(first, self.made)
        low = (count[:, None] + np.arange(len(self.state["signals"]))[None, :]).astype("<f4")
        header = {"boot_id": self.state["boot_id"], "seq": self.made, "first": first}
        if request.get("state"):
            header["state"] = self.state
        return packed(header, T0 + count / 10, low, low + 1)

    def close(self) -> None:
        """Nobody answers any more; whoever is connected is answered by nobody either."""
        if self._server is not None:
            self._server.shutdown()
            self._server.server_close()
            self._server = None
            self._cut()
            self.pointer.unlink()
            self._place.cleanup()

    def _cut(self) -> None:
        while self._open:
            with suppress(OSError):
                self._open.pop().shutdown(socket.SHUT_RDWR)
