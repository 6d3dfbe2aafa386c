"""The result table of campaigns without scale-factor errors: channels down, quantities across, the rest in lines."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from bench.analysis import with_uncertainty

_MOST_COLUMNS = 6
_MOST_LINES = 24
_SMALL_A = 1e-3
_AMPERE = re.compile(r"A(?![A-Za-z])")
_CURVATURES = ("_tc2", "_tc3")
_SEVERITY = ("fail", "conditional_fail", "conditional_pass", "pass")
Estimate = Mapping[str, Any]


def print_summary(out: Console, title: str, estimates: Sequence[Estimate], reference_degC: float | None) -> None:
    """Estimates that hold for the campaign or its reference temperature: each channel, then those without a channel.

    Currents are in nA; every value stands with its expanded uncertainty. Curvatures are in results.json.
    """
    out.print(title)
    by_quantity: dict[str, dict[Any, Estimate]] = {}
    whole: list[Estimate] = []
    for one in estimates:
        conditions = one["conditions"]
        elsewhere = conditions.get("temperature_degC", reference_degC) != reference_degC
        if elsewhere or one["quantity"].endswith(_CURVATURES):
            continue
        if "channel" not in conditions:
            whole.append(one)
        elif "repeat" not in conditions:
            by_quantity.setdefault(one["quantity"], {}).setdefault(conditions["channel"], one)
    if by_quantity:
        out.print(_by_channel(by_quantity))
    for one in whole[:_MOST_LINES]:
        out.print(f"{one['quantity']:<28} {_value(one)} {_unit(one)}  {_where(one)}".rstrip())
    if len(whole) > _MOST_LINES:
        out.print(f"... and {len(whole) - _MOST_LINES} more in results.json")


def _by_channel(by_quantity: Mapping[str, Mapping[Any, Estimate]]) -> Table:
    shown = list(by_quantity)[:_MOST_COLUMNS]
    table = Table(box=box.SIMPLE, collapse_padding=True, pad_edge=False)
    table.add_column("ch", justify="right", no_wrap=True)
    for quantity in shown:
        unit = _unit(next(iter(by_quantity[quantity].values())))
        table.add_column(f"{quantity.replace('_', chr(10))}\n{unit}", justify="right", no_wrap=True)
    table.add_column("verdict")
    for channel in sorted({channel for found in by_quantity.values() for channel in found}):
        row = [_value(by_quantity[name][channel]) if channel in by_quantity[name] else "-" for name in shown]
        table.add_row(str(channel), *row, _worst(by_quantity, channel))
    return table


def _worst(by_quantity: Mapping[str, Mapping[Any, Estimate]], channel: Any) -> str:
    verdicts = {found[channel]["verdict"] for found in by_quantity.values() if channel in found}
    return next((one for one in _SEVERITY if one in verdicts), "none").replace("_", " ")


def _scale(one: Estimate) -> float:
    """Return currents of a converter read best in nanoampere; that of a supply does not."""
    return 1e9 if _AMPERE.match(one["unit"]) and abs(one["value"]) < _SMALL_A else 1.0


def _value(one: Estimate) -> str:
    scale = _scale(one)
    return with_uncertainty(one["value"] * scale, one["expanded_uncertainty"] * scale)


def _unit(one: Estimate) -> str:
    return ("n" if _scale(one) != 1.0 else "") + str(one["unit"])


def _where(one: Estimate) -> str:
    return ", ".join(f"{name} {value}" for name, value in one["conditions"].items())
