"""Exact equality of results."""

from __future__ import annotations

import math
from typing import Any

import pytest

from bench.replay import compare

RESULTS: dict[str, Any] = {
    "session": "s", "estimates": [{"quantity": "dsf_n", "value": 412.31, "n": 14, "limit": None}],
    "quality": {"records": 7},
}  # fmt: skip


def test_the_same_document() -> None:
    assert compare(RESULTS, {**RESULTS}) == []
    assert compare([math.nan, math.inf], [math.nan, math.inf]) == []


def test_a_number_is_not_nan() -> None:
    assert [item.path for item in compare([1.0], [math.nan])] == ["[0]"]


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (0.1 + 0.2, 0.3), (1, 1.0), (0.0, -0.0), ("1", 1), (None, 0), (True, 1), ([1], 1), ({}, []),
        ("ab", ["a", "b"]), (412.31, math.nextafter(412.31, 500.0)),
    ],
)  # fmt: skip
def test_anything_else_differs(first: Any, second: Any) -> None:
    (difference,) = compare({"x": first}, {"x": second})
    assert (difference.path, difference.first, difference.second) == ("x", first, second)


def test_paths_lead_to_the_value() -> None:
    other = {
        "session": "s", "estimates": [{"quantity": "dsf_n", "value": 412.32, "n": 14}, {"quantity": "bias"}],
        "quality": {"records": 7, "splices": 0},
    }  # fmt: skip
    found = [str(difference) for difference in compare(RESULTS, other)]
    assert found == [
        "estimates[0].limit: None != '(absent)'",
        "estimates[0].value: 412.31 != 412.32",
        "estimates[1]: '(absent)' != {'quantity': 'bias'}",
        "quality.splices: '(absent)' != 0",
    ]
