"""Units and numbers in the D-SI format: ``ppm/degC`` becomes ``\\kelvin\\tothe{-1}`` and six places to the right.

Source: D-SI 2.1.0 (SI_Format.xsd and its list of units). Neither ppm nor per cent is among its units: such values
are given in ``\\one`` with the power of ten in the number. A difference of temperatures is given in kelvin, exactly the
same number; ``\\degreecelsius`` is for temperatures only, because a reader may add 273.15 to what is in that unit.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from bench.model.errors import InputError

CELSIUS = r"\degreecelsius"
ONE = r"\one"
_POWERS = {"ppm": -6, "ppb": -9, "%": -2, "1": 0}
_NAMES = {
    "A": "ampere", "V": "volt", "ohm": "ohm", "W": "watt", "F": "farad", "C": "coulomb", "Hz": "hertz", "s": "second",
    "min": "minute", "h": "hour", "degC": "kelvin", "K": "kelvin", "deg": "degree",
    "arcmin": "arcminute", "arcsec": "arcsecond", "m": "metre",
}  # fmt: skip
_PREFIXES = {"p": "pico", "n": "nano", "u": "micro", "m": "milli", "k": "kilo", "M": "mega", "G": "giga"}
_PREFIXED = ("A", "V", "ohm", "W", "F", "C", "Hz", "s")
_PART = re.compile(r"([*/]?)([A-Za-z]+|%|1)(?:\^?(\d+(?:\.\d+)?))?")
_CONDITIONS = {"hours": "h", "channel": "1", "repeat": "1", "order": "1"}


@dataclass(frozen=True)
class SiUnit:
    """A unit in D-SI and the power of ten that a number in the bench's own unit takes with it."""

    token: str
    power: int = 0


def si_unit(text: str) -> SiUnit:
    """Return D-SI form of a unit of results.json, such as ``A/degC2`` or ``A*s^0.5``; degC is a difference here.

    Raises: InputError B-DCC-007 for a unit without one.
    """
    tokens, power, at = "", 0.0, 0
    while at < len(text):
        match = _PART.match(text, at)
        if match is None or (at > 0) != bool(match[1]):
            raise _unknown(text)
        exponent = float(match[3] or 1) * (-1 if match[1] == "/" else 1)
        if match[2] in _POWERS:
            power += _POWERS[match[2]] * exponent
        else:
            tokens += _token(match[2], text) + ("" if exponent == 1 else f"\\tothe{{{exponent:g}}}")
        at = match.end()
    if at == 0 or power != int(power):
        raise _unknown(text)
    return SiUnit(tokens or ONE, int(power))


def estimate_unit(quantity: str, unit: str) -> SiUnit:
    """Return D-SI form of the unit of an estimate; a quantity that is named a temperature is one. Raises: B-DCC-007."""
    return SiUnit(CELSIUS) if unit == "degC" and quantity.endswith("temperature") else si_unit(unit)


def condition_unit(name: str) -> SiUnit | None:
    """Return unit that the name of a condition carries (``temperature_degC``); None if it carries none."""
    unit = _CONDITIONS.get(name, name.rpartition("_")[2] if "_" in name else "")
    if unit == "degC" and "temperature" in name:
        return SiUnit(CELSIUS)
    try:
        return si_unit(unit)
    except InputError:
        return None


def si_number(value: float, power: int = 0) -> str:
    """Return every digit of a number, times ten to a power, exactly: the digits stay, the exponent moves.

    Raises: ValueError if the number is not finite.
    """
    if not math.isfinite(value):
        raise ValueError(f"{value} is not a number")
    mantissa, _, exponent = (str(value) if isinstance(value, int) else repr(float(value))).partition("e")
    moved = int(exponent or 0) + power
    return f"{mantissa}e{moved}" if moved else mantissa


def _token(name: str, text: str) -> str:
    if name in _NAMES:
        return f"\\{_NAMES[name]}"
    prefix, base = name[:1], name[1:]
    if prefix in _PREFIXES and base in _PREFIXED:
        return f"\\{_PREFIXES[prefix]}\\{_NAMES[base]}"
    raise _unknown(text)


def _unknown(text: str) -> InputError:
    return InputError(
        "B-DCC-007",
        f"the unit {text!r} of an estimate has no form in D-SI that this software knows",
        next_step="give the quantity in SI units in the sequence or mapping it comes from",
    )
