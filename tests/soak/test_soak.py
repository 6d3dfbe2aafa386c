"""Seeded campaigns with mixed faults: the bench is safe at the end, the record valid, every result true or flagged.

A failing seed is named; ``soak_one(plan, seed, folder)`` does exactly the same again.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from soak_campaign import MEAN_INTERVAL_S, soak_one, soak_plan, watchers

from bench.analysis import Table
from bench.run import sequencer

SEEDS = 10_000
BLOCK = 250
SHORT = 15
SHORT_INTERVAL_S = 50.0  # between faults: so short that as many faults are drawn as in 24 campaigns of the sweep


@pytest.fixture(autouse=True)
def _no_trials() -> Iterator[None]:
    """The Monte Carlo table of the report takes as long as the whole campaign; nothing is judged by it."""
    empty = Table("Monte Carlo check", "", [], [])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bench.systems.af_converter.scale_factor.budgets.check_table", lambda *_: empty)
        yield


def violations(folder: Path, seeds: range, mean_interval_s: float = MEAN_INTERVAL_S) -> dict[int, list[str]]:
    plan, ended, found, estimates = soak_plan(folder), Counter[str](), {}, 0
    for seed in seeds:
        soaked = soak_one(plan, seed, folder / str(seed), watchers(plan), mean_interval_s)
        ended[soaked.ended] += 1
        estimates += soaked.estimates
        if soaked.violations:
            found[seed] = soaked.violations
    print(f"seeds {seeds.start} to {seeds.stop - 1}: {dict(ended)}, {estimates} estimates held against the truth")
    return found


@pytest.mark.slow
def test_mixed_faults_short(tmp_path: Path) -> None:
    assert violations(tmp_path, range(SHORT), SHORT_INTERVAL_S) == {}


@pytest.mark.sweep
@pytest.mark.parametrize("first", range(0, SEEDS, BLOCK))
def test_mixed_faults(first: int, tmp_path: Path) -> None:
    assert violations(tmp_path, range(first, first + BLOCK)) == {}


def test_a_seed_is_reproduced(tmp_path: Path) -> None:
    plan = soak_plan(tmp_path)
    first, second = (soak_one(plan, 3, tmp_path / name, watchers(plan)) for name in ("a", "b"))
    assert first == second
    assert first.faults
    segments = [sorted((tmp_path / name).rglob("*.mcap")) for name in ("a", "b")]
    assert [path.read_bytes() for path in segments[0]] == [path.read_bytes() for path in segments[1]]


def test_a_bench_that_is_left_on_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sequencer, "make_safe", lambda *_: [])
    soaked = soak_one(soak_plan(tmp_path), 0, tmp_path, (), mean_interval_s=1e9)
    assert any("unsafe: supply" in text for text in soaked.violations)
    assert soaked.ended == "done"


def test_a_wrong_number_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = soak_plan(tmp_path)
    for channel in plan.campaign["channels"]:
        channel["k0_C"] *= 1.001
    soaked = soak_one(plan, 0, tmp_path, (), mean_interval_s=1e9)
    assert any("sigma off" in text for text in soaked.violations)
