"""What the machine code may use: the instructions of x86-64-v3 with carry-less products, or of every x86-64."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

_NEEDED = {"abm", "avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "movbe", "pclmulqdq"}
VARIABLE = "INERTIAL_BENCH_KERNEL_VARIANT"


class Variant(NamedTuple):
    """Name, name of the processor and of its features as the compiler knows them."""

    name: str
    processor: str
    features: str


FOLDING = Variant("v3", "x86-64-v3", "+pclmul")
PLAIN = Variant("plain", "x86-64", "")


def variant_here() -> Variant:
    """Return the variant for the processor of this machine."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return PLAIN
    flags = next((line for line in lines if line.startswith("flags")), "").split()
    return FOLDING if set(flags) >= _NEEDED else PLAIN


def folds() -> bool:
    """Return whether what is compiled in this process may use carry-less products."""
    return os.environ.get(VARIABLE, FOLDING.name) == FOLDING.name
