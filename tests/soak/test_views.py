"""No view says off while the simulated world's physics says on: campaigns under random faults, drawn from a seed.

Views are the page, ``bench top``, messages and metrics while the run lives, and those of its recording; looked at are
they each half second of the bench, at a kill at a random moment, and at the end. Nothing declared holds the run.
"""

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from fault_schedule import DRAWS, schedule
from rehearsal import ROOT, Watched, watch_worlds
from soak_campaign import QUIET, SHORT, Campaign, campaign_of, watchers

from bench.model.clock import VIRTUAL_START_UTC_NS, VirtualClock
from bench.model.errors import BenchError
from bench.model.events import UNDECLARED
from bench.plan import PlannedCall, compile_sequence
from bench.plan.plan import no_effect
from bench.run.control.operator import SimulatedOperator
from bench.run.feed import bench_state, live
from bench.run.session import conduct
from bench.session.recorded_state import RecordedState, read_recording, scenery_of
from bench.tui.look import Look, catalogue
from bench.tui.page import page_of
from bench.tui.watch import Seen, ending
from bench.web.now import now_of, silent_row
from bench.web.recorded.outcome import outcome_of
from bench.web.telemetry import SeenRun, families
from sim_instruments.seeds import generator
from sim_instruments.worlds.common.world import World

LOOK_S, INTERVAL_S = 0.5, 40.0
LOOK = Look(catalogue())


def on_in(world: World) -> set[str]:
    """Return the roles that drive, supply, heat or move at this moment, by the physics; "" for current in a loop."""
    found = {"": world.wiring.loop_current_A != 0.0}
    for role, device in world.instruments.items():
        does = device.outputs()
        found[role] = (
            bool(does.get("operating") or does.get("on"))
            or does.get("mode") == "running"
            or any(rate != 0.0 for rate in does.get("rates_deg_s", ()))
            or any(str(interlock).lower() == "closed" for interlock in does.get("interlocks", ()))
        )
    return {role for role, is_on in found.items() if is_on}


def off_in(document: Mapping[str, Any]) -> set[str]:
    """Return what a state document shows as off: its roles, and the views that have one word for the whole bench."""
    bench = document["bench"]
    off = {part["role"] for part in bench["parts"] if part["state"] == "off"}
    seen = Seen({"state": "running", **document}, "", lost=document["state"] == "lost")
    metrics = next(one for one in families([SeenRun(document)]) if one.name == "bench_outputs_state").samples
    views = {
        "page": bench["state"] == "off",
        "list": now_of(document)["bench"]["state"] == "off",
        "top": "OUTPUTS OFF" in " ".join(line.plain for line in page_of(seen, LOOK).head),
        "metrics": any(one.value and one.labels["bench_outputs_state"] == "off" for one in metrics),
    }
    return off | {view for view, says_off in views.items() if says_off}


class Sweep:
    """One campaign under the faults of one seed. ``wrong``: every view that was wrong, once. ``looks``: in how many."""

    def __init__(self, campaign: Campaign, seed: int, folder: Path, patch: pytest.MonkeyPatch) -> None:
        self.wrong, self.looks, self.ended = dict[str, str](), 0, "refused"
        self._samples: list[tuple[float, set[str]]] = []
        self._feeds: list[live.LiveFeed] = []
        self._seen = set[tuple[str, ...]]()
        self._watched, self._clock = Watched(), VirtualClock()
        self._folder, self._kill_s = folder, float(generator(seed, "kill").uniform(0.0, campaign.duration_s))
        faults = campaign.faults(seed)
        watch_worlds(patch, self._watched, lambda world: schedule(world, faults))
        plain = live.LiveFeed.__init__
        patch.setattr(live.LiveFeed, "__init__", lambda feed, *rest: (self._feeds.append(feed), plain(feed, *rest))[1])
        self._clock.every(LOOK_S, self._look)
        try:
            done = conduct(
                campaign.plan, clock=self._clock, seed=seed, out=folder / "out", operator=SimulatedOperator(),
                listener=QUIET, keep_events=("hold",), beside=campaign.besides,
            )  # fmt: skip
        except BenchError as error:  # before a session exists
            self.ended = error.code
            return
        self.ended = done.outcome.error.code if done.outcome.error else "done"
        if self.ended.startswith(("B-INT", "B-SIM")):
            self.wrong["internal"] = str(done.outcome.error)
        for _, _, fields in done.events:
            if fields["by"] == UNDECLARED:
                self.wrong["undeclared"] = fields["reason"]
        self._at_the_end(done.folder)

    def _look(self) -> None:
        world, feed = (
            self._watched.worlds[-1] if self._watched.worlds else None,
            self._feeds[-1] if self._feeds else None,
        )
        if world is None or feed is None or feed.broken:
            return
        self.looks += 1
        t_utc_s, on = self._clock.utc_ns() / 1e9, on_in(world)
        self._samples.append((t_utc_s, on))
        bench = feed.state.bench.document(t_utc_s)
        seen = bench["state"], *(part["state"] for part in bench["parts"]), *sorted(on)
        if seen not in self._seen:  # what the views make of it
            self._seen.add(seen)
            message = {"message"} if feed.bench_line().startswith("OUTPUTS OFF") else set()
            self._judge("", on, off_in(feed.state.document(t_utc_s)) | message)
        if self._kill_s and self._clock.now_ns() / 1e9 >= self._kill_s:
            self._kill_s = 0.0
            (session,) = (self._folder / "out").iterdir()
            killed = self._folder / "killed" / session.name
            shutil.copytree(session, killed, ignore=shutil.ignore_patterns("*.sock"))
            row = silent_row(killed)
            self._judge("killed ", on, off_in({**row["now"], "state": row["state"]}) | self._recorded(killed))

    def _recorded(self, folder: Path) -> set[str]:
        """Return what the page of a recording shows as off at its end."""
        recording = read_recording(folder)
        return off_in(RecordedState(recording, scenery_of(recording)).at(recording.last_utc_s))

    def _judge(self, when: str, on: set[str], off: set[str]) -> None:
        instruments = self._watched.worlds[-1].instruments.keys()
        for name in off & on | (off - instruments if on else set()):
            self.wrong.setdefault(when + name, f"off, while on: {sorted(on)}")

    def _at_the_end(self, folder: Path) -> None:
        """Judge what the recording says of every moment that was looked at, and what is told behind the end."""
        recording = read_recording(folder)
        state = RecordedState(recording, scenery_of(recording))
        before: tuple[set[str], set[str]] | None = None
        for t_utc_s, on in self._samples:
            if t_utc_s < recording.last_utc_s and (before is None or before[0] != on):
                self._judge("recorded ", on, off_in(state.at(t_utc_s)))
                before = on, on
        on, end = on_in(self._watched.worlds[-1]), ending(folder)
        assert end is not None
        told = {"outcome"} if outcome_of(folder, {}).off else set()
        self._judge("ended ", on, off_in(end) | told)


def campaigns(folder: Path) -> list[Campaign]:
    """Return one with current, heat and relays, and one with a table."""
    turn = compile_sequence(ROOT / "sequences" / "time_sync_turn.yaml", None, {})
    s = turn.prepare_s + turn.duration_s
    kinds = tuple(name for name in DRAWS if not name.startswith(("chamber", "calibrator", "reference", "trip")))
    return [campaign_of(SHORT, folder, INTERVAL_S), Campaign("turn", turn, watchers(turn), s, INTERVAL_S, kinds)]


def swept(seeds: range, folder: Path) -> dict[int, dict[str, str]]:
    """Return what was wrong by seed; each fourth seed is one of the table."""
    of_current, of_table = campaigns(folder)
    found, ends = {}, dict[str, int]()
    for seed in seeds:
        with pytest.MonkeyPatch.context() as patch:
            sweep = Sweep(of_table if seed % 4 == 3 else of_current, seed, folder / str(seed), patch)
        found[seed] = sweep.wrong
        ends[sweep.ended] = ends.get(sweep.ended, 0) + 1
    print(ends)
    return {seed: wrong for seed, wrong in found.items() if wrong}


@pytest.mark.parametrize(
    "count", [pytest.param(12, marks=pytest.mark.slow), pytest.param(300, marks=pytest.mark.sweep)]
)
def test_no_view_says_off_while_it_is_on(tmp_path: Path, count: int) -> None:
    assert swept(range(count), tmp_path) == {}


def test_a_kind_of_step_with_a_falsely_empty_set_of_effects_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(PlannedCall, "effects", no_effect)
    (wrong,) = swept(range(1), tmp_path).values()
    assert "leave it off" in wrong["undeclared"]


def test_a_fold_that_takes_all_for_off_is_found_in_every_view(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_state._Part, "known", lambda part: (False, VIRTUAL_START_UTC_NS / 1e9))
    monkeypatch.setattr(bench_state, "GOOD_FOR", 1000.0)
    (wrong,) = swept(range(1), tmp_path).values()
    views = {"page", "list", "top", "metrics"}
    assert {*views, "message", *(f"recorded {view}" for view in views)} <= wrong.keys()
