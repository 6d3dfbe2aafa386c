"""A real run on the simulated bench with a noisy cable: its replay gives every row bit for bit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from rehearsal import tiny_plan

from bench.model.clock import VirtualClock
from bench.record import RecordRow
from bench.replay import replay_rows
from bench.run.control.operator import SimulatedOperator
from bench.run.session import conduct
from sim_instruments.faults.switchboard import LinkFaults

SEED = 3
BIT_ERROR_RATE = 2e-6
FRAME_RATE = 2e-4  # of dropped and of repeated frames


class Silence:
    """Watches a run and says nothing."""

    def __getattr__(self, name: str) -> Any:
        return lambda *_: None


def comparable(row: RecordRow) -> tuple[object, ...]:
    sums = {name: value.tolist() for name, value in row.sums.items()}
    counts = (row.frames, row.lost, row.bad, row.duplicate, row.suspect)
    return row.window, sums, counts, row.quality, dict(row.context)


def test_replay_of_a_run_over_a_noisy_cable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = LinkFaults.__init__

    def noisy(self: LinkFaults, *args: Any, **options: Any) -> None:
        plain(self, *args, **options)
        self.bit_error_rate, self.drop_rate, self.duplicate_rate = BIT_ERROR_RATE, FRAME_RATE, FRAME_RATE

    monkeypatch.setattr(LinkFaults, "__init__", noisy)
    plan = tiny_plan(tmp_path)
    run = conduct(
        plan, clock=VirtualClock(), seed=SEED, out=tmp_path, operator=SimulatedOperator(), listener=Silence(),
        keep_events=("retake",),
    )  # fmt: skip
    assert run.outcome.error is None
    again = replay_rows(run.folder, strict=True)
    assert run.counts["frames_bad"] > 0, f"seed {SEED}"
    assert len(run.events) > 0, f"seed {SEED}: no record was retaken"
    assert any(row.duplicate for row in run.outcome.rows)
    assert [comparable(row) for row in again.measurement_rows] == [comparable(row) for row in run.outcome.rows]
    assert again.totals == dict(run.counts)
    assert again.session_sha256 == run.session_sha256
