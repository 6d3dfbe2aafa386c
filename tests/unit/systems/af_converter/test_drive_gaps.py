"""A gap in the temperatures is bridged where the chamber went straight on, and refused where it turned unseen."""

from __future__ import annotations

import numpy as np
import pytest

from bench.model.errors import FitError
from bench.systems.af_converter.estimators.drive_gaps import hidden_degC, require_known
from bench.systems.af_converter.estimators.thermal_lag import Drive

CORNERS_s = (0.0, 7200.0, 43_200.0, 46_800.0, 82_800.0, 90_000.0)
CORNERS_degC = (-10.0, -10.0, 50.0, 50.0, -10.0, -10.0)


def ramp(gap_s: tuple[float, float], noise_degC: float = 0.02) -> Drive:
    """The 25-hour ramp read once a minute, without the readings inside the gap."""
    t_s = np.arange(0.0, 90_000.0, 60.0)
    degC = np.interp(t_s, CORNERS_s, CORNERS_degC) + np.random.default_rng(4).normal(0, noise_degC, t_s.size)
    kept = (t_s <= gap_s[0]) | (t_s >= gap_s[1])
    return Drive(t_s[kept], degC[kept])


@pytest.mark.parametrize("gap_s", [(0.0, 0.0), (20_000.0, 23_600.0), (60_000.0, 60_200.0), (84_000.0, 87_600.0)])
def test_a_gap_on_a_straight_stretch_is_bridged(gap_s: tuple[float, float]) -> None:
    drive = ramp(gap_s)
    assert require_known(drive, 0.0) is drive


@pytest.mark.parametrize(
    ("gap_s", "name"), [((5400.0, 9000.0), "hold to ramp"), ((42_000.0, 48_000.0), "up, hold and down")]
)
def test_a_gap_that_hides_a_turn_is_refused(gap_s: tuple[float, float], name: str) -> None:
    with pytest.raises(FitError, match=rf"B-FIT-024.*from {gap_s[0]:.0f} s to {gap_s[1]:.0f} s") as refusal:
        require_known(ramp(gap_s), 0.0)
    assert "joint_unit_sensor" in refusal.value.next_step, name


def test_a_gap_long_before_what_is_fitted_does_not_count() -> None:
    require_known(ramp((5400.0, 9000.0)), 20_000.0)
    with pytest.raises(FitError, match="B-FIT-024"):
        require_known(ramp((5400.0, 9000.0)), 9100.0)


def test_the_distance_of_one_corner_from_the_chord() -> None:
    """Corner of 0.1 degC/min 1,800 s into a gap of 3,600 s: 3 degC / 2 by hand."""
    drive = ramp((5400.0, 9000.0), noise_degC=0.0)
    k = int(np.argmax(np.diff(drive.t_s)))
    assert hidden_degC(drive, k) == pytest.approx(1.5, rel=0.02)
