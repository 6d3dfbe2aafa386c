"""Judge of the supply: voltage at the board and current of the module, before the tests.

Source: GNC-module paper, table 3, row 2.
"""

from __future__ import annotations

from collections.abc import Sequence

from bench.analysis import Reading
from bench.systems.gnc.limits import Limits
from bench.systems.gnc.unit_test.answers import Findings, Measured, Wrong

_MEASURED = {"measure_voltage": ("supply_voltage", "V"), "measure_current": ("supply_current", "A")}


def judge_supply(readings: Sequence[Reading], limits: Limits) -> tuple[Findings, list[Reading]]:
    """Voltage 5 V and current 0.49 A, each within 5 % unless the sequence says otherwise; and the readings used."""
    found, used = Findings(), []
    for one in readings:
        if one.name not in _MEASURED:
            continue
        used.append(one)
        quantity, unit = _MEASURED[one.name]
        due, most = limits[quantity], limits[f"{quantity}_deviation"]
        sent, due_text = f"{one.role} {one.name}", f"{due:g} {unit} within {100 * most:g} %"
        if not isinstance(one.value, int | float):
            found.wrong.append(Wrong(one.t_s, f"{quantity}: no reading", sent, due_text, "nothing"))
            continue
        value, place = float(one.value), {"role": one.role}
        deviation = value / due - 1.0
        found.measured.append(Measured(quantity, unit, value, 0.0, place))
        found.measured.append(Measured(f"{quantity}_deviation", "1", deviation, 0.0, place, most))
        if not abs(deviation) <= most:
            found.wrong.append(Wrong(one.t_s, quantity.replace("_", " "), sent, due_text, f"{value:.4f} {unit}"))
    taken = {one.name for one in used}
    for name, (quantity, _) in _MEASURED.items():
        if used and name not in taken:
            text = f"{quantity.replace('_', ' ')} was not measured"
            found.wrong.append(Wrong(used[-1].t_s, text, "nothing", "a reading of it", "nothing"))
    return found, used
