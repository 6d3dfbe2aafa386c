"""The analysis of plain readings: repeatability, fits by condition, and what is refused."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import stats

from bench.analysis import Analysis, Material, Reading
from bench.model.errors import FitError
from bench.systems.readings.analysis import analyse

LINE = {"reads": "measure_voltage", "unit": "V", "relative": 0.0, "floor": 1e-3}


def material(read: dict[tuple[float, float], list[float]], **fit: Any) -> Material:
    """Readings by (level_V, temperature_degC), and a fit over level."""
    entries, readings = [], []
    for (level_V, degC), volts in read.items():
        conditions = {"level_V": level_V, "temperature_degC": degC}
        entries.append({"quantity": "output", "unit": "V", "conditions": conditions})
        named = {**conditions, "quantity": "output"}
        readings += [Reading(len(readings) + k, len(readings) + k, "meter", "measure_voltage", volt, named)
                     for k, volt in enumerate(volts)]  # fmt: skip
    asked = {"name": "gain", "of": "output", "degree": 1, "per": [], "expected": {}, **fit,
             "units": {"c0": "V", "c1": "1", "nonlinearity": "V"},
             "against": {"condition": "level_V", "unit": "V", "uncertainty": 2e-3}}  # fmt: skip
    return Material(
        rows=(),
        campaign={"analysis": "x", "uut": {"model": "SC", "serial": "1"}, "expected": entries, "fits": [asked]},
        standards={"meter": {"calibrated": "2000-01-01", "specifications": [LINE]}},
        readings=readings,
        utc_offset_s=1e9,
    )


def found(analysis: Analysis, quantity: str) -> list[dict[str, Any]]:
    return [dict(entry) for entry in analysis.estimates if entry["quantity"] == quantity]


def test_repeatability_is_pooled_over_conditions() -> None:
    volts = {(1.0, 20.0): [1.0, 1.2], (2.0, 20.0): [2.0, 2.1, 2.4], (3.0, 20.0): [3.0]}
    (entry,) = found(analyse(material(volts)), "output_repeatability")
    squares = 0.02 + float(np.sum((np.array(volts[2.0, 20.0]) - np.mean(volts[2.0, 20.0])) ** 2))
    assert entry["value"] == pytest.approx(math.sqrt(squares / 3.0))
    assert (entry["n"], entry["dof"]) == (5, 3.0)


@pytest.mark.parametrize("free", [1, 3, 10, 60])
def test_intervals_of_a_repeatability_hold_the_truth(free: int) -> None:
    """By the distribution of chi-square itself: of the estimates that a scatter gives, 95 % are within U of it."""
    (entry,) = found(analyse(material({(1.0, 20.0): list(range(free + 1))})), "output_repeatability")
    share = entry["expanded_uncertainty"] / entry["value"]
    least, most = 1.0 / (1.0 + share), 1.0 / (1.0 - share) if share < 1.0 else math.inf
    held = float(np.diff(stats.chi2.cdf([free * least**2, free * most**2], free))[0])
    print(f"{free} degrees of freedom: U {share:.3f} of the value, {held:.4f} hold")
    assert held == pytest.approx(0.95, abs=2e-3)
    assert entry["coverage_factor"] * entry["std_uncertainty"] == pytest.approx(entry["expanded_uncertainty"])


def test_a_fit_for_each_temperature_by_the_uncertainty_of_the_set_points() -> None:
    read = {(level, degC): [(1.0 + degC / 1000.0) * level] * 2 for degC in (20.0, 60.0) for level in (1.0, 2.0, 4.0)}
    slopes = found(analyse(material(read, per=["temperature_degC"])), "gain_c1")
    assert [entry["conditions"] for entry in slopes] == [{"temperature_degC": 20.0}, {"temperature_degC": 60.0}]
    assert [entry["value"] for entry in slopes] == pytest.approx([1.02, 1.06])
    spread = math.sqrt(float(np.sum((np.array([1.0, 2.0, 4.0]) - 7.0 / 3.0) ** 2)))
    own = math.hypot(5e-4, 1.02 * 1e-3) / spread  # half of both: the floor of the meter, the stated 2 mV of the level
    assert slopes[0]["std_uncertainty"] == pytest.approx(own, rel=1e-6)


def test_what_gives_no_fit_is_missing_and_the_rest_is_given() -> None:
    few = analyse(material({(1.0, 20.0): [1.0, 1.1]}))
    assert few.missing == ["gain: 1 points do not determine c0, c1"]
    assert found(few, "output_repeatability")
    read = {(level, 20.0): [volt] * 2 for level, volt in ((1.0, 1.0), (2.0, 0.0), (4.0, 3.0))}
    analysis = analyse(material(read, function="log"))
    assert analysis.missing == ["gain: a value has no logarithm or no reciprocal"]
    assert not found(analysis, "gain_c0")


def test_a_value_is_read_back_with_its_interval() -> None:
    """A line through exact points: at 3 V, and the uncertainty of the line there."""
    read = {(level, 20.0): [2.0 * level] * 2 for level in (1.0, 2.0, 4.0)}
    asked = [{"quantity": "at_three", "at": 3.0, "unit": "V", "low": 5.9, "high": 6.1}]
    (entry,) = found(analyse(material(read, read_back=asked)), "at_three")
    assert (entry["value"], entry["limits"]) == (pytest.approx(6.0), {"low": 5.9, "high": 6.1})
    own = math.hypot(5e-4, 2.0 * 1e-3)  # half of both: the floor of the meter, the stated 2 mV of the level
    levels = np.array([1.0, 2.0, 4.0])
    leverage = 1.0 / 3.0 + (3.0 - levels.mean()) ** 2 / np.sum((levels - levels.mean()) ** 2)
    assert entry["std_uncertainty"] == pytest.approx(own * math.sqrt(1.0 + leverage), rel=1e-6)  # it counts twice


def test_nothing_read_is_refused() -> None:
    with pytest.raises(FitError, match="no reading of the session has a value") as caught:
        analyse(material({}))
    assert caught.value.code == "B-FIT-160"
