"""A run that is only shown: feed and control socket made from docs/live-protocol.md; the test decides what is seen."""

import json
import math
import os
import socketserver
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rehearsal import writable_copy
from report_sample import unsound

from bench.model.clock import NS, WallClock
from bench.model.events import StimulusAlarm
from bench.record import OPEN_MARKER
from bench.run.feed.bench_state import BenchState

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
        "links": {"port_a": {"state": "streaming", "reason": "", "frames": 360000, "bad": 0, "lost": 2, "jumps": 4,
                             "duplicate": 0, "rate_Hz": 100.0, "age_s": 0.01}},
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
            self._append(level_s, start_s, np.arange(0, self.before_s, level_s))

    def _append(self, level_s: int, start_s: int, numbers: np.ndarray[Any, Any]) -> None:
        low, high = self.values(numbers)
        block = np.empty(len(numbers), [("t", "<f8"), ("span", "<f4", (low.shape[1], 2))])
        block["t"], block["span"] = start_s + numbers, np.stack([low, high], axis=-1)
        with (self.folder / "trend" / f"port_a.{level_s:03d}s").open("ab") as stream:
            stream.write(block.tobytes())

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


HOURS = 38
SPEED = 100.0
TICK_S = 0.2
MOST_LINES = 200


class FastRun(ShownRun):
    """A run that began a minute before it is first seen and goes on by itself."""

    speed = SPEED
    point_rows = 1200  # what a busy machine may be late: 1.2 s of wall time
    before_s = 60.0

    def __init__(self, out: Path, name: str) -> None:
        super().__init__(out, name)
        began = self._began_utc_s
        end = began + HOURS * HOUR_S
        corners = np.linspace(began, end, 19)
        temperatures = [20.0 + 5.0 * (number % 9) for number in range(len(corners))]
        timetable = {"t_utc_s": list(corners), "temperature_degC": temperatures}
        self.state = {**self.state, "started_utc_s": began, "timetable": timetable}
        head = json.loads((self.folder / "trend" / "trend.json").read_text())
        self._start_s = head["offsets_ns"][0] // 10**9
        self._done = dict.fromkeys((1, 10, 100), 60)  # seconds that each level holds
        self._done[100] = 100
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._go_on, daemon=True)
        self._thread.start()

    @property
    def hours(self) -> float:
        """Bench time so far."""
        return (self.now_utc_s() - self._began_utc_s) / HOUR_S

    def _go_on(self) -> None:
        tick = 0
        while not self._ended.wait(TICK_S):
            tick += 1
            self._append_trend()
            self.state = {**self.state, **self._news(tick)}

    def _append_trend(self) -> None:
        now_s = self.now_utc_s() - self._start_s
        for level_s, done_s in self._done.items():
            numbers = np.arange(done_s, now_s - level_s, level_s)
            if len(numbers):
                self._append(level_s, self._start_s, numbers)
                self._done[level_s] = done_s + len(numbers) * level_s

    def _news(self, tick: int) -> dict[str, Any]:
        """What is different now: almost everything, as in a run where much happens."""
        now, hours = self.now_utc_s(), self.hours
        begun = now - now % 760
        line = {"t_utc_s": now, "kind": "reading", "text": f"tick {tick}: chamber {20 + hours:.3f} degC"}
        alarms = [
            {"id": f"a{number}", "severity": "warning", "code": None, "t_utc_s": now, "active": number % 2 == 0,
             "acknowledged": None, "text": f"GPIB 14 timeout, the {number}th"}
            for number in range(int(hours) % 4)]  # fmt: skip
        row = {"number": tick, "t_utc_s": now, "frames": 10000, "lost": 0, "bad": 0, "flags": [],
               "conditions": {"temperature_degC": 20 + hours, "channel": tick % 10 + 1}}  # fmt: skip
        instruments = {
            role: {**one, "reply": f"{now:.3f}", "t_utc_s": now} for role, one in self.state["instruments"].items()
        }
        wait = {"reason": "soak", "since_utc_s": begun, "until_utc_s": begun + 760, "last": f"{20 + hours:.3f} degC"}
        step = {
            **self.state["step"],
            "number": int(hours / HOURS * 17) + 1,
            "since_utc_s": begun,
            "what": f"soak {tick}",
        }
        link = {**self.state["links"]["port_a"], "frames": 100 * int(hours * HOUR_S)}
        records = {**self.state["records"], "done": tick, "last": [row, *self.state["records"]["last"]][:10]}
        return {"progress": min(1.0, hours / HOURS), "log": [line, *self.state["log"]][:MOST_LINES], "alarms": alarms,
                "instruments": instruments, "wait": wait, "step": step, "links": {"port_a": link},
                "records": records}  # fmt: skip

    def close(self) -> None:
        """It stops, and nobody answers any more."""
        self._ended.set()
        self._thread.join()
        super().close()


PLACES = {
    "calibrator": ("fluke_5720a", "GPIB0::4::INSTR"), "switch": ("keithley_7002", "GPIB0::7::INSTR"),
    "supply": ("hp_6632b", "GPIB0::5::INSTR"), "chamber": ("thermotron_3800", "GPIB0::1::INSTR"),
}  # fmt: skip
QUIET = {"calibrator": {"ISR?": "0"}, "switch": {":CLOS:STAT?": "(@)"}}
DRIVEN = {"calibrator": {"ISR?": "4097", "OUT?": "2.0E-02,A,0E+00"}, "switch": {":CLOS:STAT?": "(@1!1!3)"}}
WARM = {
    "supply": {"OUTP?": "1", "MEAS:VOLT?": "18.0", "MEAS:CURR?": "1.25"},
    "chamber": {"MODE?": "16", "SETP1?": "55.0", "PVAR1?": "54.8"},
}
PORT = "port_a: no byte for 30 s"


@dataclass(frozen=True)
class Situation:
    """One that lives. ``word`` and ``attention`` are what every view says; ``says``: words that must stand there."""

    word: str
    attention: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    says: tuple[str, ...] = ()
    replies: Mapping[str, Mapping[str, str]] = field(default_factory=lambda: {**QUIET, **WARM})
    unconfirmed: Mapping[str, str] = field(default_factory=dict)


def alarm(text: str, code: str | None = None) -> dict[str, Any]:
    return {"id": text, "severity": "alarm", "code": code, "t_utc_s": now_utc_s(), "text": text, "active": True,
            "acknowledged": None}  # fmt: skip


def held(by: str, reason: str) -> dict[str, Any]:
    wait = {"reason": reason, "since_utc_s": now_utc_s() - 100, "until_utc_s": None, "last": None}
    return {"state": "holding", "eta": None, "holds": {by: reason}, "wait": wait}


QUESTION = {
    "id": "1", "text": "Connect the unit to channel 3 of the matrix.", "confirm": "technician", "unit": None,
    "low": None, "high": None, "since_utc_s": 0.0,
}  # fmt: skip
LIVING = {
    "running": Situation("RUNNING", "none", says=("calibrator", "20 mA"), replies={**DRIVEN, **WARM}),
    "soak": Situation("RUNNING", "none", says=("soak 55", "18 V, 1.25 A")),
    "prompt": Situation("WAITING FOR A PERSON", "some", {"state": "waiting", "eta": None, "prompt": QUESTION},
                        (QUESTION["text"],)),
    "port": Situation("HOLDING", "much", {**held("link port_a", PORT), "alarms": [alarm(PORT, "B-LINK-003")]}, (PORT,)),
    "instrument": Situation("HOLDING", "some", held("instrument dmm", "dmm: no answer"), ("dmm: no answer",)),
    "mute": Situation("HOLDING", "much", held("instrument calibrator", "calibrator: no answer"),
                      ("NOT confirmed off: calibrator (B-INST-001)",), unconfirmed={"calibrator": "B-INST-001"}),
    "runaway": Situation("RUNNING", "much", {"alarms": [alarm("air 61.2 degC runs away")]}, ("runs away",)),
    "door": Situation("HOLDING", "much", {**held("interlock door", "door is open"), "alarms": [alarm("door is open")]},
                      ("door is open",)),
}  # fmt: skip
OVER = {"pass": "PASS", "fail": "FAIL", "doubtful": "DOUBTFUL", "damaged": "DAMAGED", "guard": "FAULT"}


def bench_of(replies: Mapping[str, Mapping[str, str]], unconfirmed: Mapping[str, str] | None = None) -> dict[str, Any]:
    """The state of the bench as the run's own fold makes it of replies of now."""
    outputs, now = BenchState(PLACES, 150.0), now_utc_s()
    for role, code in (unconfirmed or {}).items():
        outputs.on_event(StimulusAlarm(step=7, role=role, code=code, text="no answer"), now)
    for role, told in replies.items():
        for question, reply in told.items():
            outputs.on_traffic(role, "tx", question, now - 12.0)
            outputs.on_traffic(role, "rx", reply, now - 12.0)
    return outputs.document(now)


def state_of(situation: Situation) -> dict[str, Any]:
    return {
        "attention": situation.attention,
        "bench": bench_of(situation.replies, situation.unconfirmed),
        **situation.changes,
    }


def stage_living(out: Path) -> dict[str, ShownRun]:
    """Every situation of a run that lives, by name; whoever stages them closes them."""
    runs = {}
    for number, (name, situation) in enumerate(LIVING.items()):
        runs[name] = ShownRun(out, f"20260301T00000{number}Z_{name}_7")
        runs[name].state.update(state_of(situation))
    return runs


def stage_over(out: Path, recorded: Path) -> dict[str, str]:
    """A recording, five times: its results judged, its end cut off, and left open by a run that its guard ended."""
    names = {what: f"20260302T00000{number}Z_{what}_7" for number, what in enumerate(OVER)}
    for what, name in names.items():
        folder = writable_copy(recorded, out / name)
        results = json.loads((folder / "results.json").read_text())
        for estimate in results["estimates"]:
            estimate |= {"verdict": "fail" if what == "fail" else "pass", "limit": 1.0}
        if what == "doubtful":
            results["estimates"][0] = unsound(results["estimates"][0])
        (folder / "results.json").write_text(json.dumps(results))
    last = sorted((out / names["damaged"]).glob("session.*.mcap"))[-1]
    os.truncate(last, last.stat().st_size // 2)
    (out / names["guard"] / OPEN_MARKER).touch()
    said = [{"what": "act", "text": "no heartbeat for 2 s", "utc": "2026-03-02T01:00:00+00:00"},
            {"what": "safe", "instruments": [], "utc": "2026-03-02T01:00:02+00:00"}]  # fmt: skip
    (out / names["guard"] / "guard.jsonl").write_text("".join(json.dumps(line) + "\n" for line in said))
    return names
