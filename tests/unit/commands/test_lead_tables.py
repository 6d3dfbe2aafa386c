"""What is printed at the end of a run whose analysis says what is read first."""

from __future__ import annotations

import io
from dataclasses import replace

from rich.console import Console

from bench.analysis import Analysis, Table
from bench.commands.tables.results import print_results

UNITS = Table(
    "Units tested", "", ["unit", "failed", "verdict"], [["GNC-01", "–", "PASS"], ["GNC-02", "memory", "FAIL"]],
    prose=True, lead=True,
)  # fmt: skip
TABLE_3 = Table(
    "Table 3", "", ["parameter", "measured", "verdict"],
    [["overload", "–", "not tested"], ["gyro stability", "6.1 ± 0.5", "PASS"], ["range", "–", "not tested"]], lead=True,
)  # fmt: skip


def printed(*tables: Table) -> str:
    estimates = [
        {"quantity": f"q{number}", "unit": "1", "value": 1.0, "expanded_uncertainty": 0.1, "verdict": "pass",
         "conditions": {"unit": "GNC-01"}}
        for number in range(99)
    ]  # fmt: skip
    uut = {"model": "GNC", "serial": "B-1"}
    results = {
        "campaign": "gnc_unit_test", "uut": uut, "provenance": {"simulated": True}, "estimates": estimates,
        "quality": {"records": 0, "frames": 291, "frames_bad": 0, "frames_lost": 0, "retaken": 0},
    }  # fmt: skip
    sheet = io.StringIO()
    analysis = Analysis("gnc_unit_test", "exchanges", uut, estimates, tables=list(tables))
    print_results(Console(file=sheet, width=110), results, analysis)
    return sheet.getvalue()


def test_the_verdict_of_each_unit_comes_first_and_the_values_are_counted() -> None:
    lines = [line.split() for line in printed(UNITS).splitlines() if line.strip()]
    assert lines[0][:3] == ["gnc_unit_test", "of", "GNC"]
    assert lines[1] == ["Units", "tested"]
    assert ["GNC-02", "memory", "FAIL"] in lines[:6]
    assert not any(line[0].startswith("q") for line in lines)
    assert "verdicts: 99 pass; 99 values with their uncertainties in results.json" in printed(UNITS)


def test_rows_that_were_not_tested_are_counted() -> None:
    text = printed(TABLE_3)
    assert "gyro stability" in text
    assert "overload" not in text
    assert "Table 3: 2 rows not tested" in text


def test_a_table_of_nothing_but_what_was_not_tested_is_one_line() -> None:
    text = printed(replace(TABLE_3, rows=TABLE_3.rows[:1]))
    assert "parameter" not in text
    assert "Table 3: 1 rows not tested" in text


def test_a_long_table_says_what_it_leaves_out() -> None:
    text = printed(replace(UNITS, rows=[[f"U-{number:02}", "–", "PASS"] for number in range(30)]))
    assert "U-23" in text
    assert "U-24" not in text
    assert "Units tested: 6 more rows in the report" in text
