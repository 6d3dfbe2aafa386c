"""A run that is only shown: feed and control socket made from docs/live-protocol.md; the test decides what is seen."""

from __future__ import annotations

import json
import math
import socketserver
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from bench.model.clock import NS, WallClock

CLOCK = WallClock()
GYROS = tuple(f"port_a.npp-ppp[{channel}]" for channel in range(1, 11))
TEMPERATURES = ("bench.air", "bench.unit", "bench.setpoint")
SUPPLY = ("port_b.supply_voltage",)
HOUR_S = 3600.0


def now_utc_s() -> float:
    return CLOCK.utc_ns() / NS


def first_state(run: str) -> dict[str, Any]:
    """A state document with every key, of a run that has gone on for an hour."""
    now = now_utc_s()
    began = now - HOUR_S
    units = {
        **dict.fromkeys(GYROS, ("pulse", 0)),
        **dict.fromkeys(SUPPLY, ("V", 2)),
        **dict.fromkeys(TEMPERATURES, ("degC", 2)),
    }
    instrument = {
        "driver": "fluke_5720a", "resource": "GPIB0::4::INSTR", "identity": "FLUKE,5720A,SIM,1", "command": "OUT 10 MA",
        "reply": "0", "t_utc_s": now, "answer_ms": 12.0, "error": None, "errors": 0, "state": "ok",
    }  # fmt: skip
    return {
        "proto": 1, "run": run, "boot_id": "0123456789abcdef", "title": "Scale factor, 5 temperatures",
        "sequence": "scale_factor", "station": "af_bench",
        "uut": {"model": "NGU", "serial": "7"}, "simulated": True, "clock": "wall",
        "source": "live",
        "state": "running", "outcome": None, "t_utc_s": now, "started_utc_s": began,
        "step": {"number": 7, "of": 18, "phase": "campaign", "kind": "soak", "what": "soak 55 degC",
                 "conditions": {"temperature_degC": 55.0}, "where": "scale_factor.yaml:88:9",
                 "since_utc_s": now - 760, "until_utc_s": now + 1040},
        "wait": {"reason": "soak 55 degC", "since_utc_s": now - 760, "until_utc_s": now + 1040, "last": "54.8 degC"},
        "progress": 0.38,
        "eta": {"earliest_utc_s": now + HOUR_S, "likely_utc_s": now + 1.1 * HOUR_S, "latest_utc_s": now + 1.5 * HOUR_S},
        "holds": {}, "prompt": None,
        "records": {"done": 3, "planned": 9, "retaken": 1, "flagged": 0, "last": [
            {"number": 3, "t_utc_s": now - 900,
             "conditions": {"temperature_degC": 55.0, "channel": 3, "current_A": -0.01},
             "frames": 10000, "lost": 0, "bad": 0, "flags": []}]},
        "links": {"port_a": {"state": "streaming", "reason": "", "frames": 360000, "bad": 0, "lost": 2, "duplicate": 0,
                             "rate_Hz": 100.0, "age_s": 0.01}},
        "instruments": {"calibrator": instrument, "chamber": {**instrument, "reply": "54.8", "command": "PVAR1?"}},
        "alarms": [], "log": [{"t_utc_s": now - 5, "kind": "phase", "text": "campaign begins"}],
        "signals": [{"name": name, "unit": unit, "decimals": decimals} for name, (unit, decimals) in units.items()],
        "graphs": [
            {"title": "Pulses, ten channels", "unit": "pulse", "signals": list(GYROS), "window_s": 60},
            {"title": "Supply", "unit": "V", "signals": list(SUPPLY), "window_s": 60},
            {"title": "Temperature", "unit": "degC", "signals": list(TEMPERATURES), "window_s": 60}],
        "timetable": {"t_utc_s": [began, began + 1800, now + HOUR_S], "temperature_degC": [23.0, 55.0, 55.0]},
    }  # fmt: skip


def serve(path: Path, answer: Callable[[dict[str, Any]], bytes], meet: Callable[[Any], object]) -> Any:
    """Answer requests on a Unix socket, one a line; ``meet`` is told of each connection."""

    class Handler(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            meet(self.request)
            with suppress(ConnectionError):  # a server that was killed
                for line in self.rfile:
                    if told := answer(json.loads(line)):
                        self.wfile.write(told)
                    else:
                        return

    class Server(socketserver.ThreadingUnixStreamServer):
        daemon_threads = True
        block_on_close = False

    server = Server(str(path), Handler)
    threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
    return server


def packed(header: dict[str, Any], t_utc_s: Any, low: Any, high: Any) -> bytes:
    """An answer of the feed as docs/live-protocol.md has it."""
    points = t_utc_s.astype("<f8").tobytes() + np.stack([low, high], axis=-1).astype("<f4").tobytes()
    text = json.dumps({"proto": 1, "n": len(t_utc_s), "signals": low.shape[1], **header}).encode()
    return len(text).to_bytes(4, "little") + len(points).to_bytes(4, "little") + text + points


class ShownRun:
    """Serves the feed and the control socket of a session's folder. ``asked``: commands it was given."""

    speed = 1.0  # of its clock
    point_rows = 600  # that it remembers
    before_s = HOUR_S  # that it has gone on for when it is first seen

    def __init__(self, out: Path, name: str) -> None:
        self.folder = out / name
        self.folder.mkdir()
        (self.folder / "session.0001.mcap").touch()
        (self.folder / "session.open").touch()
        self.name = name
        self.state = first_state(name)
        self.asked: list[dict[str, Any]] = []
        self.closed = False
        self._made_utc_s = now_utc_s()
        self._began_utc_s = self._made_utc_s - 60
        self._record_before()
        self._place = TemporaryDirectory()  # folders of tests are too deep for the path of a socket
        self._servers = [self._serve("live", self._feed), self._serve("control", self._control)]

    def now_utc_s(self) -> float:
        """Time on the bench."""
        return self._made_utc_s + (now_utc_s() - self._made_utc_s) * self.speed

    def _record_before(self) -> None:
        """The trend of the time before, as docs/session-format.md has it."""
        signals = [
            {"name": one["name"], "link": "port_a", "message": "frame", "field": one["name"], "element": 0, "minus": "",
             "unit": one["unit"], "decimals": one["decimals"]} for one in self.state["signals"]]  # fmt: skip
        start_s = math.floor(self._made_utc_s - self.before_s)
        head = {"version": 2, "levels_s": [1, 10, 100], "offsets_ns": [start_s * NS],
                "sources": [{"name": "port_a", "period_s": 0.01, "signals": signals}]}  # fmt: skip
        folder = self.folder / "trend"
        folder.mkdir()
        (folder / "trend.json").write_text(json.dumps(head))
        for level_s in (1, 10, 100):
            numbers = np.arange(0, self.before_s, level_s)
            block = np.empty(len(numbers), [("t", "<f8"), ("span", "<f4", (len(signals), 2))])
            low, high = self.values(numbers)
            block["t"], block["span"] = start_s + numbers, np.stack([low, high], axis=-1)
            (folder / f"port_a.{level_s:03d}s").write_bytes(block.tobytes())

    def _serve(self, what: str, answer: Callable[[dict[str, Any]], bytes]) -> Any:
        path = Path(self._place.name) / f"{what}.sock"
        (self.folder / f"{what}.path").write_text(str(path))
        return serve(path, lambda request: b"" if self.closed else answer(request), lambda _: None)

    def _feed(self, request: dict[str, Any]) -> bytes:
        made = int((self.now_utc_s() - self._began_utc_s) * 10)
        since = request["since"] if request["since"] <= made else 0
        first = max(since, made - self.point_rows)
        numbers = np.arange(first, made)
        header: dict[str, Any] = {"boot_id": self.state["boot_id"], "seq": made, "first": first}
        if request.get("state"):
            header["state"] = {**self.state, "t_utc_s": self.now_utc_s()}
        return packed(header, self._began_utc_s + numbers / 10, *self.values(numbers))

    def values(self, numbers: np.ndarray[Any, Any]) -> tuple[Any, Any]:
        """Least and greatest values by point and signal: ten sines, 28 V, temperatures; a gap in channel 2."""
        phase = 2 * math.pi * numbers[:, None] / 300
        gyros = np.round((1 + np.arange(10)) * 100 * np.sin(phase + np.arange(10)))
        gyros[(numbers % 300 > 200) & (numbers % 300 < 240), 1] = np.nan
        flat = np.array([28.0, 54.8, 54.6, 55.0]) + 0.02 * np.sin(3 * phase)
        low = np.concatenate([gyros, flat], axis=1)
        return low, low + np.concatenate([np.full(10, 4.0), np.full(4, 0.01)])

    def _control(self, request: dict[str, Any]) -> bytes:
        self.asked.append(request)
        if request["command"] == "acknowledge":
            acknowledged = {"by": request.get("by", ""), "t_utc_s": now_utc_s()}
            self.state["alarms"] = [{**alarm, "acknowledged": acknowledged} for alarm in self.state["alarms"]]
        if request["command"] == "answer":
            self.state["prompt"] = None
        return json.dumps({"ok": True, "text": f"{request['command']} heard"}).encode() + b"\n"

    def close(self) -> None:
        """Nobody answers any more."""
        if self.closed:
            return
        self.closed = True
        for server in self._servers:
            server.shutdown()
            server.server_close()
        self._place.cleanup()
