"""Tables of a GNC module: one worst value for one quantity, and no figure of a clock that a record cannot tell."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from bench.analysis import estimate, number
from bench.model.texts import ENGLISH
from bench.report.model import ReportModel
from bench.report.tables import words_of
from bench.report.verdict_tables import verdict_table
from bench.systems.gnc.limits import table_3
from bench.systems.gnc.rows import check_table

SIZES = (("x", 7e-6, 7.5e-6), ("y", -4e-6, 8.5e-6), ("z", -5e-6, 15e-6))  # value and standard uncertainty


def test_the_specification_and_the_verdicts_show_the_same_worst_value() -> None:
    """z is nearest to its limit, with its interval; once the specification showed x, whose bare value is largest."""
    entries = [
        estimate(
            "accel_scale_repeatability", "1", value, std, {"kind": "accelerometer", "axis": axis}, n=24, limit=1e-3
        )
        for axis, value, std in SIZES
    ]
    (row,) = [row for row in table_3(entries, {}).rows if row[0].startswith("accelerometer: scale-factor rep")]
    assert row[4] == "z"
    model = ReportModel(title="T", results={"campaign": "gnc_unit_test", "estimates": entries})
    verdicts = verdict_table(model, words_of(ENGLISH))
    assert verdicts is not None
    (judged,) = [line for line in verdicts.rows if "repeatability" in line[0]]
    assert row[2] in judged


@pytest.mark.parametrize(("bound", "clock"), [(0.0165, "–"), (907945e-6, "–"), (float("nan"), "–"), (20e-6, "27 ± 20")])
def test_a_clock_that_a_record_cannot_tell_is_no_number(bound: float, clock: str) -> None:
    """0 +- 16500 ppm is what delays of the link make of a minute; jitter in steps of the time stamps."""
    ticks = SimpleNamespace(worst_jitter_s=2.3e-13, clock_error=27e-6, clock_bound=bound)
    checks = SimpleNamespace(ticks=ticks, samples=12_000, missing=0, findings=[])
    seen: Any = SimpleNamespace(row=SimpleNamespace(number=7, item="position"), checks=checks)
    table = check_table([seen])
    row = dict(zip(table.headers, table.rows[0], strict=True))
    assert row["largest jitter, us"] == "0"
    assert row["unit's clock, ppm"] == clock
    ticks.worst_jitter_s = 3.2e-6
    assert check_table([seen]).rows[0][4] == number(3.0, 0)
