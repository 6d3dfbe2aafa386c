"""Figures and tables of an analysis before any drawing: plain numbers and words, with their axes.

Printed numbers have as many digits as the uncertainty supports, units in the header, and a decimal point always.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Any, Literal

import numpy as np

from bench.model.texts import Sayings

Style = Literal["line", "points", "band", "image"]
_DRAWN = 600  # points of a thinned curve


@dataclass(frozen=True)
class Series:
    """One curve, cloud of points, band or image.

    ``low``, ``high``: ends of the interval of each point; of a band, which has no ``y``.   ``z`` (y, x): of an image,
    whose ``x`` and ``y`` span its axes.
    """

    label: str
    x: list[float]
    y: list[float]
    style: Style
    low: list[float] | None = None
    high: list[float] | None = None
    z: list[list[float]] | None = None


@dataclass(frozen=True)
class Figure:
    """A figure with its axes; those of one ``group`` are panels of one picture, ``equal``: both axes to one scale."""

    title: str
    caption: str
    x_label: str
    y_label: str
    series: Sequence[Series]
    group: str = ""
    x_log: bool = False
    y_log: bool = False
    equal: bool = False


def series(label: str, x: Any, y: Any, style: Style = "line", *, low: Any = None, high: Any = None) -> Series:
    """Return every value as drawn; ``low`` and ``high`` are the interval of each point."""
    return Series(label, _plain(x), _plain(y), style, *(None if end is None else _plain(end) for end in (low, high)))


def curve(label: str, x: Any, y: Any, style: Style = "line") -> Series:
    """Return a series thinned to what can be seen."""
    step = max(1, len(x) // _DRAWN)
    return series(label, x[::step], y[::step], style)


def band(label: str, x: Any, low: Any, high: Any) -> Series:
    """Return the area between two curves."""
    return series(label, x, [], "band", low=low, high=high)


def picture(x: Any, y: Any, z: Any) -> Series:
    """Return an image, ``z`` (y, x), over the span of its axes."""
    return Series("", _span(x), _span(y), "image", z=_plain(z))


def _span(axis: Any) -> list[float]:
    return [float(axis[0]), float(axis[-1])]


def _plain(values: Any) -> Any:
    return np.asarray(values).tolist()


@dataclass(frozen=True)
class Table:
    """A table with its caption; ``prose``: its cells are words, ``lead``: it is read first."""

    title: str
    caption: str
    headers: Sequence[str]
    rows: Sequence[Sequence[Any]]
    prose: bool = False
    lead: bool = False


def worded_table(
    say: Sayings,
    name: str,
    heads: Sequence[str],
    rows: Sequence[Sequence[Any]],
    more: Sequence[str] = (),
    /,
    *,
    prose: bool = False,
    lead: bool = False,
    **fields: object,
) -> Table:
    """Return a table with its title, caption and heads in the words of a catalogue.

    Args: heads: names of the columns, as ``say.heads`` takes them.   more: heads in words, of the columns behind those.
          fields: of all these texts.
    """
    title, caption = say(f"{name}.title", **fields), say(f"{name}.caption", **fields)
    return Table(title, caption, [*say.heads(name, *heads, **fields), *more], rows, prose, lead)


def worded_figure(
    say: Callable[..., str],
    name: str,
    axes: tuple[str, str],
    parts: Sequence[Series],
    /,
    *,
    group: str = "",
    logarithmic: str = "",
    equal: bool = False,
    **fields: object,
) -> Figure:
    """Return a figure with its title and caption in the words of a catalogue, and the axes by their keys there.

    ``logarithmic``: "x", "y" or "xy".   ``fields``: of all four texts.
    """
    title, caption, x, y = (say(key, **fields) for key in (f"{name}.title", f"{name}.caption", *axes))
    return Figure(title, caption, x, y, parts, group, "x" in logarithmic, "y" in logarithmic, equal)


_SIGNIFICANT = 2
_MOST_DECIMALS = 7  # of a value with its uncertainty; what needs more is printed with a power of ten
_LONG, _ENDLESS = 1e6, 1e15  # from here on numbers without decimals; beyond, powers of ten
_RESOLUTION = 1e-13  # of a value
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_ROOT, _TIMES = re.compile(r"([a-zA-Z]+)\^0\.5|sqrt\((\w+)\)"), re.compile(r"(?<=\w)\*(?=\w)")
_MICRO = re.compile(r"(?<![^\s,/])(?<![a-z] )u(?=(?:g|s|m|A|V|gauss)\b)")  # "us" between words is none
_OHM = re.compile(r"\b([mkMG]?)ohm\b")
_POWER = re.compile(r"(?<![\w.])([0-9](?:\.[0-9]+)?)e([+-]?[0-9]{1,2})(?![\w.])")
_PER_HOUR2 = re.compile(r"/h2\b")
_UNIT_TEXT = {
    unit: unit for unit in ("ppm", "ppb", "A", "nA", "V", "mV", "Hz", "s", "ms", "min", "h", "m", "deg", "ohm")
}
_UNIT_TEXT |= {"degC": "°C", "degC_min": "°C/min"}


def decimals_for(uncertainty: float) -> int:
    """Return decimals that show an uncertainty with two significant digits, 12 at most; -1 means tens, -2 hundreds."""
    if not math.isfinite(uncertainty) or uncertainty <= 0:
        return 3
    return min(12, _SIGNIFICANT - 1 - _exponent(uncertainty))


def _exponent(size: float) -> int:
    """Return the power of ten of the first of two significant digits, after rounding: 0.996 is 1.0."""
    return int(f"{size:.{_SIGNIFICANT - 1}e}".partition("e")[2])


def number(value: object, decimals: int | None = None) -> str:
    """Return a number for a table cell: thin thousands, a real minus sign; a dash where there is none.

    ``decimals``: places behind the point; -1 rounds to tens.
    """
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–"
    if not isinstance(value, int | float):
        return str(value)
    if decimals is not None:
        text = f"{round(value, min(0, decimals)) if decimals < 0 else value:z,.{max(0, decimals)}f}"
    elif isinstance(value, int) or _LONG <= abs(value) < _ENDLESS:
        text = f"{value:,.0f}"
    else:
        text = f"{value:.6g}"
    figures, _, exponent = text.partition("e")
    power = f"·10{str(int(exponent)).translate(_RAISED)}" if exponent else ""
    return figures.replace(",", "\u202f").replace("-", "−") + power


def significant(value: float) -> str:
    """Return an uncertainty alone, or a part of one, with two significant digits."""
    if not value:
        return "0"
    places = decimals_for(abs(value))
    if places <= _MOST_DECIMALS:
        return number(value, places)
    figures, _, exponent = f"{value:.{_SIGNIFICANT - 1}e}".partition("e")
    return f"{figures.replace('-', '−')}·10{str(int(exponent)).translate(_RAISED)}"


def with_uncertainty(value: float, expanded: float | None) -> str:
    """``412.3 ± 9.9``: both to the last digit that means something; without an uncertainty the value alone.

    What would be mostly zeros has a power of ten: ``(0.0 ± 1.7)·10⁵``.
    An uncertainty of zero is that of a count, or one that nobody stated: "± 0.000" would claim a perfect measurement.
    One below the resolution of the value is none either.
    """
    if expanded is None or not (math.isfinite(expanded) and math.isfinite(value)):
        return number(value)
    if expanded <= _RESOLUTION * abs(value):
        return number(value)
    places, power = _SIGNIFICANT - 1 - _exponent(expanded), _exponent(max(abs(value), expanded))
    if -4 < places <= _MOST_DECIMALS or (places > 0 and power > -3):
        return f"{number(value, places)} ± {number(expanded, places)}"
    scaled = (f"{Decimal(part).scaleb(-power):z.{places + power}f}" for part in (value, expanded))
    return f"({' ± '.join(scaled).replace('-', '−')})·10{str(power).translate(_RAISED)}"


def value_and_uncertainty(value: float, expanded: float) -> tuple[str, str]:
    """Return both for columns of their own: the uncertainty with two significant digits, the value to its last one.

    Without an uncertainty (zero) the value has the digits of a number alone.
    """
    return number(value, decimals_for(expanded) if expanded > 0 else None), significant(expanded)


def limits_text(
    limits: tuple[float, float] | None, scale: float = 1.0, span: str = "{low} to {high}", *, size: bool = False
) -> str:
    """Return limits times ``scale`` as they are printed: ``± 5``, ``4.9 to 5.1``, ``≥ 4.9``; a dash where are none.

    ``span``: how the reader's language says the second.   ``size``: of what is never negative: the upper one alone.
    """
    if limits is None:
        return number(None)
    low, high = (scale * limit for limit in limits)
    if low == -high and not (size and high):
        return f"± {number(high)}" if high else "0"
    if math.isinf(low) or (size and low < 0.0):
        return f"≤ {number(high)}"
    return f"≥ {number(low)}" if math.isinf(high) else span.format(low=number(low), high=number(high))


def unit_text(unit: str) -> str:
    """Return a unit, or a text with units, as it is printed: degC becomes °C, ug µg, 3e-05 a power of ten."""
    text = _ROOT.sub(lambda match: f"√{match[1] or match[2]}", _TIMES.sub("·", _PER_HOUR2.sub("/h²", unit)))
    text = _OHM.sub(r"\1Ω", _POWER.sub(_ten, _MICRO.sub("µ", text)).replace("m/s2", "m/s²"))
    return text.replace("degC3", "°C³").replace("degC2", "°C²").replace("degC^2", "°C²").replace("degC", "°C")


def _ten(match: re.Match[str]) -> str:
    power = f"10{str(int(match[2])).translate(_RAISED)}"
    return power if match[1] == "1" else f"{match[1]}·{power}"


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
