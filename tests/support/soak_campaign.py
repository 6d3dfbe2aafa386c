"""Virtual campaigns under faults drawn from a seed, and what must be true of each whatever happened.

The short one has every kind of step of the 38-hour one: prompts, power, wiring check, soaks, open points, both
polarities, a closing repeat; 25 records in some 250 s of bench time, with a fault each 80 s. A long one is a published
sequence, under faults a run lives through: what ends a run is the business of the short ones.

Of one that violates it: the few faults that are needed. Run as a command it soaks one seed in a process of
its own, as what went on before would hide or feign a growth of what it needs each hour, and prints one JSON document;
words: sequence, seed, folder and, if what Python and numpy have allocated is to be traced, held.
"""

import ctypes
import gc
import json
import math
import resource
import sys
import threading
import tracemalloc
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from statistics import median
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

from fault_schedule import DRAWS, TimedFault, random_schedule, schedule
from plan_sample import reworded
from soak_views import Views
from trials import without_trials

from bench.analysis import Estimate, declared_analysis, estimates_of, is_sound
from bench.commands.run import view_of
from bench.model.clock import NS, VirtualClock
from bench.model.errors import BenchError, FitError
from bench.model.installed import named
from bench.model.quantities import Quality
from bench.plan import Plan, check_plan, compile_sequence, load_station
from bench.record.writer import RETIRED_FILES
from bench.replay import replay_rows
from bench.run.besides import besides
from bench.run.control.live import LiveFeed
from bench.run.guard.guarding import guard_beside
from bench.run.operator import SimulatedOperator
from bench.run.session import Conducted, conduct
from bench.session.view import KEPT_EVENTS, analyse_view
from sim_instruments.seeds import generator
from sim_instruments.served.process import OutputWatch
from sim_instruments.worlds import simulation
from sim_instruments.worlds.common.world import World

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
SHORT = "soak"  # the name of the short campaign; a long one has that of its sequence
DURATION_S = 250.0
MEAN_INTERVAL_S, LONG_INTERVAL_S = 80.0, 1800.0
LIVED_THROUGH = (
    "bit_errors", "drop", "duplicate", "late", "garbled", "nan", "overload", "reference_lost", "stuck", "unplug",
)  # fmt: skip
TURN = "time_sync_turn"  # the shortest campaign with a table
OF_A_TABLE = tuple(kind for kind in DRAWS if not kind.startswith(("calibrator", "chamber", "reference", "trip")))
MOST_SIGMA = 5.0
HEAT_MAY_STAY_degC = 1.0  # above the hard limit, until the guard has looked and acted
HOUR_S = 3600.0
QUIET: Any = SimpleNamespace(**dict.fromkeys(("step", "record", "message"), lambda *_: None))


def watchers(plan: Plan) -> list[Any]:
    """What goes on beside the sequencer in ``bench run`` under the virtual clock."""
    return [guard_beside(plan.station), *besides(plan, {}, virtual=True)]


def soak_plan(folder: Path) -> Plan:
    """The short campaign on a fast bench, compiled and checked."""
    bench = reworded(
        (ROOT / "stations" / "af_bench_sim.yaml").read_text(),
        ("station: af_bench_sim", "station: soak_bench"),
        ('visa: "@bench"', 'visa: "@bench"\nbus_time_factor: 0.05'),
        ("    af_clock_error_ppm: null", "    af_clock_error_ppm: null\n    time_constants: 20"),
        once=True,
    )
    station = folder / "soak_bench.yaml"
    station.write_text(bench)
    plan = compile_sequence(HERE / "soak.yaml", load_station(station), {})
    assert check_plan(plan, plan.station) == []
    return plan


@dataclass
class Soaked:
    """One campaign: its faults, how it ended, and every invariant that does not hold; ``hours``: of bench time."""

    seed: int
    faults: Sequence[TimedFault]
    ended: str = ""
    violations: list[str] = field(default_factory=list)
    estimates: int = 0
    flagged: int = 0
    hours: float = 0.0


@dataclass(frozen=True)
class Campaign:
    """A campaign to be soaked: its plan, how its faults are drawn, and what goes on beside the sequencer."""

    name: str
    plan: Plan
    besides: Sequence[Any]
    duration_s: float
    mean_interval_s: float
    kinds: tuple[str, ...]

    def faults(self, seed: int) -> list[TimedFault]:
        """Draw the faults of one seed."""
        roles, links = list(self.plan.station.instruments), list(self.plan.station.links)
        return random_schedule(seed, self.duration_s, roles, links, self.mean_interval_s, self.kinds)

    def soaked(
        self,
        seed: int,
        folder: Path,
        faults: Sequence[TimedFault] | None = None,
        clock: Callable[[], VirtualClock] = VirtualClock,
    ) -> Soaked:
        """Run one seed under the faults it draws, or under these, and judge it."""
        drawn = self.faults(seed) if faults is None else faults
        views = self.duration_s <= LONG_INTERVAL_S  # hours of them would be a growth
        return soak_one(self.plan, seed, folder, drawn, self.besides, clock(), views=views)


def campaign_of(name: str, folder: Path, mean_interval_s: float | None = None) -> Campaign:
    """Compile the short campaign or that of a sequence; ``folder`` is for the station of the short one."""
    if name == TURN:
        plan = compile_sequence(ROOT / "sequences" / f"{TURN}.yaml", None, {})
        return Campaign(name, plan, watchers(plan), plan.prepare_s + plan.duration_s, MEAN_INTERVAL_S, OF_A_TABLE)
    if name == SHORT:
        plan = soak_plan(folder)
        interval_s = mean_interval_s or MEAN_INTERVAL_S
        return Campaign(name, plan, watchers(plan), DURATION_S, interval_s, tuple(DRAWS))
    plan = compile_sequence(ROOT / "sequences" / f"{name}.yaml", None, {})
    assert check_plan(plan, plan.station) == []
    duration_s = plan.prepare_s + plan.duration_s
    return Campaign(name, plan, watchers(plan), duration_s, mean_interval_s or LONG_INTERVAL_S, LIVED_THROUGH)


def soak_one(
    plan: Plan, seed: int, folder: Path, faults: Sequence[TimedFault], besides: Any, clock: VirtualClock, *, views: bool
) -> Soaked:
    """Run the campaign of one seed under these faults and judge it, with ``views`` also what each view shows as off."""
    watches: list[OutputWatch] = []
    shown = Views(clock, float(generator(seed, "kill").uniform(0.0, plan.duration_s))) if views else None
    plain = simulation.open_world

    def open_world(*words: Any, **options: Any) -> World:
        world = plain(*words, **options)
        watches.append(OutputWatch(world))
        if shown is not None:
            shown.begin(world)
        schedule(world, faults)
        return world

    soaked = Soaked(seed, faults)
    fed = LiveFeed.__init__ if shown is None else shown.fed(LiveFeed.__init__)
    with patch.object(simulation, "open_world", open_world), patch.object(LiveFeed, "__init__", fed):
        try:
            done = conduct(
                plan, clock=clock, seed=seed, out=folder, operator=SimulatedOperator(), listener=QUIET,
                keep_events=(*KEPT_EVENTS, "hold"), beside=besides,
            )  # fmt: skip
        except Exception as error:  # before a session exists: still the bench must be safe
            soaked.ended = f"refused: {getattr(error, 'code', type(error).__name__)}"
            done = None
    soaked.hours = clock.now_ns() / NS / HOUR_S
    soaked.violations += _unsafe(
        watches[-1].state(), done, plan.station.guard_limits_degC.get("chamber_air_degC", math.inf)
    )
    if done is not None:
        soaked.ended = "done" if done.outcome.error is None else done.outcome.error.code
        if soaked.ended.startswith("B-INT"):
            soaked.violations.append(f"internal error: {done.outcome.error}")
        soaked.violations += _invalid(done)
        if shown is not None:
            shown.end(done)
            soaked.violations += [f"{view}: {why}" for view, why in shown.wrong.items()]
        _judge(plan, done, soaked)
    elif "B-" not in soaked.ended:
        soaked.violations.append(soaked.ended)
    return soaked


def _unsafe(state: Mapping[str, Any], done: Conducted | None, limit_degC: float) -> list[str]:
    """The outputs as they really are; what the run itself reported as not confirmed safe is not a silent violation."""
    reported = {error.where for error in done.outcome.unsafe} if done is not None else set()
    found = []
    for role, outputs in state["instruments"].items():
        if any(role in where for where in reported):
            continue
        found += [f"unsafe: {role} {name}" for name in ("operating", "on") if outputs.get(name)]
        if outputs.get("closed"):
            found.append(f"unsafe: {role} closed {outputs['closed']}")
    air_degC = state["chamber_air_degC"]
    if air_degC > limit_degC + HEAT_MAY_STAY_degC and state["instruments"]["chamber"]["mode"] != "stopped":
        found.append(f"unsafe: the chamber is at {air_degC:.1f} degC and runs")
    return found


def _invalid(done: Conducted) -> list[str]:
    """Whatever is wrong with the recording: it is read once, which checks every byte of it, and cut anew."""
    try:
        replayed = replay_rows(done.folder)
    except BenchError as error:
        return [f"session damaged: {error}"]
    found = [f"session damaged: {item}" for item in replayed.damage]
    found += [f"session not finished: {name}" for name in replayed.unfinished]
    again = {row.window.number: row for row in replayed.measurement_rows}
    rows = {row.window.number: row for row in done.outcome.rows}
    if rows.keys() != again.keys():
        return [*found, f"replay has records {sorted(again)} instead of {sorted(rows)}"]
    for number, row in rows.items():
        other = again[number]
        if (row.frames, row.lost, row.quality) != (other.frames, other.lost, other.quality) or any(
            (value != other.sums[name]).any() for name, value in row.sums.items()
        ):
            found.append(f"record {number} replays differently")
    return found


def _judge(plan: Plan, done: Conducted, soaked: Soaked) -> None:
    """Every estimate lies within MOST_SIGMA of its stated standard uncertainty of the truth, or is flagged."""
    if done.outcome.error is not None:
        return
    try:
        with without_trials():  # they take as long as all the rest, and nothing is judged by them
            results, _ = analyse_view(view_of(plan, done))
    except FitError as error:  # nothing is left that a number could be made of, and it says so
        soaked.ended = f"done without results: {error.code}"
        return
    suspect = any(row.quality & ~Quality.GOOD for row in done.outcome.rows)
    weigh_estimates(estimates_of(results), done.truth, soaked, suspect=suspect)


def weigh_estimates(
    estimates: Sequence[Estimate], truth: Sequence[Mapping[str, Any]], soaked: Soaked, *, suspect: bool
) -> None:
    """Hold estimates of results.json against the truth; one without value or uncertainty must be called unsound.

    ``suspect``: a record of the campaign is not as it should be, which flags what comes of it.
    """
    for entry in estimates:
        key, true = f"{entry.quantity} {entry.conditions}", _true_values(entry, truth)
        if entry.value is None or entry.std_uncertainty is None:
            soaked.flagged += bool(true)
            if is_sound(entry):
                soaked.violations.append(f"{key}: no value or no uncertainty, and called sound")
            continue
        if not true:
            continue
        soaked.estimates += 1
        sigma = min(((entry.value - value) / entry.std_uncertainty for value in true), key=abs)
        if not abs(sigma) <= MOST_SIGMA or math.isnan(sigma):
            if entry.dropped or suspect:
                soaked.flagged += 1
            else:
                soaked.violations.append(f"{key}: {entry.value:.6g} is {sigma:+.1f} sigma off {true}")


def _true_values(entry: Estimate, truth: Sequence[Mapping[str, Any]]) -> list[float]:
    """Return what a quantity is under these conditions: of one that drifts, at several moments."""
    of_it = [true for true in truth if true["quantity"] == entry.quantity]
    return [
        float(true["value"])
        for true in of_it
        if all(entry.conditions.get(name, value) == value for name, value in true["conditions"].items())
    ]


def shortest(faults: Sequence[TimedFault], fails: Callable[[Sequence[TimedFault]], bool]) -> list[TimedFault]:
    """Return a part of a list that fails and does no longer when any one of its faults is left out.

    Ever smaller pieces are left out, single ones until a round changes nothing. The whole list must fail: it is not
    tried again. Source: A. Zeller, R. Hildebrandt, IEEE Trans. Software Eng. 28(2), 183-200 (2002), simplified.
    """
    kept = list(faults)
    size = len(kept)
    while size:
        at, before = 0, len(kept)
        while at < len(kept):
            rest = kept[:at] + kept[at + size :]
            if fails(rest):
                kept = rest
            else:
                at += size
        size = size // 2 if size > 1 or len(kept) == before else 1
    return kept


MOST_MiB = 1.0  # growth of what is held, after the first hours
MOST_RESIDENT_MiB = 2.5  # of the whole process, with the simulator's large blocks and the gaps they leave
SHARE = 6  # hours at either end
ALLOCATOR = {"MALLOC_MMAP_THRESHOLD_": "65536"}  # what is freed goes back to the system, so that resident means needed


@dataclass(frozen=True)
class Hour:
    """What the process needs at one hour of bench time; ``held``: traced by Python, 0 if it is not."""

    hour: float
    resident_MiB: float
    held_MiB: float
    descriptors: int
    threads: int


class HourlyClock(VirtualClock):
    """A virtual clock on which each hour it is noted what the process needs."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: list[Hour] = []
        self.every(HOUR_S, self.look)

    def look(self) -> None:
        """Note it now."""
        gc.collect()
        ctypes.CDLL(None).malloc_trim(0)  # what the C library keeps for the next time is not needed
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        self.seen.append(
            Hour(
                self.now_ns() / NS / HOUR_S,
                pages * resource.getpagesize() / 2**20,
                tracemalloc.get_traced_memory()[0] / 2**20,
                len(list(Path("/proc/self/fd").iterdir())),
                threading.active_count(),
            )
        )


def hourly_clock(campaign: Campaign) -> HourlyClock:
    """Return a clock that looks each hour; what the analysis imports is no growth and comes before."""
    named(declared_analysis(str(campaign.plan.campaign["analysis"])).module)
    return HourlyClock()


def growth_MiB(values: Sequence[float]) -> float:
    """From the first hours to the last ones; what waits for the decoder comes and goes within a megabyte."""
    share = min(SHARE, len(values) // 2)
    return median(values[-share:]) - median(values[:share])


def grown(seen: Sequence[Hour], most_resident_MiB: float = MOST_RESIDENT_MiB) -> list[str]:
    """Return what grew that must not; nothing can be said of a campaign that ended within two hours."""
    if len(seen) < 2:
        return []
    found = []
    resident_MiB, held_MiB = growth_MiB([hour.resident_MiB for hour in seen]), growth_MiB([h.held_MiB for h in seen])
    if resident_MiB > most_resident_MiB:
        found.append(f"resident memory grew by {resident_MiB:.2f} MiB")
    if held_MiB > MOST_MiB:
        found.append(f"held memory grew by {held_MiB:.2f} MiB")
    if {hour.threads for hour in seen} != {seen[0].threads}:
        found.append(f"threads: {[hour.threads for hour in seen]}")
    later = {hour.descriptors for hour in seen if hour.hour > RETIRED_FILES + 1}
    if len(later) > 1 or any(hour.descriptors > seen[0].descriptors + RETIRED_FILES for hour in seen):
        found.append(f"descriptors: {[hour.descriptors for hour in seen]}")
    return found


def main(sequence: str, seed: str, folder: str, traced: str = "") -> dict[str, Any]:
    """Soak one seed; tracing itself needs room, so that resident memory is not judged then."""
    if traced:
        tracemalloc.start(1)
    campaign = campaign_of(sequence, Path(folder))
    clock = hourly_clock(campaign)
    soaked = campaign.soaked(int(seed), Path(folder), clock=lambda: clock)
    found = grown(clock.seen, float("inf") if traced else MOST_RESIDENT_MiB)
    return {
        "ended": soaked.ended, "violations": soaked.violations + found, "estimates": soaked.estimates,
        "flagged": soaked.flagged, "faults": len(soaked.faults), "hours": [asdict(hour) for hour in clock.seen],
    }  # fmt: skip


if __name__ == "__main__":
    sys.stdout.write(json.dumps(main(*sys.argv[1:])) + "\n")
