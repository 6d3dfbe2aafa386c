"""Row 30: benches whose network is lost, in every way and at every moment; what the worlds do then, not what is said.

Twenty losses of some seconds here, three in each run, several benches side by side; ``make losses`` has 200 of up to
five minutes and for good, one in each run.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from loss_drill import drill_all, drilled, summary, told
from loss_schedule import SHORT

pytestmark = pytest.mark.waits

LOSSES, IN_A_RUN = 20, 3
BENCHES = 7  # side by side: each costs a tenth of a core


@pytest.mark.slow
def test_twenty_losses(tmp_path: Path) -> None:
    jobs = [(range(seed, min(seed + IN_A_RUN, LOSSES)), SHORT) for seed in range(0, LOSSES, IN_A_RUN)]
    rows = [row for done in drill_all(jobs, BENCHES, tmp_path) for row in done]
    print("\n".join(map(told, rows)))
    print(summary(rows))
    assert len(rows) == LOSSES
    assert [told(row) for row in rows if row.violations] == []


@pytest.mark.slow
def test_a_run_that_loses_nothing_is_right(tmp_path: Path) -> None:
    (row,) = drilled(tmp_path / "bare", [0], SHORT, bare=True)
    assert (row.exit, row.replay, row.violations) == ("0", "identical", "")
