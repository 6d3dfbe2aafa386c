"""Values that a sequence names: mean and uncertainty from scatter and register, verdict, and what casts doubt."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from bench.analysis import Analysis, Material, Reading, build_results
from bench.analysis.analysis import with_expected

DAY_S = 86_400.0
PROVENANCE = {"simulated": True, "plan_sha256": "", "frame_sha256": "", "session_sha256": "", "software": "test"}
LINES = [
    {"reads": "measure_voltage", "unit": "V", "range": 10.0, "relative": 20e-6, "floor": 40e-6, "age_s": 90 * DAY_S},
    {"reads": "measure_voltage", "unit": "V", "range": 10.0, "relative": 35e-6, "floor": 50e-6},
    {"reads": "measure_voltage", "unit": "V", "range": 100.0, "relative": 45e-6, "floor": 600e-6},
]


def material(volts: list[float | None], *, expected: dict[str, Any], age_days: float = 30.0, lines: Any = LINES,
             arguments: dict[str, Any] | None = None) -> Material:  # fmt: skip
    entry = {"quantity": "rail", "unit": "V", "conditions": {"level_V": 5.0}, **expected}
    conditions = {"level_V": 5.0, "quantity": "rail"}
    readings = [
        Reading(10.0 + k, k, "meter", "measure_voltage", volt, conditions, arguments or {})
        for k, volt in enumerate(volts)
    ]
    return Material(
        rows=(),
        campaign={"analysis": "readings", "uut": {"model": "SC", "serial": "1"}, "expected": [entry]},
        standards={"meter": {"calibrated": "2000-01-01", "specifications": lines}},
        readings=readings,
        utc_offset_s=946_684_800.0 + age_days * DAY_S,  # 2000-01-01, and so much later
    )


def results(source: Material, rule: str = "non_binary") -> list[dict[str, Any]]:
    analysis = with_expected(Analysis("readings", "m", {"model": "SC", "serial": "1"}, []), source)
    document = build_results("s", analysis, {}, PROVENANCE, {"rule": rule})
    estimates: list[dict[str, Any]] = document["estimates"]
    return estimates


def test_mean_scatter_and_specification() -> None:
    """By hand: s / sqrt(n), and half of 20 ppm of 5 V plus 40 uV; the means of five readings do not shrink it."""
    volts = [5.0001, 4.9999, 5.0002, 4.9998, 5.0000]
    (found,) = results(material(list(volts), expected={"low": 4.9, "high": 5.1}))
    std_a, std_b = np.std(volts, ddof=1) / math.sqrt(5), (20e-6 * 5.0 + 40e-6) / 2.0
    assert found["value"] == pytest.approx(5.0, abs=1e-12)
    assert found["std_uncertainty"] == pytest.approx(math.hypot(std_a, std_b), rel=1e-9)
    assert found["dof"] == pytest.approx(4.0 * (1.0 + (std_b / std_a) ** 2) ** 2, rel=1e-9)  # Welch-Satterthwaite
    assert (found["limit"], found["limits"], found["verdict"]) == (None, {"low": 4.9, "high": 5.1}, "pass")
    assert found["quality"] == "sound"


@pytest.mark.parametrize(
    ("volt", "age_days", "arguments", "expanded_V"),
    [
        (5.0, 30.0, {}, 20e-6 * 5.0 + 40e-6),
        (5.0, 91.0, {}, 35e-6 * 5.0 + 50e-6),  # older than 90 days: the line of one year
        (12.0, 30.0, {}, 45e-6 * 12.0 + 600e-6),  # the lowest range that holds it
        (5.0, 30.0, {"range": 100.0}, 45e-6 * 5.0 + 600e-6),  # the range that was set
    ],
)
def test_specification_by_range_and_age(
    volt: float, age_days: float, arguments: dict[str, Any], expanded_V: float
) -> None:
    (found,) = results(material([volt] * 3, expected={}, age_days=age_days, arguments=arguments))
    assert found["std_uncertainty"] == pytest.approx(expanded_V / 2.0, rel=1e-9)


@pytest.mark.parametrize(("volt", "lines"), [(5.0, []), (200.0, LINES)])
def test_without_a_specification_nothing_is_stated(volt: float, lines: Any) -> None:
    """The interval would lack the error of the instrument: no U, no verdict, and the reason says why."""
    (found,) = results(material([volt] * 5, expected={"low": 4.9, "high": 5.1}, lines=lines))
    assert (found["quality"], found["verdict"], found["expanded_uncertainty"]) == ("doubtful", "indeterminate", None)
    (reason,) = found["reasons"]
    assert reason["code"] == "no_specification"
    assert "no specification of meter.measure_voltage" in reason["sentence"]
    assert "30 days after its calibration" in reason["sentence"]


def test_a_drift_and_an_odd_reading_cast_doubt_where_they_move_the_mean() -> None:
    noise = 1e-6 * np.random.default_rng(1).normal(size=20)
    assert results(material(list(5.0 + noise), expected={}))[0]["quality"] == "sound"
    rising = results(material(list(5.0 + 1e-3 * np.arange(20.0) + noise), expected={}))[0]
    assert [reason["code"] for reason in rising["reasons"]] == ["drifts"]
    spike = 5.0 + noise
    spike[7] += 0.01
    (odd,) = results(material(list(spike), expected={}))
    assert [reason["code"] for reason in odd["reasons"]] == ["odd_reading"]
    spike[7] = 5.0 + 3e-5  # as odd, and nothing against the specification
    assert results(material(list(spike), expected={}))[0]["quality"] == "sound"


def test_readings_that_repeat_cast_no_doubt_by_chance() -> None:
    rng = np.random.default_rng(4)
    worlds = [results(material(list(rng.normal(5.0, 1e-3, 12)), expected={}))[0]["quality"] for _ in range(300)]
    assert worlds.count("doubtful") <= 3  # 0.2 % of campaigns


def test_span_and_one_sided_limits() -> None:
    mean, span = results(material([5.0, 5.001, 5.0005], expected={"high": 5.1, "span": 2e-3}))
    assert (mean["limits"], mean["verdict"]) == ({"low": None, "high": 5.1}, "pass")
    assert (span["quantity"], span["verdict"]) == ("rail_span", "pass")
    assert span["value"] == pytest.approx(1e-3)
    assert results(material([5.0, 5.003], expected={"span": 2e-3}))[1]["verdict"] == "fail"


def test_the_decision_rule_of_the_campaign_counts() -> None:
    near = material([5.09995] * 3, expected={"low": 4.9, "high": 5.1})
    assert [results(near, rule)[0]["verdict"] for rule in ("simple", "guard_band", "non_binary")] == [
        "pass", "fail", "conditional_pass"
    ]  # fmt: skip


def test_what_was_not_read_is_missing() -> None:
    analysis = with_expected(
        Analysis("readings", "m", {"model": "SC", "serial": "1"}, []), material([None, None], expected={"low": 4.9})
    )
    assert analysis.missing == ["rail at level 5 V was not read"]
    (found,) = results(material([5.0, None, 5.0], expected={}))
    assert (found["n"], found["dropped"]) == (2, 1)


def test_a_step_that_was_done_again_counts_once() -> None:
    source = material([5.0, 5.1], expected={})
    again = [*source.readings, Reading(99.0, 0, "meter", "measure_voltage", 5.2, source.readings[0].conditions)]
    (found,) = results(Material(source.rows, source.campaign, source.standards, readings=again, utc_offset_s=1e9))
    assert (found["n"], found["value"]) == (2, pytest.approx(5.15))
