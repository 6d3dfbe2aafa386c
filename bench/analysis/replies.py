"""Replies to commands that are text: the number in one, or whether it is the text that is due."""

from __future__ import annotations

import math
import re
from decimal import Decimal

from bench.analysis.form import Document
from bench.model.units import read_quantity

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,3})?"


def number_of(reply: str, read: Document) -> tuple[float, float] | None:
    """Return the number in a reply and the value of its last digit, both in the base unit; None if there is none.

    Without ``unit`` the number is 1 if the reply is the text that is due, else 0. ``read`` is the entry "reply" of a
    value in the manifest: "pattern", "unit", "equals"; a pattern that cannot be used finds nothing.
    """
    unit, pattern = read.get("unit"), read.get("pattern")
    try:
        match = re.search(pattern or (_NUMBER if unit else r"(?s)\s*(.*?)\s*\Z"), reply)
    except re.error:
        return None
    text = "" if match is None else match[1 if match.re.groups else 0] or ""
    if unit is None:
        return float(match is not None and text == read.get("equals")), 0.0
    if not re.fullmatch(_NUMBER, text.strip()):
        return None
    number = Decimal(text.strip())
    exponent = number.as_tuple().exponent
    value, _ = read_quantity(f"{number} {unit}") or (math.nan, "")
    step, _ = read_quantity(f"1 {unit}") or (math.nan, "")
    last = step * 10.0**exponent if isinstance(exponent, int) else 0.0
    return (value, last) if math.isfinite(value) else None
