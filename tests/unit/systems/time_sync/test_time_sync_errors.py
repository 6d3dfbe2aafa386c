"""What a recording of two units may lack, and what each lack says."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from time_sync_material import Pair, campaign

from bench.analysis import Material, analyse
from bench.model.errors import BenchError
from bench.systems.time_sync.declaration import DECLARATION
from bench.systems.time_sync.estimators.kalman.setup import EgiSpread
from bench.systems.time_sync.estimators.sar.image import point_targets
from bench.systems.time_sync.estimators.sar.pulses import Pulses
from bench.systems.time_sync.limits import SPECIFIED_s, demands_of, densities_of, latency_of, spread_of


def refused(material: Material, code: str, method: str | None = None) -> str:
    """Message of the error that must come."""
    with pytest.raises(BenchError) as caught:
        analyse(material, method)
    assert caught.value.code == code
    assert caught.value.next_step
    return str(caught.value)


@cache
def recorded(duration_s: float) -> Material:
    """Straight flight in two records."""
    return Pair("linear", duration_s=duration_s, records=2).material()


def material(edit: Any = None, duration_s: float = 17.0) -> Material:
    """A recording whose rows are edited."""
    found = recorded(duration_s)
    return found if edit is None else replace(found, rows=[edit(row) for row in found.rows])


def test_unknown_method() -> None:
    refused(material(), "B-FIT-004", "kalman")


def test_no_record() -> None:
    refused(replace(material(), rows=[]), "B-SYNC-001")
    refused(material(lambda row: replace(row, samples=None)), "B-SYNC-001")


def test_no_egi_beside_the_records() -> None:
    assert "'egi'" in refused(material(lambda row: replace(row, beside={})), "B-SYNC-002")


def test_frames_of_another_kind() -> None:
    def without(row: Any) -> Any:
        columns = {name: column for name, column in row.samples.columns.items() if name != "delta_angle"}
        return replace(row, samples=replace(row.samples, columns=columns))

    assert "delta_angle" in refused(material(without), "B-SYNC-002")


def test_too_short() -> None:
    assert "9.0 s" in refused(material(duration_s=9.0), "B-SYNC-003")


def test_egi_covers_too_little() -> None:
    def early(row: Any) -> Any:
        egi = row.beside["egi"]
        keep = egi.t_ns < egi.t_ns[0] + 4_500_000_000 if row.window.number == 1 else np.zeros(len(egi), bool)
        part = replace(
            egi, columns={k: v[keep] for k, v in egi.columns.items()}, counter=egi.counter[keep], t_ns=egi.t_ns[keep]
        )
        return replace(row, beside={"egi": part})

    refused(material(early), "B-SYNC-003")


@pytest.mark.parametrize("link", ["imu", "egi"])
def test_clock_set_while_it_was_recorded(link: str) -> None:
    def jump(row: Any) -> Any:
        samples = row.samples if link == "imu" else row.beside["egi"]
        tick = samples.columns["tick"].copy()
        tick[len(tick) // 2 :] -= np.uint64(30_000_000 if row.window.number == 2 else 0)
        moved = replace(samples, columns={**samples.columns, "tick": tick})
        return replace(row, samples=moved) if link == "imu" else replace(row, beside={"egi": moved})

    message = refused(material(jump), "B-SYNC-004")
    assert repr(link) in message
    assert "12." in message  # seconds behind the first frame


@pytest.mark.parametrize(
    "limits",
    [
        {"azimuth_error": {"value": 1.0, "unit": "deg"}},
        {"stamps_difference": {"value": 1.0, "unit": "m"}},
        {"time_offset_uncertainty": {"value": 0.0, "unit": "s"}},
        {"time_offset_uncertainty": {"value": 1.0}},
    ],
)
def test_limits(limits: dict[str, Any]) -> None:
    refused(replace(material(), campaign=campaign(limits=limits)), "B-SYNC-005")


def test_limits_are_those_of_the_plan() -> None:
    declared = DECLARATION.analysis("time_sync")
    assert {name: limit.dimension for name, limit in declared.limits.items()} == dict.fromkeys(SPECIFIED_s, "s")
    found = demands_of({"limits": {"time_offset_uncertainty": {"value": 3.0, "unit": "ms"}}})
    assert (found.uncertainty_s, found.difference_s) == (3e-3, 5e-3)


@pytest.mark.parametrize(
    "sections",
    [
        {"latency": {"egi_s": 0.008}},
        {"latency": {"egi_s": -0.008, "imu_s": 0.0, "std_s": 1e-3}},
        {"inertial": {"accel_bias_g": 2e-4}},
        {"egi": {"velocity_m_s": 0.017}},
        {"egi": {"velocity_m_s": 0.017, "level_deg": 0.0, "heading_deg": 0.01, "wander_s": 20.0,
                 "heading_wander_s": 9.0}},
        {"inertial": {"accel_bias_g": 2e-4, "velocity_walk_g_rtHz": 2e-5, "gyro_bias_deg_s": 0.0,
                      "angle_walk_deg_rth": 0.07}},
    ],
)  # fmt: skip
def test_unit_under_test(sections: dict[str, Any]) -> None:
    refused(replace(material(), campaign=campaign(**sections)), "B-SYNC-006")


def test_what_the_sequence_states_of_the_units() -> None:
    stated = {
        "accel_bias_g": 2e-4,
        "velocity_walk_g_rtHz": 2e-5,
        "gyro_bias_deg_s": 1 / 3600,
        "angle_walk_deg_rth": 0.07,
    }
    found = densities_of({"inertial": stated})
    assert found.accel_bias_ug == pytest.approx(200.0)
    assert found.gyro_bias_deg_h == pytest.approx(1.0)
    assert densities_of({}) == densities_of({"inertial": None})
    assert latency_of({}) is None
    egi = {"velocity_m_s": 0.05, "level_deg": 0.01, "heading_deg": 0.1, "wander_s": 9.0, "heading_wander_s": 8.0}
    assert spread_of({"egi": egi}, 2.0) == EgiSpread(2.0, 0.05, 0.01, 0.1, 9.0, 8.0)
    assert spread_of({}, 2.0) == EgiSpread(position_m=2.0)
    assert spread_of({}, 0.0) == EgiSpread(), "an EGI that does not know how good its position is"


def holes(*at: int, width: int = 60) -> Any:
    """What takes samples of the inertial unit out of a row, by counter from 70 000 on."""

    def edit(row: Any) -> Any:
        samples = row.samples
        keep = np.ones(len(samples), bool)
        for one in at:
            keep &= ~((samples.counter >= 70_000 + one) & (samples.counter < 70_000 + one + width))
        columns = {name: column[keep] for name, column in samples.columns.items()}
        part = replace(samples, columns=columns, counter=samples.counter[keep], t_ns=samples.t_ns[keep])
        return replace(row, samples=part)

    return edit


def test_gaps_leave_no_piece() -> None:
    message = refused(material(holes(900, 1800, 2700, 3300), duration_s=20.0), "B-SYNC-007")
    assert "60 samples of the inertial unit are missing 4.495 s after the first" in message


def test_a_gap_that_leaves_too_short_a_piece_is_named() -> None:
    """Not as a recording that is too short: it was not."""
    assert "are missing 8.995 s after the first" in refused(material(holes(1800)), "B-SYNC-007")


def test_two_flights_in_one_recording() -> None:
    """Begun anew in the middle: the EGI is somewhere else at once; no interval covers what a filter makes of it."""

    def begun_anew(row: Any) -> Any:
        egi = row.beside["egi"]
        north = egi.columns["latitude"] - 0.02 * (np.arange(len(egi)) + (row.window.number == 2) * 1e4 > 300)
        return replace(row, beside={"egi": replace(egi, columns={**egi.columns, "latitude": north})})

    message = refused(material(begun_anew), "B-SYNC-011")
    assert "do not fit one motion" in message


def test_a_gap_near_the_end_is_cut_and_told() -> None:
    found = analyse(material(holes(3200)))
    assert any("only the longest piece of 16.0 s of 17.0 s is analysed" in note for note in found.notes)


def test_egi_does_not_navigate() -> None:
    pair = Pair("linear", duration_s=17.0, egi_edit={"mode": np.zeros(round(16.8 * 50), np.uint16)})
    assert "0 of 840 solutions" in refused(pair.material(), "B-SYNC-008")


def test_no_target_in_the_radar_pulses() -> None:
    rng = np.random.default_rng(1)
    gates = (rng.standard_normal((3000, 64)) + 1j * rng.standard_normal((3000, 64))).astype(np.complex64)
    positions_m = np.stack([np.arange(3000) * 0.25, np.zeros(3000), np.full(3000, -3000.0)], axis=1)
    with pytest.raises(BenchError, match="no point target") as caught:
        point_targets(Pulses(gates, 44_920.0, 2.5, 0.03123), positions_m)
    assert caught.value.code == "B-SYNC-010"
