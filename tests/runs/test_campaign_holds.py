"""Campaigns of the shipped form that are held up at random instants: results still true, and a replay that agrees."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rehearsal import SEED, SOAK_s, tiny_plan

from bench.commands.run import view_of
from bench.model.clock import VirtualClock
from bench.plan import Plan, compile_sequence
from bench.replay import replay_rows
from bench.run.besides import besides
from bench.run.context import RunContext
from bench.run.control.operator import SimulatedOperator
from bench.run.session import Conducted, conduct
from bench.run.stop import Wish
from bench.session.view import KEPT_EVENTS, analyse_view

ROOT = Path(__file__).resolve().parents[2]
COVERAGE = 5.0  # standard deviations of a difference


def disturbed(plan: Plan, out: Path, moments: list[tuple[float, float, str]]) -> Conducted:
    """Run with holds, retakes and skips: (seconds from the start, seconds of the hold, kind)."""

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

    return conduct(
        plan, clock=VirtualClock(), seed=SEED, out=out, operator=SimulatedOperator(),
        listener=Silence(),
        keep_events=KEPT_EVENTS, beside=[*besides(plan, {}, virtual=True), somebody],
    )  # fmt: skip


class Silence:
    """Watches a run and says nothing."""

    def __getattr__(self, name: str) -> Any:
        return lambda *_: None


def comparable(row: Any) -> tuple[object, ...]:
    sums = {name: value.tolist() for name, value in row.sums.items()}
    return row.window, sums, (row.frames, row.lost, row.bad), row.quality, dict(row.context)


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


def check_replay(run: Conducted) -> None:
    again = replay_rows(run.folder, strict=True)
    assert [comparable(row) for row in again.measurement_rows] == [comparable(row) for row in run.outcome.rows]


def random_moments(seed: int, length_s: float, count: int, kinds: list[str]) -> list[tuple[float, float, str]]:
    rng = np.random.default_rng(seed)
    return [
        (float(rng.uniform(10.0, length_s)), float(rng.uniform(0.0, 90.0)), str(rng.choice(kinds)))
        for _ in range(count)
    ]


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.sweep) for seed in range(2, 12))])
def test_a_scale_factor_campaign_with_holds(tmp_path: Path, seed: int) -> None:
    plan = tiny_plan(tmp_path)
    campaign_s = plan.prepare_s + SOAK_s
    moments = random_moments(seed, 450.0, 6, ["hold", "retake"])
    moments = [(campaign_s + at_s, length_s, kind) for at_s, length_s, kind in moments]
    print(f"seed {seed}: {moments}")
    run = disturbed(plan, tmp_path / "held", moments)
    assert run.outcome.error is None
    first = run.outcome.rows[0].window.number
    assert [row.window.number - first for row in run.outcome.rows] == list(range(15))
    wanted = [dict(step.conditions) for step in plan.steps if step.kind == "record" and step.phase == "campaign"]
    for row, conditions in zip(run.outcome.rows, wanted, strict=True):
        assert {name: row.window.conditions[name] for name in conditions} == conditions
        assert row.lost == 0
    kinds = [kind for kind, _, _ in run.events]
    assert kinds.count("hold") == kinds.count("release") >= 1
    check_replay(run)
    check_true(plan, run)


def test_nothing_trips_in_an_undisturbed_campaign_and_a_skipped_point_is_missing_from_the_replay_too(
    tmp_path: Path,
) -> None:
    plan = tiny_plan(tmp_path)
    run = disturbed(plan, tmp_path, [(plan.prepare_s + SOAK_s + 100.0, 0.0, "skip")])
    assert run.outcome.error is None
    assert [event for event in run.events if event[0] in ("interlock", "alarm", "hold")] == []
    assert len(run.outcome.rows) == 14
    check_replay(run)
    assert [kind for kind, _, _ in run.events].count("skip") == 1


@pytest.mark.sweep
@pytest.mark.parametrize("seed", range(4))
def test_a_bias_ramp_with_holds(tmp_path: Path, seed: int) -> None:
    """Its records follow each other through a ramp: a hold begins the record under way anew."""
    plan = compile_sequence(ROOT / "sequences" / "bias_ramp_short.yaml", None, {})
    moments = random_moments(seed, plan.prepare_s + plan.duration_s, 4, ["hold"])
    print(f"seed {seed}: {moments}")
    run = disturbed(plan, tmp_path / "held", moments)
    assert run.outcome.error is None
    check_replay(run)
    check_true(plan, run)
