"""Under an accreditation stands only what is real, sound, within the scope and not better than its CMC."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError
from report_sample import estimate

from bench.report.accreditation import below_capability, not_covered
from bench.report.laboratory import Accreditation, Capability

SCOPE = [
    {"quantity": "dsf_n", "range": ["-1000 ppm", "1000 ppm"], "cmc": "20 ppm", "method": "scale_factor"},
    {"quantity": "bias", "range": ["-1 uA", "1 uA"], "cmc": "0.5 nA", "method": "scale_factor"},
]
OWN = Accreditation.model_validate({"body": "Example Body", "number": "EX-0000", "scope": SCOPE})


def row(quantity: str, unit: str, value: float, expanded: float, **more: Any) -> dict[str, Any]:
    return estimate(quantity, unit, value, expanded, channel=1) | more


@pytest.mark.parametrize(
    ("found", "method", "reason"),
    [
        (row("dsf_n", "ppm", 12.0, 20.0), "scale_factor", ""),
        (row("dsf_n", "1", 12e-6, 20e-6), "scale_factor", ""),  # the same in another unit
        (row("bias", "A", 4e-7, 5e-10), "scale_factor", ""),
        (row("bias", "nA", 400.0, 0.5), "scale_factor", ""),
        (row("dsf_n", "ppm", 12.0, 19.9), "scale_factor", "U = 19.9 ppm is below the CMC of 20 ppm"),
        (row("bias", "nA", 400.0, 0.4), "scale_factor", "U = 0.4 nA is below the CMC of 0.5 nA"),
        (row("dsf_n", "ppm", 12.0, 0.0), "scale_factor", "U = 0 ppm is below the CMC of 20 ppm"),
        (row("dsf_n", "ppm", 1000.1, 30.0), "scale_factor", "1000.1 ppm by scale_factor is outside the scope"),
        (row("dsf_n", "ppm", 12.0, 30.0), "dmm_method", "12 ppm by dmm_method is outside the scope"),
        (row("dsf_n", "A", 12.0, 30.0), "scale_factor", "12 A by scale_factor is outside the scope"),
        (row("lag", "pulse", 1.0, 2.0), "scale_factor", "1 pulse by scale_factor is outside the scope"),
        (row("dsf_n", "ppm", 12.0, 30.0, quality="doubtful"), "scale_factor", "is doubtful"),
    ],
)
def test_each_condition_alone_keeps_a_result_out(found: dict[str, Any], method: str, reason: str) -> None:
    said = not_covered(OWN, method, [found])
    assert said == ({found["quantity"]: reason} if reason else {})


def test_reasons_of_one_quantity_are_counted() -> None:
    rows = [row("dsf_n", "ppm", 1.0, 10.0), row("dsf_n", "ppm", 2.0, 11.0), row("bias", "nA", 400.0, 0.5)]
    assert list(not_covered(OWN, "scale_factor", rows).values()) == [
        "U = 10 ppm is below the CMC of 20 ppm, and 1 more of it"
    ]


def test_a_result_outside_the_scope_has_no_capability_to_be_below_of() -> None:
    rows = [row("dsf_n", "ppm", 5000.0, 1.0), row("dsf_n", "ppm", 5.0, 1.0, quality="refused")]
    assert below_capability(OWN, "scale_factor", rows) == {}
    assert list(below_capability(OWN, "scale_factor", [*rows, row("bias", "A", 0.0, 1e-10)])) == ["bias"]


@pytest.mark.parametrize(
    "wrong",
    [{"cmc": "20 nA"}, {"cmc": "20"}, {"cmc": "0 ppm"}, {"range": ["1 ppm", "-1 ppm"]}, {"range": ["1 A", "2 ppm"]}],
)
def test_a_line_of_the_scope_that_says_nothing_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        Capability.model_validate(SCOPE[0] | wrong)
