"""Campaigns that go another way: held up at random instants, on the wall clock; a replay agrees."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rehearsal import ROOT, SOAK_s, rehearsed, tiny_plan

from bench.commands.run import view_of
from bench.model.clock import WallClock
from bench.plan import Plan, check_plan, compile_sequence
from bench.replay import replay_rows
from bench.run.besides import besides
from bench.run.context import RunContext
from bench.run.session import Conducted
from bench.run.stop import Wish
from bench.session.view import KEPT_EVENTS, analyse_view

COVERAGE = 5.0  # standard deviations of a difference
WALL = """\
sequence: wall
station: af_bench_sim
frame: {port_a: ngu_a, port_b: ngu_b}
unit_commands:
  start_stream: {code: 2, payload: "64"}
prepare:
  - supply.configure: {voltage: 18 V, current_limit: 2 A, over_voltage: 21 V}
  - supply.output_on
  - settle: 3 s
  - unit: {port_b: start_stream}
  - settle: 1 s
steps:
  - record: {seconds: 500 ms, windows: 6, pulse_timing: true, conditions: {route: open}}
  - supply.measure_current
  - record: {seconds: 500 ms, windows: 4, follows: true, pulse_timing: true, conditions: {route: open}}
"""
Moment = tuple[float, float, str]  # seconds from the start, seconds of the hold, kind


def disturbed(plan: Plan, out: Path, moments: list[Moment]) -> Conducted:
    """Run with holds, retakes and skips."""

    @contextmanager
    def somebody(context: RunContext) -> Iterator[None]:
        holds = context.stop.holds
        waiting = sorted(moments)
        running: list[tuple[float, str]] = []

        def look() -> None:
            now_s = context.clock.now_ns() / 1e9
            while waiting and waiting[0][0] <= now_s:
                _, length_s, kind = waiting.pop(0)
                if kind == "hold":
                    holds.hold(f"test {now_s:g}", "test")
                    running.append((now_s + length_s, f"test {now_s:g}"))
                else:
                    holds.wish(Wish(kind, "test", "test"))  # type: ignore[arg-type]
            for until_s, by in [one for one in running if one[0] <= now_s]:
                holds.release(by)
                running.remove((until_s, by))

        periodic = context.clock.every(0.7, look)
        yield
        periodic.cancel()

    run = rehearsed(out, plan, beside=[*besides(plan, {}, virtual=True), somebody], kept=KEPT_EVENTS).run
    assert run.outcome.error is None
    check_replay(run)
    return run


def check_replay(run: Conducted) -> None:
    again = replay_rows(run.folder, strict=True)
    assert [comparable(row) for row in again.measurement_rows] == [comparable(row) for row in run.outcome.rows]
    assert (again.totals, again.session_sha256) == (dict(run.counts), run.session_sha256)


def comparable(row: Any) -> tuple[object, ...]:
    sums, timing = ({name: value.tolist() for name, value in each.items()} for each in (row.sums, row.timing))
    counts = row.frames, row.lost, row.bad, row.duplicate, row.suspect
    return row.window, sums, timing, counts, row.quality, dict(row.context)


def check_true(plan: Plan, run: Conducted) -> None:
    """Every result the simulation knows the truth of is within 5 of its standard deviations of it."""
    results, _ = analyse_view(view_of(plan, run))
    true = {named(one): one["value"] for one in run.truth}
    found = {named(one): one for one in results["estimates"] if named(one) in true}
    assert len(found) >= 0.5 * len(true) > 0  # with one temperature there are no coefficients
    for name, one in found.items():
        assert abs(one["value"] - true[name]) <= COVERAGE * one["std_uncertainty"], name


def named(estimate: Mapping[str, Any]) -> str:
    conditions = {name: value for name, value in estimate["conditions"].items() if "unit_temperature" not in name}
    return f"{estimate['quantity']} {sorted(conditions.items())}"


def random_moments(seed: int, begin_s: float, length_s: float, count: int, *kinds: str) -> list[Moment]:
    rng = np.random.default_rng(seed)
    moments = [
        (begin_s + float(rng.uniform(10.0, length_s)), float(rng.uniform(0.0, 90.0)), str(rng.choice(kinds)))
        for _ in range(count)
    ]
    print(f"seed {seed}: {moments}")
    return moments


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.sweep) for seed in range(2, 12))])
def test_a_scale_factor_campaign_with_holds(tmp_path: Path, seed: int) -> None:
    plan = tiny_plan(tmp_path)
    moments = random_moments(seed, plan.prepare_s + SOAK_s, 450.0, 6, "hold", "retake")
    run = disturbed(plan, tmp_path / "held", moments)
    first = run.outcome.rows[0].window.number
    assert [row.window.number - first for row in run.outcome.rows] == list(range(15))
    wanted = [dict(step.conditions) for step in plan.steps if step.kind == "record" and step.phase == "campaign"]
    for row, conditions in zip(run.outcome.rows, wanted, strict=True):
        assert {name: row.window.conditions[name] for name in conditions} == conditions
        assert row.lost == 0
    kinds = [kind for kind, _, _ in run.events]
    assert kinds.count("hold") == kinds.count("release") >= 1
    check_true(plan, run)


def test_nothing_trips_in_an_undisturbed_campaign_and_a_skipped_point_is_missing_from_the_replay_too(
    tmp_path: Path,
) -> None:
    plan = tiny_plan(tmp_path)
    run = disturbed(plan, tmp_path, [(plan.prepare_s + SOAK_s + 100.0, 0.0, "skip")])
    assert [event for event in run.events if event[0] in ("interlock", "alarm", "hold")] == []
    assert len(run.outcome.rows) == 14
    assert [kind for kind, _, _ in run.events].count("skip") == 1


@pytest.mark.sweep
@pytest.mark.parametrize("seed", range(4))
def test_a_bias_ramp_with_holds(tmp_path: Path, seed: int) -> None:
    """Its records follow each other through a ramp: a hold begins the record under way anew."""
    plan = compile_sequence(ROOT / "sequences" / "bias_ramp_short.yaml", None, {})
    moments = random_moments(seed, 0.0, plan.prepare_s + plan.duration_s, 4, "hold")
    check_true(plan, disturbed(plan, tmp_path / "held", moments))


@pytest.mark.slow
@pytest.mark.waits
def test_a_run_under_the_wall_clock_replays_row_by_row(tmp_path: Path) -> None:
    """Threads instead of tasks, and still what a replay finds."""
    path = tmp_path / "wall.yaml"
    path.write_text(WALL)
    plan = compile_sequence(path, None, {})
    assert check_plan(plan) == []
    run = rehearsed(tmp_path / "out", plan, clock=WallClock(), seed=1).run
    assert (run.outcome.error, run.outcome.unsafe) == (None, ())
    print(f"timed waits ended {run.outcome.lateness_ms} ms late (median, 99 %, worst)")
    found = [(row.frames, row.lost, row.bad, row.quality, len(row.timing)) for row in run.outcome.rows]
    assert found == [(50, 0, 0, 0, 12)] * 10
    windows = [row.window for row in run.outcome.rows]
    assert all(after.first_counter == before.first_counter + before.frames for before, after in pairwise(windows))
    check_replay(run)
