"""Rows 1 and 25: controllers that die at random instants, in bulk, and behind the last step; what is left then.

Several benches at once, each a process with instruments of its own; every run and every resumption is a process too.
"""

import json
import shutil
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np
import pytest
from kill_drill import (
    RUN_S,
    Act,
    Drilled,
    compared_of,
    drill,
    held_and_killed,
    killed,
    killed_among_records,
    normalised_errors,
    stopped,
    without_guard,
)
from plan_sample import ONE_TEMPERATURE, one_temperature
from rehearsal import Inside, rehearsed
from served import SAFE_S, Served
from soak_campaign import soak_plan

from bench.commands.resume import resume
from bench.commands.session import replay
from bench.model.errors import ExitStatus, InputError
from bench.record import SessionReader, SessionWriter
from bench.session.service import read_view
from bench.session.view import analyse_view

SEED = 20
BENCHES = 3
KILLS = 100
STOPS = 20
OTHERS = 6  # of each other kind
Job = tuple[Any, ...]  # instants, then what is done at each
UNDISTURBED = 3  # runs of each bench
MOST_E_N = 2.2  # 4.3 standard deviations of a difference: one in 60,000 honest results
MOST_FLAGGED = 0.1  # runs with a record that the machine gave no time to; on an idle one there is none
MOST_ABOVE_1 = 0.08  # honest 95 % intervals: 0.05


@pytest.fixture
def pool(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[list[Served]]:
    count = getattr(request, "param", BENCHES)
    found = [Served(tmp_path / f"bench{number}", "--seed", str(SEED)) for number in range(count)]
    yield found
    for served in found:
        served.close()


def all_of(pool: list[Served], out: Path, jobs: Sequence[Job], **more: Any) -> list[Drilled]:
    """Every job (instants, what is done then) on the next bench that is free, in the order of the jobs."""
    free: SimpleQueue[Served] = SimpleQueue()
    for served in pool:
        free.put(served)

    def one(number: int) -> Drilled:
        served = free.get()
        try:
            instants_s, *acts = jobs[number]
            done = drill(served, out / f"run{number}", instants_s, *acts, **more)
        finally:
            free.put(served)
        print(f"{number}: {[(one.phase, round(one.safe_s, 2)) for one in done.kills]} {done.trouble}", flush=True)
        return done

    with ThreadPoolExecutor(len(pool)) as workers:
        return list(workers.map(one, range(len(jobs))))


def told(done: Sequence[Drilled]) -> str:
    kills = [kill for one in done for kill in one.kills]
    worst_s = max(kill.safe_s for kill in kills)
    return (
        f"{len(kills)} kills {dict(Counter(kill.phase for kill in kills))}, outputs off after {worst_s:.2f} s at most; "
        f"{sum(one.acknowledged for one in done)} records were acknowledged, {sum(one.withdrawn for one in done)} of "
        f"points not finished; {sum(one.begun_anew for one in done)} begun anew, "
        f"{sum(one.ended_early for one in done)} ended early and {sum(one.flagged > 0 for one in done)} flagged by a "
        "machine without time"
    )


def held_against(reference: Sequence[Drilled], done: Sequence[Drilled]) -> list[float]:
    """E_n of every estimate against that of an undisturbed run of the same simulated unit."""
    reference = [one for one in reference if one.estimates]
    found = [
        value
        for number, one in enumerate(done)
        for value in normalised_errors(one, reference[number % len(reference)]).values()
    ]
    above = sum(value > 1.0 for value in found)
    print(f"{len(found)} estimates, E_n at most {max(found):.2f}, {above} above 1 ({0.05 * len(found):.0f} expected)")
    return found


def troubles(done: Sequence[Drilled]) -> list[str]:
    return [f"run{number}: {text}" for number, one in enumerate(done) for text in one.trouble]


@pytest.mark.waits
@pytest.mark.slow
@pytest.mark.limit(SAFE_S)
@pytest.mark.parametrize("pool", [1], indirect=True)
def test_a_kill_and_a_stop(pool: list[Served], tmp_path: Path, inside: Inside) -> None:
    """A run is killed inside the points and stopped on its way back into them; one of virtual time is undisturbed."""
    sequence = str(one_temperature(tmp_path))
    jobs = [((18.0, 5.0), killed_among_records, stopped)]
    done = all_of(pool, tmp_path / "out", jobs, sequence=sequence, records=ONE_TEMPERATURE)
    print(told(done))
    assert troubles(done) == []
    assert done[0].worst_s <= SAFE_S
    assert len(done[0].kills) == 2
    assert done[0].acknowledged > 0
    if done[0].estimates:  # a machine without time leaves gaps in the streams, which are flagged
        words = ("--station", "af_rack_sim", "--clock", "virtual", "--seed", str(SEED))
        assert inside("run", sequence, *words, "--out", str(tmp_path / "virtual")).returncode == 0
        (results,) = (tmp_path / "virtual").glob("*/results.json")
        reference = Drilled(estimates=compared_of(json.loads(results.read_text())))
        assert max(held_against([reference], done)) <= MOST_E_N


@pytest.mark.waits
@pytest.mark.sweep
def test_a_hundred_kills(pool: list[Served], tmp_path: Path) -> None:
    """Instants over the whole run; each third time the resumption is killed as well, now and then twice."""
    print(f"seed {SEED}")
    rng = np.random.default_rng(SEED)
    jobs: list[Job] = [((), killed)] * UNDISTURBED
    left = KILLS
    while left > 0:
        first = (left - rng.random()) / KILLS * RUN_S
        more = [float(rng.uniform(1.0, 0.6 * RUN_S)) for _ in range(min(left - 1, int(rng.choice([0, 0, 1, 2]))))]
        jobs.append(((first, *more), killed))
        left -= 1 + len(more)
    done = all_of(pool, tmp_path / "out", jobs)
    print(told(done))
    errors = held_against(done[:UNDISTURBED], done[UNDISTURBED:])
    assert troubles(done) == []
    assert max(one.worst_s for one in done) <= SAFE_S
    assert max(errors) <= MOST_E_N
    assert sum(value > 1.0 for value in errors) <= MOST_ABOVE_1 * len(errors)
    assert sum(len(one.kills) for one in done) >= KILLS - 5  # one that had ended before its instant was not killed
    assert sum(one.acknowledged for one in done) > KILLS
    assert sum(one.flagged > 0 for one in done) <= MOST_FLAGGED * len(done)


@pytest.mark.waits
@pytest.mark.sweep
@pytest.mark.parametrize(
    ("act", "count", "first_s", "last_s"),
    [
        (stopped, STOPS, 4.0, RUN_S),
        (held_and_killed, OTHERS, 12.0, 0.8 * RUN_S),
        (without_guard, OTHERS, 12.0, 0.8 * RUN_S),
    ],
)
def test_stopped_and_killed_while_holding_and_without_its_guard(
    pool: list[Served], tmp_path: Path, act: Act, count: int, first_s: float, last_s: float
) -> None:
    rng = np.random.default_rng(SEED + 1)
    done = all_of(pool, tmp_path / "out", [((float(at),), act) for at in rng.uniform(first_s, last_s, count)])
    print(told(done))
    assert troubles(done) == []
    assert max(one.worst_s for one in done) <= SAFE_S


@dataclass
class Ended:
    """A run that has ended, and its folder as it was just before the session was closed."""

    whole: Path
    unclosed: Path


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> Ended:
    folder = tmp_path_factory.mktemp("ended")
    plain = SessionWriter.close

    def close(self: SessionWriter, reason: str) -> str:
        self.flush()
        shutil.copytree(self.folder, folder / "unclosed" / self.folder.name)
        return plain(self, reason)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SessionWriter, "close", close)
        run = rehearsed(folder / "out", soak_plan(folder), seed=2).run
    assert run.outcome.error is None
    return Ended(run.folder, folder / "unclosed" / run.folder.name)


def copied(source: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(source, tmp_path / source.name))


def switched_on(folder: Path) -> int:
    """How often the supply of the unit was switched on in a session."""
    messages = SessionReader(folder).messages(frozenset({"/instrument/supply"}))
    return sum(one.document()["text"].upper().startswith("OUTP ON") for one in messages)


def test_a_session_that_was_not_closed_is_closed_and_nothing_is_switched_on(ended: Ended, tmp_path: Path) -> None:
    folder = copied(ended.unclosed, tmp_path)
    assert (folder / "session.open").exists()
    assert read_view(folder).incomplete
    assert switched_on(folder) > 0
    assert resume(folder, None, None, as_json=True) == ExitStatus.PASS
    view = read_view(folder, strict=True)
    assert not view.incomplete
    assert len(view.splices) == 1
    assert not (folder / "session.open").exists()
    assert switched_on(folder) == switched_on(ended.unclosed)
    before, after = (analyse_view(one)[0]["estimates"] for one in (read_view(ended.whole), view))
    assert [one["value"] for one in after] == [one["value"] for one in before]
    assert replay(folder, as_json=True) == ExitStatus.PASS


def test_results_that_were_not_written_any_more_are_written(ended: Ended, tmp_path: Path) -> None:
    folder = copied(ended.whole, tmp_path)
    segments = {path.name: path.read_bytes() for path in folder.glob("*.mcap")}
    assert resume(folder, None, None, as_json=True) == ExitStatus.PASS
    assert replay(folder, as_json=True) == ExitStatus.PASS
    (folder / "report.html").unlink()  # killed between the two
    assert resume(folder, None, None, as_json=True) == ExitStatus.PASS
    assert {path.name: path.read_bytes() for path in folder.glob("*.mcap")} == segments
    with pytest.raises(InputError, match="B-RES-001"):
        resume(folder, None, None, as_json=True)
