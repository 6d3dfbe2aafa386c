"""The shortest campaign that reaches an uncertainty: what is common to all analyses; each says what is free in its own.

Decision: docs/method-uncertainty.md.
"""

from bench.design.edits import SequenceText
from bench.design.shortest import (
    LEAST_POWER,
    Design,
    Given,
    Key,
    Power,
    Problem,
    Target,
    best_within,
    blind,
    default_targets,
    descended,
    designed,
    reached,
    read_target,
    refuse_below_floor,
    slot_s,
    weakest,
)

__all__ = [
    "LEAST_POWER",
    "Design",
    "Given",
    "Key",
    "Power",
    "Problem",
    "SequenceText",
    "Target",
    "best_within",
    "blind",
    "default_targets",
    "descended",
    "designed",
    "reached",
    "read_target",
    "refuse_below_floor",
    "slot_s",
    "weakest",
]
