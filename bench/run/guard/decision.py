"""When the guard acts: a pure function of what it was told, and of the time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from bench.model.clock import NS

Reason = Literal["gone", "silent", "limit"]


@dataclass
class Watched:
    """What the guard knows of the controller.

    ``limits`` and ``values`` are by name of the quantity with its unit (``chamber_air_degC``); ``heard_ns`` is when
    the controller was last heard of; ``silence_s`` how long it may be silent, infinite where silence says nothing.
    """

    limits: Mapping[str, float]
    silence_s: float
    heard_ns: int
    values: Mapping[str, float] = field(default_factory=dict)
    gone: bool = False  # the pipe is closed and nobody said goodbye
    dismissed: bool = False  # the controller said goodbye: the bench is its business or nobody's


@dataclass(frozen=True)
class Action:
    """What is to be done: the bench is made safe, with ``heat_off`` the heat sources go off first."""

    reason: Reason
    text: str
    heat_off: bool = False


def decide(state: Watched, now_ns: int) -> Action | None:
    """Return what the guard has to do at ``now_ns``, None if nothing.

    A limit counts as crossed where it is reached. A value that is not a number crosses nothing: a reading that fails
    is the interlocks' business.
    """
    if state.dismissed:
        return None
    for name, limit in sorted(state.limits.items()):
        value = state.values.get(name)
        if value is not None and value >= limit:
            return Action("limit", f"{name} is {value:.6g}, the hard limit is {limit:g}", heat_off=True)
    if state.gone:
        return Action("gone", "the controller ended without a goodbye")
    silent_s = (now_ns - state.heard_ns) / NS
    if silent_s >= state.silence_s:
        return Action("silent", f"no heartbeat for {silent_s:.2f} s, the limit is {state.silence_s:g} s")
    return None
