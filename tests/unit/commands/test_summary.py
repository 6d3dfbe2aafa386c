"""The tables at the end of a run: those read first, else a summary."""

from __future__ import annotations

import io
from dataclasses import replace
from typing import Any

from rich.console import Console

from bench.analysis import Analysis, Estimate, Table, documents, estimate
from bench.commands.tables import print_results, print_summary

UNITS = Table(
    "Units tested", "", ["unit", "failed", "verdict"], [["GNC-01", "–", "PASS"], ["GNC-02", "memory", "FAIL"]],
    prose=True, lead=True,
)  # fmt: skip
TABLE_3 = Table(
    "Table 3", "", ["parameter", "measured", "verdict"],
    [["overload", "–", "not tested"], ["gyro stability", "6.1 ± 0.5", "PASS"], ["range", "–", "not tested"]], lead=True,
)  # fmt: skip


def one(quantity: str, value: float, expanded: float, unit: str = "A", verdict: str = "none", **where: Any) -> Estimate:
    entry = estimate(quantity, unit, value, expanded / 2.0, where, n=1)
    return entry.model_copy(update={"expanded_uncertainty": expanded, "verdict": verdict})


def summarised(estimates: list[Estimate]) -> str:
    sheet = io.StringIO()
    print_summary(Console(file=sheet, width=110), "bias_ramp of NGU 7", estimates, 20.0)
    return " ".join(sheet.getvalue().split())


def test_a_summary_shows_values_at_the_reference_temperature_and_counts_the_rest() -> None:
    text = summarised(
        [
            one("bias", 368.0e-9, 0.8e-9, channel=1, temperature_degC=-10.0),
            one("bias", 436.57e-9, 0.49e-9, channel=1, temperature_degC=20.0),
            one("bias_residual", -11.5e-9, 0.05e-9, verdict="conditional_fail", channel=1),
            one("bias", -260.2e-9, 0.37e-9, channel=10, temperature_degC=20.0),
            one("master_clock_error", 1.9, 3.4, "ppm", temperature_degC=20.0),
        ]
    )
    for words in ("436.57 ± 0.49", "conditional fail", "−260.20 ± 0.37", "master_clock_error 1.9 ± 3.4 ppm"):
        assert words in text
    assert "368" not in text
    text = summarised([one("supply_current", 0.493478, 0.0, unit="A"), one("bias", 3e-7, 1e-9, unit="A")])
    assert "supply_current 0.493478 A" in text  # not in nanoampere, and no uncertainty is no zero
    assert "bias 300.0 ± 1.0 nA" in text
    text = summarised([one("up_minus_down", 1.0, 0.1, "ppm", reading=f"meter {k}") for k in range(30)])
    assert text.count("up_minus_down") == 24
    assert "6 more in results.json" in text


def printed(*tables: Table) -> str:
    estimates = [one(f"q{number}", 1.0, 0.1, "1", "pass", serial="GNC-01") for number in range(99)]
    uut = {"model": "GNC", "serial": "B-1"}
    results = {
        "campaign": "gnc_unit_test", "uut": uut, "provenance": {"simulated": True}, "estimates": documents(estimates),
        "quality": {"records": 0, "frames": 291, "frames_bad": 0, "frames_lost": 0, "retaken": 0},
    }  # fmt: skip
    sheet = io.StringIO()
    analysis = Analysis("gnc_unit_test", "exchanges", uut, estimates, tables=list(tables))
    print_results(Console(file=sheet, width=110), results, analysis)
    return " ".join(sheet.getvalue().split())


def test_tables_that_lead_are_printed_and_what_is_left_out_is_counted() -> None:
    text = printed(UNITS)
    assert "GNC-02 memory FAIL" in text
    assert "verdicts: 99 pass; 99 values with their uncertainties in results.json" in text
    text = printed(TABLE_3)
    assert ("gyro stability" in text, "overload" in text, "2 rows not tested" in text) == (True, False, True)
    text = printed(replace(TABLE_3, rows=TABLE_3.rows[:1]))
    assert ("parameter" in text, "1 rows not tested" in text) == (False, True)
    text = printed(replace(UNITS, rows=[[f"U-{number:02}", "–", "PASS"] for number in range(30)]))
    assert ("U-23" in text, "U-24" in text, "6 more rows in the report" in text) == (True, False, True)
