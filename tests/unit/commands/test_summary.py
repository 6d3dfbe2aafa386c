"""The tables at the end of a run: those read first, else a summary."""

from __future__ import annotations

import io
from dataclasses import replace
from typing import Any

from rich.console import Console

from bench.analysis import Analysis, Table
from bench.commands.tables import print_results, print_summary

UNITS = Table(
    "Units tested", "", ["unit", "failed", "verdict"], [["GNC-01", "–", "PASS"], ["GNC-02", "memory", "FAIL"]],
    prose=True, lead=True,
)  # fmt: skip
TABLE_3 = Table(
    "Table 3", "", ["parameter", "measured", "verdict"],
    [["overload", "–", "not tested"], ["gyro stability", "6.1 ± 0.5", "PASS"], ["range", "–", "not tested"]], lead=True,
)  # fmt: skip


def one(
    quantity: str, value: float, expanded: float, unit: str = "A", verdict: str = "none", **where: Any
) -> dict[str, Any]:
    entry = {"quantity": quantity, "unit": unit, "value": value, "expanded_uncertainty": expanded}
    return entry | {"conditions": where, "verdict": verdict}


def summarised(estimates: list[dict[str, Any]]) -> str:
    sheet = io.StringIO()
    print_summary(Console(file=sheet, width=110), "bias_ramp of NGU 7", estimates, 20.0)
    return sheet.getvalue().replace("\u00a0", " ")


def test_channels_down_and_quantities_across_at_the_reference_temperature() -> None:
    text = summarised(
        [
            one("bias", 368.0e-9, 0.8e-9, channel=1, temperature_degC=-10.0),
            one("bias", 436.57e-9, 0.49e-9, channel=1, temperature_degC=20.0),
            one("bias_tc2", 1e-12, 1e-13, channel=1),
            one("bias_residual", -11.5e-9, 0.05e-9, verdict="conditional_fail", channel=1),
            one("bias", -260.2e-9, 0.37e-9, channel=10, temperature_degC=20.0),
            one("master_clock_error", 1.9, 3.4, "ppm", temperature_degC=20.0),
        ]
    )
    assert "436.57 ± 0.49" in text
    assert "368" not in text
    assert "tc2" not in text
    assert "conditional fail" in text
    assert "−260.20 ± 0.37" in text
    assert "master_clock_error           1.9 ± 3.4 ppm  temperature_degC 20.0" in text


def test_a_long_list_says_what_it_leaves_out() -> None:
    text = summarised([one("up_minus_down", 1.0, 0.1, "ppm", reading=f"meter {k}") for k in range(30)])
    assert text.count("up_minus_down") == 24
    assert "... and 6 more in results.json" in text


def test_the_current_of_a_supply_is_not_in_nanoampere_and_no_uncertainty_is_no_zero() -> None:
    text = summarised([one("supply_current", 0.493478, 0.0, unit="A"), one("bias", 3e-7, 1e-9, unit="A")])
    assert "supply_current               0.493478 A" in text
    assert "bias                         300.0 ± 1.0 nA" in text


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
