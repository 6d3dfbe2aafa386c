"""The same run under the wall clock: threads instead of tasks, and still what a replay finds."""

from __future__ import annotations

from pathlib import Path

import pytest
from rehearsal import Watched

from bench.model.clock import WallClock
from bench.plan import check_plan, compile_sequence
from bench.replay import replay_rows
from bench.run.control.operator import SimulatedOperator
from bench.run.session import conduct

pytestmark = pytest.mark.waits

SEQUENCE = """\
sequence: wall
station: af_bench_sim
frame: {port_a: ngu_a, port_b: ngu_b}
unit_commands:
  start_stream: {code: 2, payload: "64"}
timeline:
  - {at: 0 s, call: {supply.configure: {voltage: 18 V, current_limit: 2 A, over_voltage: 21 V}}}
  - {at: 1 s, call: supply.output_on}
  - {at: 3 s, unit: {port_b: start_stream}}
  - {at: 4 s, record: 1 s}
  - {at: 5.2 s, record: 1 s}
  - {at: 6.4 s, record: 1 s}
  - {at: 7.6 s, record: 1 s}
"""


@pytest.mark.slow
def test_a_run_under_the_wall_clock_replays_row_by_row(tmp_path: Path) -> None:
    path = tmp_path / "wall.yaml"
    path.write_text(SEQUENCE)
    plan = compile_sequence(path, None, {})
    assert check_plan(plan) == []
    watched = Watched(lambda world, step: None, worlds=[None])  # type: ignore[list-item]
    run = conduct(plan, clock=WallClock(), seed=1, out=tmp_path / "out", operator=SimulatedOperator(), listener=watched)
    assert run.outcome.error is None
    assert run.outcome.unsafe == ()
    again = replay_rows(run.folder, strict=True)
    assert len(again.measurement_rows) == len(run.outcome.rows) == 4
    print(f"timed waits ended {run.outcome.lateness_ms} ms late (median, 99 %, worst)")
    for first, second in zip(run.outcome.rows, again.measurement_rows, strict=True):
        assert (first.frames, first.lost, first.bad, first.quality) == (100, 0, 0, 0)
        assert first.window == second.window
        assert {name: value.tolist() for name, value in first.sums.items()} == {
            name: value.tolist() for name, value in second.sums.items()
        }
        assert dict(first.context) == dict(second.context)
    assert again.totals == dict(run.counts)
    assert again.session_sha256 == run.session_sha256
