"""What the drivers of the 34401A and the 34970A share about resistance: the ranges, and how they read back."""

from __future__ import annotations

from instruments.values import read_number

RANGES_OHM = (1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8)


def is_range(configuration: str, range_ohm: float) -> bool:
    """Return whether a ``CONF?`` reply such as ``"FRES +1.000000E+02,+3.000000E-04"`` is four wires on this range."""
    name, _, parameters = configuration.strip('"').upper().partition(" ")
    return name == "FRES" and read_number(parameters.partition(",")[0]) == range_ohm
