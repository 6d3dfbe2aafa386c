"""A step of a plan with usual arguments, for tests that name only those they are about."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bench.plan import Step
from bench.plan.step_kinds import step_of


def planned(
    kind: str, number: int = 0, *, phase: str = "campaign", at_s: float = 0.0, duration_s: float = 0.0, role: str = "",
    name: str = "", conditions: Mapping[str, Any] | None = None, where: str = "", **arguments: Any,
) -> Step:  # fmt: skip
    """Return a step; arguments are named as in a plan file."""
    usual: dict[str, dict[str, Any]] = {
        "settle": {"bus_s": 0.0},
        "record": {
            "seconds": duration_s, "retry": 0, "max_lost": 0.0, "purpose": "measurement", "retry_step": number,
        },
        "soak": {
            "temperature": 23.0, "ramp": 1.0, "slot": duration_s, "within": 1.0, "for": 60.0, "sensor": "unit",
            "late": "hold", "hold_limit": duration_s,
        },
        "prompt": {"text": "", "confirm": "operator"},
        "unit": {"payload": ()},
    }  # fmt: skip
    return step_of(
        {
            "number": number, "phase": phase, "kind": kind, "at_s": at_s, "duration_s": duration_s, "role": role,
            "name": name, "arguments": {**usual.get(kind, {}), **arguments}, "conditions": conditions or {},
            "where": where or f"test.yaml:{number + 1}:1",
        }
    )  # fmt: skip
