"""Values on their way to and from an instrument: full precision out, nothing but finite numbers and whole blocks in."""

from __future__ import annotations

import math
from decimal import Decimal

from bench.model.ports import Parameter

# SCPI-99 vol. 1, 7.2.1.4 and 7.2.1.5: 9.9E37 is infinity, 9.91E37 not a number; the 3458A sends 1E+38 on overload.
OVERLOAD_FROM = 9.9e37
_DIGITS = b"0123456789"


class OverloadReadingError(ValueError):
    """The reply is an instrument's sentinel for overload or "not a number", not a reading."""


def exponent_form(value: float) -> str:
    """Return every digit of a float in exponent form, ``12345678.0 -> "1.2345678E+07"``; it reads back as the same.

    Raises: ValueError if the value is not finite.
    """
    sign, digits, exponent = _decimal(value).as_tuple()
    text = "".join(map(str, digits))
    power = int(exponent) + len(text) - 1 if any(digits) else 0
    return f"{'-' if sign else ''}{text[0]}.{text[1:].rstrip('0') or '0'}E{power:+03d}"


def plain_form(value: float) -> str:
    """Return every digit of a float without an exponent, ``-10.0 -> "-10"``, for instruments that know no exponents."""
    text = f"{_decimal(value):f}"
    return (text.rstrip("0").rstrip(".") if "." in text else text) or "0"


def _decimal(value: float) -> Decimal:
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"{value!r} is not finite")
    return Decimal(repr(number)) if number else Decimal(0)


def read_number(reply: str) -> float:
    """Return a reply as a finite float.

    Raises: OverloadReadingError for overload and not-a-number sentinels; ValueError for anything that is no number.
    """
    try:
        value = float(reply)
    except ValueError:
        raise ValueError("a number is due") from None
    if "_" in reply or not math.isfinite(value):
        raise ValueError("a finite number is due")
    if abs(value) >= OVERLOAD_FROM:
        raise OverloadReadingError("the instrument reports overload or no valid reading")
    return value


def read_integer(reply: str) -> int:
    """Return a reply as an integer (a register or a number of an error). Raises: ValueError for anything else."""
    value = read_number(reply)
    if value != int(value):
        raise ValueError("an integer is due")
    return int(value)


def read_text(reply: str) -> str:
    """Return a reply as text. Raises: ValueError if it is empty."""
    if not reply:
        raise ValueError("the reply is empty")
    return reply


class CutOffError(ValueError):
    """A block that ends before its length; ``content`` is what came of it."""

    def __init__(self, content: bytes, length: int) -> None:
        super().__init__(f"{len(content)} of {length} bytes" if length else "a block that ends in its header")
        self.content = content


def block_content(reply: bytes | bytearray) -> bytes:
    """Return the bytes inside a definite-length block (IEEE Std 488.2, 8.7.9), in front of the line feed that ends it.

    It is ``#``, a digit, that many digits of length, the bytes.

    Raises: CutOffError if it is shorter than it says; ValueError if it is no such block.
    """
    if not b"#".startswith(reply[:1]):
        raise ValueError("a block is due, and it begins with '#'")
    digits = bytes(reply[1:2])
    if digits not in _DIGITS[1:]:
        raise ValueError("a block of definite length is due")
    begin = 2 + int(digits or b"9")
    text = bytes(reply[2:begin])
    if text.strip(_DIGITS):
        raise ValueError("the length of the block is no number")
    if len(reply) < begin:
        raise CutOffError(b"", 0)
    length = int(text)
    content, rest = bytes(reply[begin : begin + length]), bytes(reply[begin + length :])
    if len(content) < length:
        raise CutOffError(content, length)
    if rest.strip(b"\r\n"):
        raise ValueError("more than one block has come")
    return content


def check_argument(parameter: Parameter, value: object) -> float | int | str:
    """Return the argument if it is inside the limits its action declares; it is never clipped or rounded.

    Raises: ValueError naming the value and the limit.
    """
    if parameter.choices:
        for choice in parameter.choices:
            if not isinstance(value, bool) and value == choice:
                return choice
        raise ValueError(f"{parameter.name} {value!r} is none of {', '.join(map(str, parameter.choices))}")
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise ValueError(f"{parameter.name} {value!r} is not a finite number")
    shown = f"{parameter.name} {value!r} {parameter.dimension}".rstrip()
    if parameter.low is not None and value < parameter.low:
        raise ValueError(f"{shown} is below {parameter.low!r}")
    if parameter.high is not None and value > parameter.high:
        raise ValueError(f"{shown} is above {parameter.high!r}")
    return float(value)
