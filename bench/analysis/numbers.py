"""Printed numbers: as many digits as the uncertainty supports, units in the header, decimal point always."""

from __future__ import annotations

import math
import re
from typing import Any

_SIGNIFICANT = 2
_ROOT, _TIMES = re.compile(r"([a-zA-Z]+)\^0\.5"), re.compile(r"(?<=\w)\*(?=\w)")
_UNIT_TEXT = {unit: unit for unit in ("ppm", "ppb", "A", "nA", "V", "mV", "Hz", "s", "min", "h")}
_UNIT_TEXT |= {"degC": "°C", "degC_min": "°C/min"}


def decimals_for(uncertainty: float) -> int:
    """Return decimals that show an uncertainty with two significant digits; 0 at least, 9 at most."""
    if not math.isfinite(uncertainty) or uncertainty <= 0:
        return 3
    exponent = int(f"{uncertainty:.{_SIGNIFICANT - 1}e}".partition("e")[2])  # after rounding: 0.996 is 1.0
    return min(9, max(0, _SIGNIFICANT - 1 - exponent))


def number(value: object, decimals: int | None = None) -> str:
    """Return a number for a table cell: thin thousands, a real minus sign; a dash where there is none."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–"
    if not isinstance(value, int | float):
        return str(value)
    if decimals is not None:
        text = f"{value:z,.{decimals}f}"
    else:
        text = f"{value:,d}" if isinstance(value, int) else f"{value:.6g}"
    return text.replace(",", "\u202f").replace("-", "−")


def with_uncertainty(value: float, expanded: float | None) -> str:
    """``412.3 ± 9.9``: both to the last digit that means something; without an uncertainty the value alone.

    An uncertainty of zero is that of a count, or one that nobody stated: "± 0.000" would claim a perfect measurement.
    """
    if expanded is None or not math.isfinite(expanded) or expanded == 0.0:
        return number(value)
    places = decimals_for(expanded)
    return f"{number(value, places)} ± {number(expanded, places)}"


def limits_text(limits: tuple[float, float] | None, scale: float = 1.0) -> str:
    """Return limits times ``scale`` as they are printed: ``± 5``, ``4.9 to 5.1``, ``≥ 4.9``; a dash where are none."""
    if limits is None:
        return number(None)
    low, high = (scale * limit for limit in limits)
    if low == -high:
        return f"± {number(high)}" if high else "0"
    if math.isinf(low):
        return f"≤ {number(high)}"
    return f"≥ {number(low)}" if math.isinf(high) else f"{number(low)} to {number(high)}"


def unit_text(unit: str) -> str:
    """Return a unit as it is printed: degC becomes °C, 1e-6 notation stays."""
    text = _ROOT.sub(r"√\1", _TIMES.sub("·", unit))
    return text.replace("degC3", "°C³").replace("degC2", "°C²").replace("degC^2", "°C²").replace("degC", "°C")


def header(key: str) -> str:
    """Return a field name as a column header: ``std_uncertainty_ppm`` becomes ``std uncertainty / ppm``."""
    words = key.split("_")
    for length in (2, 1):
        unit = "_".join(words[-length:])
        if len(words) > length and unit in _UNIT_TEXT:
            return f"{' '.join(words[:-length])} / {_UNIT_TEXT[unit]}"
    return key.replace("_", " ")


def cell(value: Any) -> str:
    """Return any plain value of a document as the text of a table cell."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return ", ".join(cell(entry) for entry in value)
    if isinstance(value, dict):
        return ", ".join(f"{header(str(key))} {cell(entry)}" for key, entry in value.items())
    return number(value)
