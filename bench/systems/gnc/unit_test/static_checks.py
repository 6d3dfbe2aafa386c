"""Judge of the static checks: sizes and resistances that a person measured on a unit before it was powered.

Source: GNC-module paper, section 5.1 (checks before power) and table 3 (size).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from bench.analysis import GivenValue
from bench.model.units import plain_quantity
from bench.systems.gnc.limits import Limits
from bench.systems.gnc.unit_test.answers import Findings, Measured, Wrong
from bench.systems.gnc.wording import quantity_word, say

_SENT = say("static.question")


def judge_static(given: Sequence[GivenValue], limits: Limits) -> Findings:
    """Each value within the limits it was asked with, a size within that of the specification too.

    Each is two quantities: the value, and by how much it is outside its limits, which is judged (limit 0).
    """
    findings = Findings()
    for check in given:
        low = -math.inf if check.low is None else check.low
        high = min(math.inf if check.high is None else check.high, limits.get(check.quantity, math.inf))
        due = _due(low, high, check.unit)
        if check.value is None or not math.isfinite(check.value):
            findings.wrong.append(
                Wrong(check.t_s, say("static.no_value", quantity=check.quantity), _SENT, due, say("nothing"))
            )
            continue
        beyond = max(low - check.value, check.value - high, 0.0)
        findings.measured.append(Measured(check.quantity, check.unit, check.value))
        findings.measured.append(Measured(f"{check.quantity}_beyond_limits", check.unit, beyond, limit=0.0))
        if beyond > 0.0:
            received = plain_quantity(check.value, check.unit)
            findings.wrong.append(Wrong(check.t_s, quantity_word(check.quantity), _SENT, due, received))
    return findings


def _due(low: float, high: float, unit: str) -> str:
    least, most = plain_quantity(low, unit), plain_quantity(high, unit)
    if math.isfinite(low) and math.isfinite(high):
        return say("static.between", least=least, most=most)
    if math.isfinite(low):
        return say("static.least", least=least)
    return say("static.most", most=most) if math.isfinite(high) else ""
