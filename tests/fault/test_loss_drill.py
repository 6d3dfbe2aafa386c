"""Row 30: benches whose network is lost, in every way and at every moment; what the worlds do then, not what is said.

Nine losses of some seconds here, of each kind, three in each run, several benches side by side, and twenty in the
sweep; ``make losses`` has 200 of up to five minutes and for good, one in each run.
"""

import math
import os
from collections.abc import Iterable, Sequence
from pathlib import Path

import loss_drill
import pytest
from block_rows import read_rows
from loss_drill import MISSED, Job, Row, drill_all, drilled, summary, told
from loss_schedule import SHORT

pytestmark = pytest.mark.waits

DRIVEN = ((15, 33, 53), (47, 11, 17), (98, 10, 43))  # seeds of three runs: each kind, and all while a current flows
TWENTY = tuple(range(seed, min(seed + 3, 20)) for seed in range(0, 20, 3))
STARVED_S = 1.0
BENCHES = 7  # side by side: each costs a tenth of a core


@pytest.mark.slow
@pytest.mark.parametrize("runs", [DRIVEN, pytest.param(TWENTY, marks=pytest.mark.sweep)], ids=["few", "twenty"])
def test_losses(tmp_path: Path, runs: Sequence[Sequence[int]]) -> None:
    rows = [row for done in drill_all([(seeds, SHORT) for seeds in runs], BENCHES, tmp_path) for row in done]
    print("\n".join(map(told, rows)))
    print(summary(rows))
    assert len(rows) == sum(map(len, runs))
    missed = sum(row.exit == MISSED for row in rows)  # a run that survives one goes on meanwhile
    assert missed <= 0.15 * len(rows)
    starved = [row for row in rows if row.gap_s > STARVED_S]  # no processor: deadlines say nothing, kills are right
    print(f"{len(starved)} on a machine without time")
    assert len(starved) <= len(rows) // 2 or os.getloadavg()[0] > 2 * (os.cpu_count() or 1)
    assert [told(row) for row in rows if row.violations and row not in starved] == []


@pytest.mark.sweep
def test_a_run_that_loses_nothing_is_right(tmp_path: Path) -> None:
    (row,) = drilled(tmp_path / "bare", [0], SHORT, bare=True)
    assert row.violations == ""
    assert row.exit in ("0", "1")  # a machine without time leaves records that are flagged


def test_the_whole_drill_goes_on_where_its_rows_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def drilled_by_hand(jobs: Sequence[Job], benches: int, out: Path) -> Iterable[list[Row]]:
        for seeds, scale in jobs:
            asked.extend(seeds)
            if seeds == [3] and asked.count(3) == 1:
                raise KeyboardInterrupt
            place = (seeds[0], scale.name, "calibrator", "mute", "settle", 5, math.inf)
            yield [Row(*place, 2.8, math.nan, "0", "dismissed", "", "identical", "late" if seeds == [4] else "")]

    monkeypatch.setattr(loss_drill, "drill_all", drilled_by_hand)
    monkeypatch.setattr(loss_drill, "ROWS", tmp_path / "losses.csv")
    assert loss_drill.main(["--count", "6"]) == loss_drill.STOPPED
    assert loss_drill.main(["--count", "6"]) == 1
    assert asked == [0, 1, 2, 3, 3, 4, 5]
    rows = read_rows(Row, tmp_path / "losses.csv")
    assert [(row.seed, row.scale, row.violations) for row in rows][3:] == [
        (3, "scaled", ""), (4, "scaled", "late"), (5, "full", ""),
    ]  # fmt: skip
    assert all(math.isinf(row.length_s) and math.isnan(row.off_after_s) for row in rows)
    assert "| mute | 6 | 2.8 s, 2.8 s | - | 6 | 0 | 1 |" in summary(rows)
