"""Units and numbers in the D-SI format: ``ppm/degC`` becomes ``\\kelvin\\tothe{-1}`` and six places to the right.

Source: D-SI 2.1.0 (SI_Format.xsd and its list of units). Neither ppm nor per cent is among its units: such values
are given in ``\\one`` with the power of ten in the number. A difference of temperatures is given in kelvin, exactly the
same number; ``\\degreecelsius`` is for temperatures only, because a reader may add 273.15 to what is in that unit.
Standard gravity (9.80665 m/s2, 3rd CGPM, 1901) and the gauss (1e-4 T) are no units of it either; both are exact in SI.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from decimal import Decimal

from bench.model.errors import InputError

CELSIUS = r"\degreecelsius"
ONE = r"\one"
_POWERS = {"ppm": -6, "ppb": -9, "%": -2, "1": 0, "gauss": -4}
_GRAVITY = Decimal("9.80665")
_IN_SI: dict[str, dict[str, int]] = {"ppm": {}, "ppb": {}, "%": {}, "1": {}, "g": {"m": 1, "s": -2}, "gauss": {"T": 1}}
_NAMES = {
    "A": "ampere", "V": "volt", "ohm": "ohm", "W": "watt", "F": "farad", "C": "coulomb", "Hz": "hertz", "s": "second",
    "min": "minute", "h": "hour", "degC": "kelvin", "K": "kelvin", "deg": "degree",
    "arcmin": "arcminute", "arcsec": "arcsecond", "m": "metre", "T": "tesla",
}  # fmt: skip
_PREFIXES = {"p": "pico", "n": "nano", "u": "micro", "m": "milli", "k": "kilo", "M": "mega", "G": "giga"}
_PREFIXED = ("A", "V", "ohm", "W", "F", "C", "Hz", "s")
_PART = re.compile(r"([*/]?)([A-Za-z]+|%|1)(?:\^?(\d+(?:\.\d+)?))?")
_CONDITIONS = {"hours": "h", "channel": "1", "repeat": "1", "order": "1"}


@dataclass(frozen=True)
class SiUnit:
    """A unit in D-SI, and the power of ten and the factor that a number in the bench's own unit takes with it."""

    token: str
    power: int = 0
    factor: Decimal = Decimal(1)

    @property
    def moved(self) -> str:
        """Return what a number is multiplied by, in words; "" for 1."""
        times = [str(self.factor)] * (self.factor != 1) + [f"1e{self.power}"] * (self.power != 0)
        return " times ".join(times)


PLAIN = SiUnit(ONE)


def si_unit(text: str) -> SiUnit:
    """Return D-SI form of a unit of results.json, such as ``A/degC2`` or ``A*s^0.5``; degC is a difference here.

    Raises: InputError B-DCC-007 for a unit without one.
    """
    units: dict[str, float] = {}
    power, gravities, at, written = 0.0, 0.0, 0, re.sub(r"sqrt\((\w+)\)", r"\1^0.5", text)
    while at < len(written):
        match = _PART.match(written, at)
        if match is None or (at > 0) != bool(match[1]):
            raise _unknown(text)
        exponent = float(match[3] or 1) * (-1 if match[1] == "/" else 1)
        prefix, unit = (match[2][0], match[2][1:]) if match[2][1:] in ("g", "gauss") else ("", match[2])
        power += ({"": 0, "m": -3, "u": -6}.get(prefix, math.nan) + _POWERS.get(unit, 0)) * exponent
        gravities += exponent * (unit == "g")
        for name, count in _IN_SI.get(unit, {unit: 1}).items():
            units[name] = units.get(name, 0.0) + count * exponent
        at = match.end()
    if at == 0 or not power.is_integer() or gravities not in (0.0, 1.0):
        raise _unknown(text)
    tokens = [_token(name, text) + ("" if part == 1 else f"\\tothe{{{part:g}}}") for name, part in units.items()]
    return SiUnit("".join(tokens) or ONE, int(power), _GRAVITY ** int(gravities))


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


def si_number(value: float, unit: SiUnit = PLAIN) -> str:
    """Return every digit of a number in a unit of D-SI, exactly: for a power of ten only the exponent moves.

    Raises: ValueError if the number is not finite.
    """
    if not math.isfinite(value):
        raise ValueError(f"{value} is not a number")
    text = str(value) if isinstance(value, int) else repr(float(value))
    if unit.factor != 1:
        text = str(Decimal(text) * unit.factor).lower()
    mantissa, _, exponent = text.partition("e")
    moved = int(exponent or 0) + unit.power
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
