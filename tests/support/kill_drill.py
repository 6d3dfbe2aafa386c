"""Runs of half a minute on a served bench that are killed and gone on with, as a person or a service would do it.

Everything is judged from outside: what the simulated instruments really do, what the folder holds, what the commands
say. Instants are seconds since the start of a process, so they also fall into its start and into its end.
"""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from served import SAFE_S, Served

from bench.commands.control import ask as ask_run
from bench.commands.session import replay
from bench.model.errors import BenchError
from bench.model.quantities import Quality
from bench.record import RecordRow, SessionReader, read_journal
from bench.replay import replay_rows
from bench.run.guard.diary import read_diary

SEQUENCE = "scale_factor_wall_30s"
RECORDS = 10
SOME_RECORDS = 3
RUN_S = 47.0  # from the start of the process to its results, on an idle machine
LONGEST_S = 240.0
GO_ON = (-signal.SIGKILL, 3)  # ended by its guard or by itself, safely: on a machine without time to spare
MOST_TIMES = 4
LOOK_S = 0.03
GIVE_UP_S = 20.0
HOLDS_S = 1.5
COMPARED = ("dsf_n", "dsf_p", "bias")  # independent of each other, at each temperature
_ONE_AT_A_TIME = threading.Lock()  # replays share this process


@dataclass
class Killed:
    """One process that was killed: when, and after how long the last output went off (negative: none was on)."""

    instant_s: float
    safe_s: float
    phase: str  # "start", "prepare", "campaign", "finally", "end" of the plan, or "resume" for the way back into it


@dataclass
class Drilled:
    """A run with all its kills, and what its folder says at the end."""

    kills: list[Killed] = field(default_factory=list)
    acknowledged: int = 0
    withdrawn: int = 0
    begun_anew: int = 0
    ended_early: int = 0  # nobody killed it: the machine had no time for it
    flagged: int = 0  # records that say themselves that they are not whole, for the same reason
    trouble: list[str] = field(default_factory=list)
    folder: Path = Path()
    estimates: dict[str, tuple[float, float]] = field(default_factory=dict)  # value and expanded uncertainty

    @property
    def worst_s(self) -> float:
        return max((one.safe_s for one in self.kills), default=0.0)


class Process:
    """``bench ...`` as a process; its output goes to a file."""

    def __init__(self, log: Path, *words: str) -> None:
        self.log = log
        self.begun_s = time.monotonic()
        with log.open("ab") as stream:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "bench", *words], stdout=stream, stderr=stream, stdin=subprocess.DEVNULL
            )
        self.pid = self._process.pid

    def ended_by(self, instant_s: float) -> int | None:
        """Exit status if it ends before that many seconds after its start."""
        try:
            return self._process.wait(max(0.0, self.begun_s + instant_s - time.monotonic()))
        except subprocess.TimeoutExpired:
            return None

    def signal(self, number: int) -> float:
        """Send a signal; returns the monotonic time just before it."""
        moment_s = time.monotonic()
        os.kill(self.pid, number)
        return moment_s

    def end(self) -> None:
        """Whatever it does, it is gone afterwards."""
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()

    def said(self) -> str:
        return self.log.read_text(errors="replace")


def unsafe(state: Mapping[str, Any]) -> list[str]:
    """What a bench at rest must not do, as it really is."""
    found = []
    for role, outputs in state["instruments"].items():
        found += [f"{role} {name}" for name in ("operating", "on") if outputs.get(name)]
        found += [f"{role} closed"] if outputs.get("closed") else []
        found += [f"{role} runs"] if outputs.get("mode") == "running" else []
    return found


def safe_after_s(served: Served, moment_s: float) -> tuple[float, list[str]]:
    """Wait until the bench is safe: seconds from ``moment_s`` to the last change, and what is still on if it is not."""
    end_s = time.monotonic() + GIVE_UP_S
    while on := unsafe(state := served.state()):
        if time.monotonic() > end_s:
            return GIVE_UP_S, on
        time.sleep(LOOK_S)
    changed_s = max(state["time_s"] - one["unchanged_s"] for one in state["instruments"].values())
    return changed_s - moment_s, []


def acknowledged(folder: Path) -> dict[int, RecordRow]:
    """Records whose event is in the session, by number, with their sums."""
    try:
        return {row.window.number: row for row in replay_rows(folder).measurement_rows}
    except BenchError:  # killed before there was anything to read
        return {}


def verified(folder: Path) -> int:
    """Number of the last step in the journal, -1 without one."""
    entries = read_journal(folder).entries
    return entries[-1].number if entries else -1


def phase_of(folder: Path | None, again: bool) -> str:
    """Where a run was that is dead now."""
    if folder is None or not (entries := read_journal(folder).entries):
        return "end" if folder is not None and list(folder.glob("results.json")) else "start"
    kinds = [kind for kind, _, _ in SessionReader(folder).events()]
    last = len(kinds) - kinds[::-1].index("resume") if again and "resume" in kinds else 0
    return entries[-1].phase if not again or "phase" in kinds[last:] else "resume"


def session_in(out: Path) -> Path | None:
    """The newest session that can be gone on with, or is whole."""
    folders = sorted(path for path in out.iterdir() if path.is_dir()) if out.is_dir() else []
    return folders[-1] if folders else None


def resumable(folder: Path) -> bool:
    """Whether its manifest reached the file; before that nothing had been switched on."""
    try:
        return bool(SessionReader(folder).manifest)
    except BenchError:
        return False


def killed(process: Process, out: Path) -> float:
    """The controller is gone at once; the time of it."""
    return process.signal(signal.SIGKILL)


def _records_in(folder: Path | None) -> int:
    """Records that are in a session, without a look at what they hold."""
    try:
        return 0 if folder is None else sum(1 for _ in SessionReader(folder).events("record"))
    except BenchError:
        return 0


def killed_among_records(process: Process, out: Path) -> float:
    """As soon as some records are acknowledged, however slow the machine is."""
    after_some_records(out)
    return process.signal(signal.SIGKILL)


def after_some_records(out: Path) -> None:
    """Wait until some records are acknowledged."""
    end_s = time.monotonic() + LONGEST_S
    while time.monotonic() < end_s and _records_in(session_in(out)) < SOME_RECORDS:
        time.sleep(1.0)


def stopped(process: Process, out: Path) -> float:
    """The controller does nothing any more and still lives."""
    return process.signal(signal.SIGSTOP)


def held_and_killed(process: Process, out: Path) -> float:
    """Somebody lets the run stand still; then its controller is gone."""
    folder = session_in(out)
    assert folder is not None
    ask_run(folder, "pause", "a drill")
    time.sleep(HOLDS_S)
    return process.signal(signal.SIGKILL)


def without_guard(process: Process, out: Path) -> float:
    """The guard is gone; the controller must not go on without it."""
    folder = session_in(out)
    assert folder is not None
    ready = [entry for entry in read_diary(folder / "guard.jsonl") if entry["what"] == "ready"]
    moment_s = time.monotonic()
    os.kill(int(ready[-1]["pid"]), signal.SIGKILL)
    assert process.ended_by(moment_s - process.begun_s + GIVE_UP_S) == 3, process.said()[-600:]
    return moment_s


Act = Callable[[Process, Path], float]


def drill(
    served: Served, out: Path, instants_s: Sequence[float], *acts: Act, sequence: str = SEQUENCE, records: int = RECORDS
) -> Drilled:
    """Start a run, kill it at each instant in turn (the first in the run, the others in what goes on), let it end.

    ``acts``: what is done at each instant, the last one at all that follow.

    Raises nothing for what is wrong with the bench: that is in ``trouble``.
    """
    out.mkdir(parents=True)
    done = Drilled()
    due = list(instants_s)
    while True:
        folder = session_in(out)
        if folder is not None and not resumable(folder):
            done.begun_anew += 1
            folder = None
        begin = ["run", sequence, "--station", str(served.station), "--clock", "wall", "--out", str(out)]
        process = Process(out / "said.txt", *(begin if folder is None else ["resume", str(folder)]))
        try:
            status = process.ended_by(due[0] if due else LONGEST_S)
            if status is None and due:
                act = acts[min(len(done.kills), len(acts) - 1)]
                _killed(done, served, process, out, due.pop(0), act, again=folder is not None)
                continue
        finally:
            process.end()
        refused = status == 2 and "B-RUN-080" in process.said()  # a disk too busy for a start
        if (status in GO_ON or refused) and done.ended_early < MOST_TIMES:
            done.ended_early += 1
            safe_after_s(served, time.monotonic())
            process.log.rename(out / f"ended_early{done.ended_early}.txt")
            continue
        break
    _judge(done, out, status, process.said()[-600:], records)
    return done


def _killed(
    done: Drilled, served: Served, process: Process, out: Path, instant_s: float, act: Act, again: bool
) -> None:
    moment_s = act(process, out)
    safe_s, on = safe_after_s(served, moment_s)
    process.end()  # one that is stopped and has no guard: nothing was on
    folder = session_in(out)
    done.kills.append(Killed(instant_s, safe_s, phase_of(folder, again)))
    if on or safe_s > SAFE_S:
        done.trouble.append(f"{safe_s:.2f} s after the kill at {instant_s:.2f} s: {on or 'late'}")
    if folder is None or not resumable(folder):
        return
    (folder / "before.json").write_text(
        json.dumps(
            {
                "rows": {str(number): sums_of(row) for number, row in acknowledged(folder).items()},
                "step": verified(folder),
                "segments": sorted(path.name for path in folder.glob("*.mcap")),
            }
        )
    )
    (folder / "before.json").rename(out / f"before{len(done.kills)}.json")


def sums_of(row: RecordRow) -> dict[str, Any]:
    """What must never change in a record any more."""
    sums = {name: values.tolist() for name, values in row.sums.items()}
    return {"step": row.window.step, "frames": row.frames, "lost": row.lost, "sums": sums}


def _judge(done: Drilled, out: Path, status: int | None, said: str, records: int) -> None:
    """Compare the end with what was there at each kill."""
    folder = session_in(out)
    if folder is None:
        done.trouble.append(f"ended with {status} without a session: {said}")
        return
    done.folder = folder
    found = acknowledged(folder)
    rows = {str(number): sums_of(row) for number, row in found.items()}
    done.flagged = sum(row.quality != Quality.GOOD for row in found.values())
    _nothing_lost(done, out, folder, rows)
    had_ended = status == 2 and "B-RES-001" in said  # the kill came behind the last word; all that follows is judged
    if status != 0 and not done.flagged and not had_ended:  # a result that lacks flagged records is not 0, and says so
        done.trouble.append(f"ended with {status}: {said}")
    if not (folder / "results.json").is_file():
        if not done.flagged:
            done.trouble.append("no results")
        return
    results = json.loads((folder / "results.json").read_text())
    steps = {row["step"] for row in rows.values()}
    if results["quality"]["records"] != records or len(steps) != records:
        done.trouble.append(f"{results['quality']['records']} records at {len(steps)} steps")
    _splices(done, folder, results)
    with _ONE_AT_A_TIME:
        try:
            if replay(folder, as_json=False) != 0:
                done.trouble.append("replay is not identical")
        except BenchError as error:
            done.trouble.append(f"replay: {error}")
    done.trouble += [f"{name} is left" for name in ("session.open", "journal.jsonl") if (folder / name).exists()]
    if not done.flagged:
        done.estimates = compared_of(results)


def compared_of(results: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Value and expanded uncertainty of what is compared between runs."""
    return {
        f"{one['quantity']} at {one['conditions']['temperature_degC']:g} degC": (
            one["value"],
            one["expanded_uncertainty"],
        )
        for one in results["estimates"]
        if one["quantity"] in COMPARED
    }


def _nothing_lost(done: Drilled, out: Path, folder: Path, rows: Mapping[str, Any]) -> None:
    """Every record there was at a kill is there at the end; one whose point was not finished is marked as retaken."""
    retaken = {str(fields["record"]) for _, _, fields in SessionReader(folder).events("retake")}
    for path in sorted(out.glob("before*.json")):
        before = json.loads(path.read_text())
        again = 0
        for number, record in before["rows"].items():
            done.acknowledged += 1
            if rows.get(number) == record:
                continue
            again += 1
            if number not in retaken or record["step"] < before["step"]:
                done.trouble.append(f"{path.stem}: record {number} is lost")
        done.withdrawn += again
        if again > 1:
            done.trouble.append(f"{path.stem}: {again} records were taken again")


def _splices(done: Drilled, folder: Path, results: Mapping[str, Any]) -> None:
    resumed = len(list(SessionReader(folder).events("resume")))
    marked = results["quality"]["splices"], len(results.get("splices", []))
    if marked != (resumed, resumed):
        done.trouble.append(f"{resumed} splices, marked are {marked}")
    if resumed and "Splices" not in (folder / "report.html").read_text():
        done.trouble.append("the report shows no splice")


def normalised_errors(one: Drilled, other: Drilled) -> dict[str, float]:
    """E_n of each estimate that both have: the difference over the root sum of squares of the expanded uncertainties.

    Two honest 95 % results differ by more than 1 in one case of twenty. Source: ISO/IEC 17043:2023, B.3.1.3.
    """
    names = one.estimates.keys() & other.estimates.keys()
    pairs = {name: (one.estimates[name], other.estimates[name]) for name in names}
    return {name: abs(a - b) / (u_a**2 + u_b**2) ** 0.5 for name, ((a, u_a), (b, u_b)) in pairs.items()}
