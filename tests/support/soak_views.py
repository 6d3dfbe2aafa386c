"""Every view of what is on, judged by the physics of the simulated world: page, ``top``, messages, metrics, replay.

Looked at are they each half second of the bench, when the run is killed at a random moment, and at the end.
"""

import shutil
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from bench.model.clock import VirtualClock
from bench.model.events import UNDECLARED
from bench.run.control.live import LiveFeed
from bench.run.session import Conducted
from bench.session.recorded_state import RecordedState, read_recording, scenery_of
from bench.tui.look import Look, catalogue
from bench.tui.page import page_of
from bench.tui.watch import Seen, ending
from bench.web.now import silent_row
from bench.web.recorded.outcome import outcome_of
from bench.web.telemetry import SeenRun, families
from sim_instruments.worlds.common.world import World

LOOK_S = 0.5
LOOK = Look(catalogue())


def on_in(world: World) -> set[str]:
    """Return the roles that drive, supply, heat or move by the physics of this moment; "loop" for current in one."""
    found = {"loop": world.wiring.loop_current_A != 0.0}
    for role, device in world.instruments.items():
        does = device.outputs()
        moves = any(does.get("rates_deg_s", ())) or "closed" in map(str.lower, does.get("interlocks", ()))
        found[role] = bool(does.get("operating") or does.get("on") or does.get("mode") == "running" or moves)
    return {role for role, is_on in found.items() if is_on}


def off_in(document: Mapping[str, Any]) -> set[str]:
    """Return what a state document shows as off: its roles, and each view that has one word for the whole bench."""
    bench = document["bench"]
    seen = Seen({"state": "running", **document}, "", lost=document["state"] == "lost")
    metrics = next(one for one in families([SeenRun(document)]) if one.name == "bench_outputs_state").samples
    views = {
        "page": bench["state"] == "off",
        "top": any("OUTPUTS OFF" in line.plain for line in page_of(seen, LOOK).head),
        "metrics": any(one.value and one.labels["bench_outputs_state"] == "off" for one in metrics),
    }
    off = {part["role"] for part in bench["parts"] if part["state"] == "off"}
    return off | {view for view, says_off in views.items() if says_off}


class Views:
    """The views of one run. ``wrong``: each that was wrong, once. Args: kill_s: when a copy is left as by a kill."""

    def __init__(self, clock: VirtualClock, kill_s: float) -> None:
        self.wrong: dict[str, str] = {}
        self._clock, self._kill_s = clock, kill_s
        self._world: World | None = None
        self._feed: LiveFeed | None = None
        self._seen: set[tuple[str, ...]] = set()
        self._changes: list[tuple[float, set[str]]] = []
        clock.every(LOOK_S, self.look)

    def begin(self, world: World) -> None:
        """A world is opened."""
        self._world = world

    def fed(self, plain: Any) -> Any:
        """Return the initialiser of a feed, which is noted from then on."""

        def begin(feed: LiveFeed, *words: Any) -> None:
            plain(feed, *words)
            self._feed = feed

        return begin

    def look(self) -> None:
        """Judge the views of a living run; those of a state of the bench once."""
        if self._world is None or self._feed is None or self._feed.broken:
            return
        t_utc_s, on = self._clock.utc_ns() / 1e9, on_in(self._world)
        if not self._changes or self._changes[-1][1] != on:
            self._changes.append((t_utc_s, on))
        bench = self._feed.state.bench.document(t_utc_s)
        seen = bench["state"], *(part["state"] for part in bench["parts"]), *sorted(on)
        if seen not in self._seen:
            self._seen.add(seen)
            message = {"message"} if self._feed.bench_line().startswith("OUTPUTS OFF") else set()
            self._judge("", on, off_in(self._feed.state.document(t_utc_s)) | message)
        if self._clock.now_ns() / 1e9 >= self._kill_s:
            self._kill_s = float("inf")
            self._killed(self._feed._context.folder, on)

    def _killed(self, session: Path, on: set[str]) -> None:
        with TemporaryDirectory() as folder:
            killed = Path(folder) / session.name
            shutil.copytree(session, killed, ignore=shutil.ignore_patterns("*.sock"))
            row, recording = silent_row(killed), read_recording(killed)
            replay = RecordedState(recording, scenery_of(recording)).at(recording.last_utc_s)
            self._judge("killed ", on, off_in({**row["now"], "state": row["state"]}) | off_in(replay))

    def end(self, done: Conducted) -> None:
        """Judge what the recording says of each change and of the end, and that nothing undeclared has held the run."""
        assert self._world is not None
        recording = read_recording(done.folder)
        state, on = RecordedState(recording, scenery_of(recording)), on_in(self._world)
        for t_utc_s, was_on in self._changes:
            if t_utc_s < recording.last_utc_s:
                self._judge("recorded ", was_on, off_in(state.at(t_utc_s)))
        told = {"list"} if outcome_of(done.folder, {}).off else set()
        self._judge("ended ", on, off_in(ending(done.folder) or {}) | told)
        for kind, _, fields in done.events:
            if kind == "hold" and fields["by"] == UNDECLARED:
                self.wrong[UNDECLARED] = fields["reason"]

    def _judge(self, when: str, on: set[str], off: set[str]) -> None:
        assert self._world is not None
        for name in off & on | (off - self._world.instruments.keys() if on else set()):
            self.wrong.setdefault(when + name, f"off, while on: {sorted(on)}")
