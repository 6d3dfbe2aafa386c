"""Quantities with units: ``"10 mA"`` -> 0.01 (ampere). A bare number where a unit is due is an error."""

from __future__ import annotations

import math
import re
from decimal import Decimal, InvalidOperation
from functools import lru_cache
from typing import Any

from pydantic import BeforeValidator, WithJsonSchema

_PREFIX = {"p": -12, "n": -9, "u": -6, "m": -3, "": 0, "k": 3, "M": 6, "G": 9}
_PREFIXED = ("A", "V", "Hz", "s", "C", "ohm", "W", "F")
_BASES = (  # beside them, without prefixes
    "degC", "degC/min", "1", "deg", "deg/s", "deg/s2", "deg/sqrt(s)", "g/sqrt(Hz)", "g", "m/s", "m/s2", "gauss", "m",
    "A/degC", "1/degC", "1/degC2", "1/degC3",
)  # fmt: skip

# unit text -> (dimension, factor to the base unit of that dimension)
_UNITS: dict[str, tuple[str, Decimal]] = {
    f"{prefix}{base}": (base, Decimal(1).scaleb(exponent)) for base in _PREFIXED for prefix, exponent in _PREFIX.items()
}
_UNITS |= {base: (base, Decimal(1)) for base in _BASES}
_UNITS |= {
    "min": ("s", Decimal(60)),
    "h": ("s", Decimal(3600)),
    "d": ("s", Decimal(86400)),
    "ppm": ("1", Decimal("1e-6")),
    "%": ("1", Decimal("0.01")),
    "arcmin": ("deg", Decimal(1) / 60),
    "arcsec": ("deg", Decimal(1) / 3600),
    "rad": ("deg", Decimal("57.29577951308232087679815481")),
    "deg/h": ("deg/s", Decimal(1) / 3600),
    "rad/s": ("deg/s", Decimal("57.29577951308232087679815481")),
    "deg/s/sqrt(Hz)": ("deg/sqrt(s)", Decimal(1)),
    "deg/sqrt(h)": ("deg/sqrt(s)", Decimal(1) / 60),
    "deg/h/sqrt(Hz)": ("deg/sqrt(s)", Decimal(1) / 3600),
    "mg/sqrt(Hz)": ("g/sqrt(Hz)", Decimal("1e-3")),
    "ug/sqrt(Hz)": ("g/sqrt(Hz)", Decimal("1e-6")),
    "mg": ("g", Decimal("1e-3")),
    "ug": ("g", Decimal("1e-6")),
    "mgauss": ("gauss", Decimal("1e-3")),
    "ugauss": ("gauss", Decimal("1e-6")),
    "T": ("gauss", Decimal("1e4")),
    "mT": ("gauss", Decimal(10)),
    "uT": ("gauss", Decimal("1e-2")),
    "nT": ("gauss", Decimal("1e-5")),
    "cm": ("m", Decimal("1e-2")),
    "mm": ("m", Decimal("1e-3")),
    "nA/degC": ("A/degC", Decimal("1e-9")),
    "ppm/degC": ("1/degC", Decimal("1e-6")),
    "ppm/degC2": ("1/degC2", Decimal("1e-6")),
    "ppm/degC3": ("1/degC3", Decimal("1e-6")),
}

# Symbols of the SI brochure, in each sign that keyboards have for them, and what is written in their place.
_SYMBOLS = {
    "\N{MICRO SIGN}": "u", "\N{GREEK SMALL LETTER MU}": "u",
    "\N{GREEK CAPITAL LETTER OMEGA}": "ohm", "\N{OHM SIGN}": "ohm",
    "\N{DEGREE SIGN}C": "degC", "\N{DEGREE CELSIUS}": "degC", "\N{DEGREE SIGN}": "deg", "\N{SUPERSCRIPT TWO}": "2",
}  # fmt: skip
_WRITTEN_OUT = {
    "ohms": "ohm", "sec": "s", "secs": "s", "second": "s", "seconds": "s", "minute": "min", "minutes": "min",
    "mins": "min", "hour": "h", "hours": "h", "hr": "h", "volt": "V", "volts": "V", "amp": "A", "amps": "A",
    "ampere": "A", "hertz": "Hz", "celsius": "degC", "percent": "%", "degree": "deg", "degrees": "deg",
    "msec": "ms", "usec": "us", "gs": "gauss", "deg/sec": "deg/s", "deg/hr": "deg/h", "dps": "deg/s",
    "m/s^2": "m/s2", "m/s**2": "m/s2", "deg/s^2": "deg/s2", "degc/minute": "degC/min", "k/min": "degC/min",
}  # fmt: skip
_SLIPS = str.maketrans({",": ".", "\N{MINUS SIGN}": "-", "\N{EN DASH}": "-"})  # of other keyboards and word processors
_QUANTITY = re.compile(r"\s*([-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d{1,3})?)\s*(\S*)\s*")


def parse_quantity(text: object, dimension: str) -> float:
    """Read a quantity such as ``"30 uA"`` and return it in the base unit of ``dimension``.

    Args:
        text: the quantity as text; anything else is refused.
        dimension: base unit that is due: ``A V Hz s C ohm W F degC degC/min 1 deg deg/s
            deg/s2 deg/sqrt(s) g g/sqrt(Hz) m/s m/s2 gauss m A/degC 1/degC 1/degC2``.
    Returns:
        The nearest float to the decimal value in the base unit (28 digits are kept on the way).
    Raises:
        ValueError: no number, no unit, unknown unit, unit of another dimension, or not finite.
    """
    if not isinstance(text, str):
        raise ValueError(f"{text!r} has no unit; write {_due(dimension)}, for example {_example(dimension)}")
    match = _QUANTITY.fullmatch(text)
    if match is None:
        advice = likely(text, dimension) or f"; write a number and a unit, for example {_example(dimension)}"
        raise ValueError(f"{text!r} is not a quantity{advice}")
    number, unit = match[1], _plain(match[2])
    if unit not in _UNITS:
        what = f"has the unknown unit {match[2]!r}" if unit else "has no unit"
        advice = likely(text, dimension) or f"; use one of: {', '.join(_units_of(dimension))}"
        raise ValueError(f"{text!r} {what}{advice}")
    stated, factor = _UNITS[unit]
    if stated != dimension:
        what = "a ratio" if stated == "1" else f"in {stated}"
        raise ValueError(f"{text!r} is {what}; {_due(dimension)} is due{likely(text, dimension)}")
    try:
        value = float(Decimal(number) * factor)
    except (InvalidOperation, OverflowError) as error:
        raise ValueError(f"{text!r} is out of range") from error
    if not math.isfinite(value):
        raise ValueError(f"{text!r} is not finite")
    return value


def likely(text: object, dimension: str = "") -> str:
    """Return ``; did you mean '10 mA'?`` for a quantity with an unknown unit or one of another dimension, or "".

    A comma is meant as a point, a typographic minus as one of the keyboard.

    Without ``dimension`` any will do.
    """
    plain = text.translate(_SLIPS) if isinstance(text, str) else ""
    match = _QUANTITY.fullmatch(plain)
    if match is None or not match[2]:
        return ""
    unit, known = _plain(match[2]), _units_of(dimension)
    close = (unit if plain != text else "") if unit in known else _close(unit, known)
    return f"; did you mean '{match[1]} {close}'?" if close else ""


def units_by_dimension() -> dict[str, list[str]]:
    """Return all units by the base unit that they count in."""
    return {dimension: _units_of(dimension) for dimension, _ in _UNITS.values()}


def _units_of(dimension: str) -> list[str]:
    return sorted(name for name, (of, _) in _UNITS.items() if dimension in (of, ""))


def _plain(unit: str) -> str:
    """Return a unit in the plain letters of a YAML file; ``kΩ`` is ``kohm``."""
    if not unit.isascii():
        for symbol, plain in _SYMBOLS.items():
            unit = unit.replace(symbol, plain)
    return unit


def _close(unit: str, known: list[str]) -> str:
    """Return the known unit that somebody meant who took the wrong case, wrote it out or forgot the degree; or ""."""
    folded = _WRITTEN_OUT.get(unit.casefold(), unit).casefold()
    alike = [name for name in known if name.casefold() == folded]
    if alike:
        return min(alike, key=lambda name: (sum(a != b for a, b in zip(name, unit, strict=False)), name))
    of_degrees = f"deg{unit}"  # "C" for "degC"
    return of_degrees if of_degrees in known else ""


def _due(dimension: str) -> str:
    return "a ratio" if dimension == "1" else f"a quantity in {dimension}"


def _example(dimension: str) -> str:
    return "'10 ppm'" if dimension == "1" else f"'10 {dimension}'"


@lru_cache(maxsize=4096)
def read_quantity(text: str) -> tuple[float, str] | None:
    """Read a quantity of any dimension: (value in the base unit, dimension), or None if the text is no quantity.

    A number too large for a float is no quantity.
    """
    match = _QUANTITY.fullmatch(text)
    if match is None or (unit := _plain(match[2])) not in _UNITS:
        return None
    dimension = _UNITS[unit][0]
    try:
        return parse_quantity(text, dimension), dimension
    except ValueError:
        return None


def read_stated(text: object, example: str) -> tuple[float, str]:
    """Read a quantity of any dimension as ``read_quantity``. Raises: ValueError, with an example of what is due."""
    quantity = read_quantity(text) if isinstance(text, str) else None
    if quantity is None:
        raise ValueError(f"{text!r} is not a quantity with its unit, for example '{example}'{likely(text)}")
    return quantity


def dimension_of(unit: str) -> str:
    """Return the dimension of a unit, which is its base unit. Raises: ValueError naming the unit that was meant."""
    known = read_quantity(f"1 {unit}")
    if known is None:
        close = _close(_plain(unit), _units_of("")) if unit else ""
        advice = f"did you mean {close!r}?" if close else f"use one of: {', '.join(_units_of(''))}"
        raise ValueError(f"{unit!r} is no unit; {advice}")
    return known[1]


def known_unit(text: str) -> str:
    """Return the text of a unit that is known. Raises: ValueError naming the unit that was meant."""
    dimension_of(text)
    return text


def finite(value: float) -> float | None:
    """Return a number, None for one that is not known: events and other JSON hold no NaN."""
    return value if math.isfinite(value) else None


def quantity(dimension: str, low: float | None = None, high: float | None = None) -> Any:
    """Pydantic annotation: text with a unit of ``dimension`` to a float in the base unit, inside [low, high].

    Use as ``Annotated[float, *quantity("A")]``.
    """

    unit = "" if dimension == "1" else dimension

    def read(value: object) -> float:
        number = parse_quantity(value, dimension)
        if low is not None and number < low:
            raise ValueError(f"{value!r} is below the limit {low:g} {unit}".rstrip())
        if high is not None and number > high:
            raise ValueError(f"{value!r} is above the limit {high:g} {unit}".rstrip())
        return number

    schema = {
        "type": "string",
        "pattern": r"^\s*[-+]?[0-9.]+([eE][-+]?\d+)?\s*\S+\s*$",
        "description": f"in {dimension}",
        "x-unit": dimension,
    }
    return BeforeValidator(read), WithJsonSchema(schema)


def plain_quantity(value: float, unit: str) -> str:
    """Return it as a person writes it: ``0.5 ohm``, ``1 Mohm``, ``2 h``; a prefix only for very large or small.

    A ratio is written in percent.
    """
    if unit == "1":
        return f"{100.0 * value:g} %"
    if unit == "s" and abs(value) >= 60:
        return f"{value / 3600:g} h" if abs(value) >= 3600 else f"{value / 60:g} min"
    return f"{value:g} {unit}" if 1e-3 <= abs(value) < 1e3 else format_quantity(value, unit)


def plain_unit(unit: str) -> str:
    """Return the unit that a person is asked for: percent for a ratio."""
    return "%" if unit == "1" else unit


def format_quantity(value: float, unit: str, digits: int = 6) -> str:
    """Print a value with an SI prefix: ``format_quantity(3e-5, "A") == "30 uA"``."""
    if value == 0 or not math.isfinite(value) or unit not in _PREFIXED:
        return f"{value:.{digits}g} {unit}"
    exponent, prefix = prefix_of(value)
    return f"{value / 10.0**exponent:.{digits}g} {prefix}{unit}"


def prefix_of(value: float) -> tuple[int, str]:
    """Return exponent of ten and name of the SI prefix in which a value is 1 or more; (0, "") below all of them."""
    largest_first = reversed(_PREFIX.items())
    fitting = ((exponent, prefix) for prefix, exponent in largest_first if abs(value) >= 10.0**exponent * (1 - 1e-12))
    return next(fitting, (0, ""))


def with_prefix(size: float, unit: str) -> tuple[float, str]:
    """Return factor and unit for printing values of this size; a time is never in more than seconds."""
    if unit not in _PREFIXED:
        return 1.0, unit
    exponent, prefix = prefix_of(size)
    return (1.0, unit) if unit == "s" and exponent > 0 else (10.0**-exponent, f"{prefix}{unit}")


def hours(seconds: float) -> str:
    """Return seconds as ``H:MM:SS``."""
    whole = round(seconds)
    return f"{whole // 3600}:{whole % 3600 // 60:02d}:{whole % 60:02d}"
