"""A shown run of 38 hours whose clock goes a hundred times as fast: points, trend, and a state that changes."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from typing import Any

import numpy as np
from shown_run import HOUR_S, ShownRun

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
                low, high = self.values(numbers)
                block = np.empty(len(numbers), [("t", "<f8"), ("span", "<f4", (low.shape[1], 2))])
                block["t"], block["span"] = self._start_s + numbers, np.stack([low, high], axis=-1)
                with (self.folder / "trend" / f"port_a.{level_s:03d}s").open("ab") as stream:
                    stream.write(block.tobytes())
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
