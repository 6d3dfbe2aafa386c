"""Arithmetic of twice the working precision on arrays: a number is the unevaluated sum of two doubles.

Error-free transformations give the rounding error of a sum or product as a double of its own; carrying it along makes
about 32 significant digits. Source: Dekker, Numer. Math. 18 (1971) 224; Knuth, The Art of Computer Programming 2,
section 4.2.2; Hida, Li and Bailey, 15th IEEE Symposium on Computer Arithmetic (2001) 155.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
_SPLIT = float((1 << 27) + 1)


@dataclass(frozen=True)
class Extended:
    """Numbers ``high + low``, both of one shape; ``low`` is at most half a unit in the last place of ``high``."""

    high: Array
    low: Array

    @classmethod
    def of(cls, values: ArrayLike) -> Extended:
        """Doubles as they are."""
        high = np.asarray(values, np.float64)
        return cls(high, np.zeros_like(high))

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array of numbers."""
        return self.high.shape

    @property
    def transposed(self) -> Extended:
        """The transposed matrix."""
        return Extended(self.high.T, self.low.T)

    def __getitem__(self, place: Any) -> Extended:
        return Extended(self.high[place], self.low[place])

    def __neg__(self) -> Extended:
        return Extended(-self.high, -self.low)

    def __add__(self, other: Extended) -> Extended:
        high, error = _two_sum(self.high, other.high)
        low, rest = _two_sum(self.low, other.low)
        high, error = _fast_two_sum(high, error + low)
        return Extended(*_fast_two_sum(high, error + rest))

    def __sub__(self, other: Extended) -> Extended:
        return self + (-other)

    def __mul__(self, other: Extended) -> Extended:
        high, error = _two_product(self.high, other.high)
        return Extended(*_fast_two_sum(high, error + (self.high * other.low + self.low * other.high)))

    def __truediv__(self, other: Extended) -> Extended:
        first = Extended.of(self.high / other.high)
        rest = self - first * other
        second = Extended.of(rest.high / other.high)
        rest = rest - second * other
        return first + second + Extended.of(rest.high / other.high)

    def sqrt(self) -> Extended:
        """Square roots of positive numbers: one Newton step from the double root."""
        root = Extended.of(np.sqrt(self.high))
        rest = self - root * root
        return root + Extended.of(rest.high / (2.0 * root.high))

    def sum(self) -> Extended:
        """Return sum over the first axis, in pairs of pairs."""
        total = self
        while len(total.high) > 1:
            half = len(total.high) // 2
            paired = total[:half] + total[half : 2 * half]
            total = paired if len(total.high) == 2 * half else stacked(paired, total[2 * half :])
        return total[0]


def stacked(*parts: Extended) -> Extended:
    """Return the parts one after the other along the first axis.

    Args:    parts: arrays of numbers, alike but for their first axis.
    Returns: Extended.
    Source:  plain rearrangement.
    """
    return Extended(np.concatenate([p.high for p in parts]), np.concatenate([p.low for p in parts]))


def _two_sum(a: Array, b: Array) -> tuple[Array, Array]:
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


def _fast_two_sum(a: Array, b: Array) -> tuple[Array, Array]:
    """Return the same where |a| >= |b|."""
    total = a + b
    return total, b - (total - a)


def _two_product(a: Array, b: Array) -> tuple[Array, Array]:
    product = a * b
    a_high, a_low = _split(a)
    b_high, b_low = _split(b)
    return product, ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low


def _split(a: Array) -> tuple[Array, Array]:
    """Halves of 26 bits, whose products are exact; for sizes below 1e300."""
    scaled = _SPLIT * a
    high = scaled - (scaled - a)
    return high, a - high
