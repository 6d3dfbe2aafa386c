"""What a recording of two units may lack, and what each lack says."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from sync_physics import STRAIGHT, Recording, part

from bench.analysis import Material, analyse
from bench.model.errors import BenchError
from bench.systems.time_sync.declaration import DECLARATION
from bench.systems.time_sync.estimators.kalman.setup import EgiSpread
from bench.systems.time_sync.estimators.sar.image import point_targets
from bench.systems.time_sync.estimators.sar.pulses import Pulses
from bench.systems.time_sync.limits import SPECIFIED_s, demands_of, densities_of, latency_of, spread_of

STATED = {
    "accel_bias_g": 2e-4, "velocity_walk_g_rtHz": 2e-5, "gyro_bias_deg_s": 1 / 3600, "angle_walk_deg_rth": 0.07,
}  # fmt: skip
EGI = {"velocity_m_s": 0.05, "level_deg": 0.01, "heading_deg": 0.1, "wander_s": 9.0, "heading_wander_s": 8.0}


@cache
def recorded(duration_s: float) -> Material:
    """Straight flight in two records."""
    return Recording(1, path=STRAIGHT, long_s=duration_s, imu_s=0.005, egi_s=0.02, records=2).material()


def material(edit: Any = None, duration_s: float = 17.0) -> Material:
    """A recording whose rows are edited."""
    found = recorded(duration_s)
    return found if edit is None else replace(found, rows=[edit(row) for row in found.rows])


def without_angles(row: Any) -> Any:
    columns = {name: column for name, column in row.samples.columns.items() if name != "delta_angle"}
    return replace(row, samples=replace(row.samples, columns=columns))


def early(row: Any) -> Any:
    """The EGI is there for the first 4.5 s only."""
    egi = row.beside["egi"]
    keep = egi.t_ns < egi.t_ns[0] + 4_500_000_000 if row.window.number == 1 else np.zeros(len(egi), bool)
    return replace(row, beside={"egi": part(egi, keep)})


def clock_set(link: str) -> Any:
    """The clock of a unit is set in the middle of the second record."""

    def edit(row: Any) -> Any:
        samples = row.samples if link == "imu" else row.beside["egi"]
        tick = samples.columns["tick"].copy()
        tick[len(tick) // 2 :] -= np.uint64(30_000_000 if row.window.number == 2 else 0)
        moved = replace(samples, columns={**samples.columns, "tick": tick})
        return replace(row, samples=moved) if link == "imu" else replace(row, beside={"egi": moved})

    return edit


def holes(*at: int, width: int = 60) -> Any:
    """What takes samples of the inertial unit out of a row, by counter from 70 000 on."""

    def edit(row: Any) -> Any:
        since = row.samples.counter[:, None] - 70_000 - np.array(at)
        return replace(row, samples=part(row.samples, ~((since >= 0) & (since < width)).any(axis=1)))

    return edit


def begun_anew(row: Any) -> Any:
    """The EGI is somewhere else at once in the middle; no interval covers what a filter makes of it."""
    egi = row.beside["egi"]
    north = egi.columns["latitude"] - 0.02 * (np.arange(len(egi)) + (row.window.number == 2) * 1e4 > 300)
    return replace(row, beside={"egi": replace(egi, columns={**egi.columns, "latitude": north})})


def not_navigating(row: Any) -> Any:
    egi = row.beside["egi"]
    return replace(row, beside={"egi": replace(egi, columns={**egi.columns, "mode": 0 * egi.columns["mode"]})})


@pytest.mark.parametrize(
    ("edit", "duration_s", "said"),
    [
        (lambda row: replace(row, samples=None), 17.0, "B-SYNC-001"),
        (lambda row: replace(row, beside={}), 17.0, "B-SYNC-002.*'egi'"),
        (without_angles, 17.0, "B-SYNC-002.*delta_angle"),
        (None, 9.0, "B-SYNC-003.*9.0 s"),
        (early, 17.0, "B-SYNC-003"),
        (clock_set("imu"), 17.0, "B-SYNC-004.*'imu'.*12[.]"),  # seconds behind the first frame
        (clock_set("egi"), 17.0, "B-SYNC-004.*'egi'.*12[.]"),
        (holes(900, 1800, 2700, 3300), 20.0, "B-SYNC-007.*60 samples of the inertial unit are missing 4.495 s after"),
        (holes(1800), 17.0, "B-SYNC-007.*are missing 8.995 s after the first"),  # not named as too short: it was not
        (begun_anew, 17.0, "B-SYNC-011.*do not fit one motion"),
        (not_navigating, 17.0, r"B-SYNC-008.*0 of 840 solutions"),
    ],
)
def test_what_a_recording_lacks_is_named_with_what_to_do(edit: Any, duration_s: float, said: str) -> None:
    with pytest.raises(BenchError, match=said) as caught:
        analyse(material(edit, duration_s))
    assert caught.value.next_step


def test_a_gap_near_the_end_is_cut_and_told() -> None:
    found = analyse(material(holes(3200)))
    assert any("only the longest piece of 16.0 s of 17.0 s is analysed" in note for note in found.notes)


@pytest.mark.parametrize(
    ("sections", "code"),
    [
        *(
            ({"limits": {name: limit}}, "B-SYNC-005")
            for name, limit in (
                ("azimuth_error", {"value": 1.0, "unit": "deg"}),
                ("stamps_difference", {"value": 1.0, "unit": "m"}),
                ("time_offset_uncertainty", {"value": 0.0, "unit": "s"}),
                ("time_offset_uncertainty", {"value": 1.0}),
            )
        ),
        ({"latency": {"egi_s": 0.008}}, "B-SYNC-006"),
        ({"latency": {"egi_s": -0.008, "imu_s": 0.0, "std_s": 1e-3}}, "B-SYNC-006"),
        ({"inertial": {"accel_bias_g": 2e-4}}, "B-SYNC-006"),
        ({"inertial": STATED | {"gyro_bias_deg_s": 0.0}}, "B-SYNC-006"),
        ({"egi": {"velocity_m_s": 0.017}}, "B-SYNC-006"),
        ({"egi": EGI | {"level_deg": 0.0}}, "B-SYNC-006"),
    ],
)
def test_what_a_sequence_may_not_state(sections: dict[str, Any], code: str) -> None:
    with pytest.raises(BenchError, match=code):
        analyse(replace(material(), campaign={**material().campaign, **sections}))


def test_no_rows_an_unknown_method_and_pulses_without_a_target() -> None:
    with pytest.raises(BenchError, match="B-SYNC-001"):
        analyse(replace(material(), rows=[]))
    with pytest.raises(BenchError, match="B-FIT-004"):
        analyse(material(), "kalman")
    rng = np.random.default_rng(1)
    gates = (rng.standard_normal((3000, 64)) + 1j * rng.standard_normal((3000, 64))).astype(np.complex64)
    positions_m = np.stack([np.arange(3000) * 0.25, np.zeros(3000), np.full(3000, -3000.0)], axis=1)
    with pytest.raises(BenchError, match=r"B-SYNC-010.*no point target"):
        point_targets(Pulses(gates, 44_920.0, 2.5, 0.03123), positions_m)


def test_limits_are_those_of_the_plan() -> None:
    declared = DECLARATION.analysis("time_sync")
    assert {name: limit.dimension for name, limit in declared.limits.items()} == dict.fromkeys(SPECIFIED_s, "s")
    found = demands_of({"limits": {"time_offset_uncertainty": {"value": 3.0, "unit": "ms"}}})
    assert (found.uncertainty_s, found.difference_s) == (3e-3, 5e-3)


def test_what_the_sequence_states_of_the_units() -> None:
    found = densities_of({"inertial": STATED})
    assert found.accel_bias_ug == pytest.approx(200.0)
    assert found.gyro_bias_deg_h == pytest.approx(1.0)
    assert densities_of({}) == densities_of({"inertial": None})
    assert latency_of({}) is None
    assert spread_of({"egi": EGI}, 2.0) == EgiSpread(2.0, 0.05, 0.01, 0.1, 9.0, 8.0)
    assert spread_of({}, 2.0) == EgiSpread(position_m=2.0)
    assert spread_of({}, 0.0) == EgiSpread(), "an EGI that does not know how good its position is"
