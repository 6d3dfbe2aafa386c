"""The table at the end of a campaign without scale factors."""

from __future__ import annotations

import io
from typing import Any

from rich.console import Console

from bench.commands.tables.summary import print_summary


def one(
    quantity: str, value: float, expanded: float, unit: str = "A", verdict: str = "none", **where: Any
) -> dict[str, Any]:
    entry = {"quantity": quantity, "unit": unit, "value": value, "expanded_uncertainty": expanded}
    return entry | {"conditions": where, "verdict": verdict}


def printed(estimates: list[dict[str, Any]]) -> str:
    sheet = io.StringIO()
    print_summary(Console(file=sheet, width=110), "bias_ramp of NGU 7", estimates, 20.0)
    return sheet.getvalue().replace("\u00a0", " ")


def test_channels_down_and_quantities_across_at_the_reference_temperature() -> None:
    text = printed(
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
    text = printed([one("up_minus_down", 1.0, 0.1, "ppm", reading=f"meter {k}") for k in range(30)])
    assert text.count("up_minus_down") == 24
    assert "... and 6 more in results.json" in text


def test_the_current_of_a_supply_is_not_in_nanoampere_and_no_uncertainty_is_no_zero() -> None:
    text = printed([one("supply_current", 0.493478, 0.0, unit="A"), one("bias", 3e-7, 1e-9, unit="A")])
    assert "supply_current               0.493478 A" in text
    assert "bias                         300.0 ± 1.0 nA" in text
