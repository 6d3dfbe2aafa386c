"""Roll angle from the magnetometer as the module's processor computes it, paper 001 section 4.2 2).

Equations (7) to (9) with what (9) lacks: x is divided by cos alpha, after zero and gain. The angle is that of a
right-handed turn about z, from the position in which the field across z lies along +x.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

LOWEST, HIGHEST = -32_768, 32_767


@dataclass(frozen=True)
class Correction:
    """Zero by axis in counts, gain of y against x, sine of the angle by which the axes are not square."""

    offset: tuple[int, int, int] = (0, 0, 0)
    gain: float = 1.0
    sin_alpha: float = 0.0

    def roll(self, counts: Sequence[int]) -> tuple[float, tuple[int, int, int]]:
        """Roll angle in degrees, -180 to 180, and the corrected field in counts."""
        x_out, y_out, z = (int(value) - zero for value, zero in zip(counts, self.offset, strict=True))
        y = y_out * self.gain
        x = (x_out - y * self.sin_alpha) / math.sqrt(1.0 - self.sin_alpha**2)
        return math.degrees(math.atan2(-y, x)), (_count(x), _count(y), _count(z))


def _count(value: float) -> int:
    return min(max(round(value), LOWEST), HIGHEST)
