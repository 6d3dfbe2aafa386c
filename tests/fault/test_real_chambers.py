"""Row 14 on a real air bath: 38 hours of ramps and holds that somebody else recorded, as the unit's temperature."""

import csv
import os
from collections.abc import Callable
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from run_rig import ROOT, Rig

from bench.model.clock import NS, to_ns
from bench.run.steps.soak import Stability

FOLDER = Path(os.environ.get("BENCH_REAL_DATA", ROOT.parent / "shared" / "data")) / "tckit"
FILES = sorted(FOLDER.glob("*tcsweep_1vdc*.dsv"))
pytestmark = [pytest.mark.waits, pytest.mark.real, pytest.mark.skipif(not FILES, reason=f"no recording in {FOLDER}")]

HOUR_S = 3600.0
SLOT_S, LIMIT_S = 1500.0, 900.0


@pytest.fixture(scope="module")
def bath() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Seconds since the first row, sensor at the device in degC."""
    with FILES[0].open(newline="") as stream:
        rows = [(row["date"], float(row["val6"])) for row in csv.DictReader(stream, delimiter=";")]
    times = [datetime.strptime(date, "%d/%m/%Y-%H:%M:%S") for date, _ in rows]
    return np.array([(one - times[0]).total_seconds() for one in times]), np.array([value for _, value in rows])


def from_hour(bath: tuple[NDArray[np.float64], NDArray[np.float64]], hour: float) -> Callable[[float], float]:
    return lambda t_s: float(np.interp(hour * HOUR_S + t_s, *bath))


@pytest.mark.parametrize(("hour", "target_degC"), [(6.0, 30.0), (30.0, 23.0)])
def test_what_does_not_settle_is_given_up_at_the_set_time(
    tmp_path: Path, bath: tuple[NDArray[np.float64], NDArray[np.float64]], hour: float, target_degC: float
) -> None:
    """On the real ramps, which pass through their target as well as far from it."""
    rig = Rig(tmp_path, "chamber")
    rig.step(
        "soak", "chamber", "soak", temperature=target_degC, ramp=0.5, slot=SLOT_S, within=0.2, **{"for": 900.0},
        sensor="unit", late="hold", hold_limit=LIMIT_S,
    )  # fmt: skip
    rig.unit_degC = from_hour(bath, hour)
    error = rig.run().error
    assert error.code == "B-RUN-031"
    ended = next(t_ns for kind, t_ns, _ in rig.sink.events if kind == "error")
    assert ended / NS == pytest.approx(SLOT_S + LIMIT_S, abs=1.0)
    assert f"in {SLOT_S + LIMIT_S:.0f} s" in error.message


def test_no_moment_of_the_recording_is_settled_that_was_not(
    bath: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> None:
    """Every row is heard; judged at every minute of 38 hours, for several bands, against all rows before and after."""
    t_s, sensor_degC = bath
    found = {}
    for target_degC, within_degC, for_s in ((34.88, 0.1, 900.0), (23.0, 0.3, 600.0), (21.75, 0.1, 1800.0)):
        watch, said, false, left, heard = Stability(target_degC, within_degC, for_s), 0, 0, 0, 0
        off = np.abs(sensor_degC - target_degC)
        for moment_s in np.arange(0.0, t_s[-1] - for_s, 60.0):
            now = int(np.searchsorted(t_s, moment_s, side="right"))
            watch.add(np.round(t_s[heard:now] * NS).astype(np.int64), sensor_degC[heard:now])
            heard = now
            if watch.judged(to_ns(float(moment_s)))[0]:
                said += 1
                false += bool((off[(t_s >= moment_s - for_s) & (t_s <= moment_s)] > within_degC).any())
                left += bool((off[(t_s > moment_s) & (t_s <= moment_s + 300.0)] > within_degC).any())
        found[target_degC] = (said, false, left)
    print(f"moments called settled, wrongly so, and left within 5 min: {found}")
    assert all(said > 0 for said, _, _ in (found[34.88], found[21.75]))
    assert [false for _, false, _ in found.values()] == [0, 0, 0]
    assert sum(left for _, _, left in found.values()) <= 0.05 * sum(said for said, _, _ in found.values())
