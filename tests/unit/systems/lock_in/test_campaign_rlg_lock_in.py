"""Ring lasers end to end from blocks: random walk before and after, constants, gaps, harm said aloud, limits."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from laser_edges import simulated_edges
from rlg_rig import SITE, laser, material, row_of, without
from spoken import english_left

from bench.analysis import build_results
from bench.model.errors import FitError
from bench.model.quality import Quality
from bench.model.texts import told
from bench.systems.lock_in.analysis import METHODS, analyse
from bench.systems.lock_in.compensation import COMPENSATORS
from bench.systems.lock_in.records import laser_records
from bench.systems.lock_in.report import tables
from bench.systems.lock_in.result import Measured, laser_result, requirement_of, squared

SEED, SECONDS = 704, 3.2
SLOW_HZ, FAST_HZ = 20_000_000, 100_000_000
PROVENANCE = {"simulated": True, "plan_sha256": "a", "frame_sha256": "b", "session_sha256": "c", "software": "x 1"}
LIMIT = {"alignment_time": {"value": 60.0, "unit": "s"}}


@pytest.fixture(scope="module")
def edges() -> dict[float, Any]:
    rng = np.random.default_rng(SEED)
    return {path_m: simulated_edges(laser(path_m), SECONDS, rng) for path_m in (0.15, 0.28)}


@pytest.fixture(scope="module")
def rows(edges: dict[float, Any]) -> list[Any]:
    places = [(path_m, clock_Hz) for path_m in edges for clock_Hz in (SLOW_HZ, FAST_HZ)]
    return [row_of(edges[path_m], clock_Hz, k + 1, path_length_m=path_m) for k, (path_m, clock_Hz) in enumerate(places)]


@pytest.fixture(scope="module")
def whole(rows: list[Any]) -> Any:
    return analyse(material(*rows, limits=LIMIT))


@pytest.fixture(scope="module")
def alone(rows: list[Any]) -> Any:
    """Of the record of 28 cm with the fast clock."""
    return analyse(material(rows[3]))


def of(analysis: Any, quantity: str, **place: Any) -> Any:
    """The one estimate of a quantity at a place."""
    wanted = place.items()
    (found,) = [
        one for one in analysis.estimates
        if one["quantity"] == quantity and all(one["conditions"].get(key) == value for key, value in wanted)
    ]  # fmt: skip
    return found


def test_random_walk_is_that_of_theory(whole: Any) -> None:
    """Equation (6) for the stated lock-in rate; 3.2 s know it to about 7 %, so within four standard uncertainties."""
    for path_m in (0.15, 0.28):
        raw = of(whole, "angle_random_walk", path_length_m=path_m, clock_Hz=FAST_HZ, method="raw")
        expected = laser(path_m).lock_in_walk_deg_rt_h
        assert raw["std_uncertainty"] < 0.12 * expected
        assert abs(raw["value"] - expected) < 4.0 * raw["std_uncertainty"]


def test_constants_of_the_lock_in_are_those_of_the_laser(whole: Any) -> None:
    for path_m in (0.15, 0.28):
        rate = of(whole, "lock_in_rate", path_length_m=path_m, clock_Hz=FAST_HZ)
        assert rate["value"] == pytest.approx(0.05 * (0.28 / path_m) ** 2, abs=5.0 * rate["std_uncertainty"])
        phase = of(whole, "backscatter_phase", path_length_m=path_m, clock_Hz=FAST_HZ)
        assert phase["value"] == pytest.approx(90.0, abs=5.0 * phase["std_uncertainty"])
        assert phase["std_uncertainty"] < 0.2


def test_uncertainty_of_large_lock_in_counts_what_the_fit_neglects() -> None:
    """Jumps of 0.14 rad: the lock-in rate is off by 0.2 %, ten times what the scatter of the turnarounds says."""
    strong = laser(0.15, lock_in_deg_s=0.35)
    analysis = analyse(
        material(row_of(simulated_edges(strong, 1.6, np.random.default_rng(7)), FAST_HZ, path_length_m=0.15))
    )
    rate = of(analysis, "lock_in_rate")
    assert abs(rate["value"] - 0.35) < 2.5 * rate["std_uncertainty"]
    assert rate["std_uncertainty"] < 0.005 * 0.35


def test_compensation_near_90_deg_does_what_the_paper_says(whole: Any) -> None:
    at = {"path_length_m": 0.28, "clock_Hz": FAST_HZ}
    joint = of(whole, "random_walk_ratio", method="dither_shape", **at)
    assert 0.15 < joint["value"] < 0.45
    assert of(whole, "random_walk_ratio", method="global_constants", **at)["value"] < 0.1
    assert of(whole, "random_walk_ratio", method="fresnel", **at)["value"] < 0.15
    shorter = of(whole, "alignment_time_ratio", method="dither_shape", **at)
    assert shorter["value"] == pytest.approx(joint["value"] ** 2)


def test_alignment_time_is_that_of_equation_2(whole: Any) -> None:
    """T = (N / (We cos(lat) psi))^2 with T in hours and psi in radians, by hand."""
    at = {"path_length_m": 0.28, "clock_Hz": FAST_HZ, "method": "raw"}
    walk = of(whole, "angle_random_walk", **at)["value"]
    earth_deg_h = 15.041067 * math.cos(math.radians(SITE["latitude_deg"]))
    hours = (walk / (earth_deg_h * 2.0 * math.pi / 6400.0)) ** 2
    assert of(whole, "alignment_time", **at)["value"] == pytest.approx(3600.0 * hours, rel=1e-6)


def test_only_the_method_asked_for_is_judged(whole: Any, rows: list[Any]) -> None:
    judged = {one["conditions"]["method"] for one in whole.estimates if one["verdict"] != "none"}
    assert judged == {"global_constants"}
    assert {one["verdict"] for one in whole.estimates if one["limit"] is not None} == {"pass"}
    other = analyse(material(rows[1], limits=LIMIT), "parabolas")  # 15 cm: 4,000 s before compensation
    assert [one["verdict"] for one in other.estimates if one["limit"] is not None] == ["fail"]


def test_path_length_exponent(whole: Any) -> None:
    found = of(whole, "path_length_exponent", clock_Hz=FAST_HZ, method="raw")
    assert found["value"] == pytest.approx(-2.5, abs=4.0 * found["std_uncertainty"])
    assert found["std_uncertainty"] < 0.25


def test_tables_and_figures_of_the_paper(whole: Any) -> None:
    leads = [one.title for one in whole.tables if one.lead]
    assert leads == ["Random walk after compensation over that before", "Alignment time"]
    captions = " ".join(f"{one.title} {one.caption}" for one in whole.figures)
    for number in (1, 2, 7, 8, 9, 10, 11, 12):
        assert f"As figure {number} of the paper." in captions
    assert "Nobody knows the true one" in captions
    assert all(len(series.x) < 2000 for one in whole.figures for series in one.series)
    assert all(np.isfinite(series.y).all() for one in whole.figures for series in one.series)
    assert len(whole.tables[3].rows) == 4 * (1 + len(METHODS))
    assert whole.missing == []


def test_results_are_a_valid_document_and_say_nothing_twice(whole: Any) -> None:
    document = build_results("one", whole, {}, PROVENANCE)
    places = [(one["quantity"], json.dumps(one["conditions"], sort_keys=True)) for one in document["estimates"]]
    assert len(places) == len(set(places))


def test_the_beat_is_read_from_levels_and_never_from_conditions(rows: list[Any], alone: Any) -> None:
    """The same edges: the answer does not depend on what a person noted beside the path."""
    (record,) = laser_records(material(rows[3]))
    noted = row_of_conditions(rows[3], clock_Hz=1, item="other", note="beta 12 deg")
    other = analyse(material(noted))
    assert record.path_length_m == 0.28
    assert [one["value"] for one in alone.estimates] == [one["value"] for one in other.estimates]


def row_of_conditions(row: Any, **conditions: Any) -> Any:
    """The same record under other conditions."""

    return replace(row, window=replace(row.window, conditions=dict(row.window.conditions) | conditions))


def test_gaps_are_not_bridged(rows: list[Any], alone: Any) -> None:
    """Two blocks lost: three stretches, and the random walk does not notice."""
    broken = analyse(material(without(rows[3], 150, 300)))
    (held,) = broken.tables[4].rows
    assert held[7:10] == [3, 2, 0]
    assert any("2 blocks lost" in one and "3 stretches" in one for one in broken.notes)
    for method in ("raw", *COMPENSATORS):
        before, after = (of(one, "angle_random_walk", method=method) for one in (alone, broken))
        assert after["value"] == pytest.approx(before["value"], abs=4.0 * before["std_uncertainty"])


def test_all_that_is_composed_is_said_in_korean(whole: Any) -> None:
    assert english_left(whole) == set()
    assert told(whole.tables[1].title, "ko") == "정렬 시간"


def test_harm_is_said_aloud() -> None:
    """Backscatter phase 20 deg: parabolas make it worse, and the first note and the lead table say so."""
    edges = simulated_edges(laser(0.28, 20.0), SECONDS, np.random.default_rng(SEED + 1))
    analysis = analyse(material(row_of(edges, SLOW_HZ, path_length_m=0.28)))
    assert of(analysis, "random_walk_ratio", method="parabolas")["value"] > 1.3
    assert "parabolas, 4 a side makes the gyroscope WORSE" in analysis.notes[0]
    assert "WORSE" in analysis.tables[0].rows[0][-1]
    assert told(analysis.tables[0].rows[0][-1], "ko").endswith(" 악화")
    assert told(analysis.notes[0], "ko").startswith(
        "포물선, 한쪽 4개 보상으로 자이로스코프가 악화됩니다: 28 cm, 20 MHz"
    )
    assert any("Found here: 20 deg" in one for one in analysis.notes)
    assert any("equation that simulated lasers obey" in one for one in analysis.notes)


def test_a_second_backscatter_is_seen_in_what_the_fit_leaves() -> None:
    edges = simulated_edges(laser(0.28, second_harmonic=0.2), 1.6, np.random.default_rng(SEED + 2))
    analysis = analyse(material(row_of(edges, FAST_HZ, path_length_m=0.28)))
    assert float(analysis.tables[2].rows[0][-1]) > 5.0
    assert any("not of one constant size and phase" in one for one in analysis.notes)


def test_a_dither_that_hardly_scatters_is_told(whole: Any) -> None:
    edges = simulated_edges(laser(0.28, dither_noise=0.0), 1.2, np.random.default_rng(SEED + 3))
    analysis = analyse(material(row_of(edges, SLOW_HZ, path_length_m=0.28)))
    assert any("dynamic lock-in" in check.sentence for check in analysis.evidence)
    assert not any("dynamic lock-in" in check.sentence for check in whole.evidence)


def test_turnarounds_that_cannot_be_compensated_are_told(whole: Any) -> None:
    """A dither of 10 deg/s has 16 crossings a side in one turnaround of thirteen."""
    edges = simulated_edges(laser(0.28, dither_deg_s=10.0), 2.4, np.random.default_rng(SEED + 4))
    analysis = analyse(material(row_of(edges, FAST_HZ, path_length_m=0.28)))
    assert any("turnarounds could be compensated" in one for one in analysis.notes)
    assert not any("turnarounds could be compensated" in one for one in whole.notes)


def test_what_cannot_be_told_from_zero_is_a_limit(rows: list[Any]) -> None:
    """A walk of 0 with an upper limit is no alignment in no time: 95 of 100 such normal walks are in the limit."""
    (record,) = laser_records(material(rows[1]))
    one = laser_result(record)
    hidden = replace(one.walks["global_constants"], n_deg_rth=0.0, n_std_deg_rth=math.nan, n_upper_deg_rth=1.645e-3)
    one = replace(one, walks=dict(one.walks) | {"global_constants": hidden})
    requirement = requirement_of({"site": SITE})
    comparison, alignment, _, walks, _ = tables([one], requirement, "global_constants")
    limit = 2.776 * 1e-3 / one.walks["raw"].n_deg_rth  # four degrees of freedom
    assert float(comparison.rows[0][3][2:]) == pytest.approx(limit, rel=0.05)
    assert walks.rows[1][3] == "< 2.8"  # four degrees of freedom: k of 2.78, as the estimate has it
    assert [cell.startswith("<") for cell in alignment.rows[0][2:]] == [False, True, True, True]  # the last: by bias
    level_deg = 15.041067 * math.cos(math.radians(37.0)) * math.radians(0.05625)
    assert float(alignment.rows[0][3][2:]) > 3600.0 * (1.645e-3 / level_deg) ** 2
    found = squared(Measured(0.3, 0.2))
    draws = np.square(np.random.default_rng(1).normal(0.3, 0.2, 100_000))
    assert found.std == pytest.approx(draws.std(), rel=0.02)


def test_several_phase_settings_are_drawn_against_the_phase_found(edges: dict[float, Any]) -> None:
    rows = [
        row_of(edges[0.28], FAST_HZ, k + 1, path_length_m=0.28, phase_setting_deg=setting)
        for k, setting in enumerate((70.0, 80.0, 90.0))
    ]
    analysis = analyse(material(*rows))
    (figure,) = [one for one in analysis.figures if one.title == "Ratio against backscatter phase"]
    assert figure.series[0].x == pytest.approx([90.0] * 3, abs=0.5)
    assert of(analysis, "angle_random_walk", method="raw", phase_setting_deg=80.0)["n"] > 2500


def test_a_combination_without_a_record_and_a_record_without_edges_are_missing(rows: list[Any]) -> None:
    empty = without(rows[0], *range(len(rows[0].samples)))
    analysis = analyse(material(empty, rows[1], rows[3]))
    assert any("record 1" in one and "B-RLG-001" in one for one in analysis.missing)
    alone = analyse(material(rows[0], rows[3]))
    assert {"path 15 cm with the clock of 100 MHz: no record", "path 28 cm with the clock of 20 MHz: no record"} <= set(
        alone.missing
    )


def test_flagged_records_are_not_used(rows: list[Any]) -> None:
    tripped = replace(rows[1], quality=Quality.TRIPPED)
    analysis = analyse(material(tripped, replace(rows[3], quality=Quality.LOST)))
    assert "record 2: flagged TRIPPED" in analysis.missing
    assert {one["conditions"].get("path_length_m") for one in analysis.estimates} == {0.28}
    with pytest.raises(FitError, match="TRIPPED") as raised:
        analyse(material(tripped))
    assert raised.value.code == "B-RLG-008"
    with pytest.raises(FitError) as raised:
        laser_records(material(replace(rows[0], quality=Quality.RETAKEN)))
    assert raised.value.code == "B-RLG-001"


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"limits": {"alignment_eror": {"value": 1.0, "unit": "deg"}}}, "B-RLG-004"),
        ({"limits": {"alignment_time": {"value": 1.0, "unit": "deg"}}}, "B-RLG-004"),
        ({"limits": {"alignment_error": {"value": 0.0, "unit": "deg"}}}, "B-RLG-004"),
        ({"site": {"azimuth_deg": 20.0}}, "B-RLG-005"),
    ],
)
def test_requirements_that_are_none(change: dict[str, Any], code: str) -> None:
    with pytest.raises(FitError) as raised:
        requirement_of({"site": SITE} | change)
    assert raised.value.code == code


def test_without_a_limit_the_error_is_one_nato_mil() -> None:
    assert requirement_of({"site": SITE}).error_deg == 0.05625
    stated = {"alignment_error": {"value": 0.1, "unit": "deg"}, "alignment_time": {"value": 90.0, "unit": "s"}}
    found = requirement_of({"site": SITE, "limits": stated})
    assert (found.error_deg, found.time_s) == (0.1, 90.0)


def test_a_session_without_ring_lasers_and_wrong_lengths(rows: list[Any]) -> None:
    with pytest.raises(FitError, match="path_length_m") as raised:
        laser_records(material())
    assert raised.value.code == "B-RLG-001"
    for wrong in ("28 cm", 0.0, True):
        with pytest.raises(FitError) as raised:
            laser_records(material(row_of_conditions(rows[0], path_length_m=wrong)))
        assert raised.value.code == "B-RLG-006"


def test_a_laser_without_dither_is_refused_with_what_to_look_at(edges: dict[float, Any]) -> None:
    still = edges[0.28]
    beat = still.channel == 0

    names = ("t_s", "channel", "level", "cosine", "count")
    alone = replace(still, **{name: getattr(still, name)[beat] for name in names})
    with pytest.raises(FitError, match="pick-off") as raised:
        analyse(material(row_of(alone, FAST_HZ, path_length_m=0.28)))
    assert raised.value.code == "B-RLG-007"


def test_unknown_methods_are_refused(rows: list[Any]) -> None:
    with pytest.raises(FitError) as raised:
        analyse(material(rows[0]), "truth")
    assert raised.value.code == "B-FIT-004"
