"""When a run will be over, as a range.

Planned time is waited out, so a run is never sooner than its plan plus the slip so far: that is ``earliest`` and, since
most soaks end in their slot, ``likely``. A step that takes longer than planned, and a hold, move both second by second.
What makes runs late are soaks. ``latest`` adds

* a share of the soak time that is still to come: the largest share by which a soak of this run was late, at least
  ``SHARE`` / (1 + soaks done);
* for a soak that is late now, what is left of its hold limit;
* ``LOOSE`` of all planned time to come and ``MARGIN_S``, for bus calls no settle time covers and records taken again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from bench.plan import PlannedSoak, Step

SHARE = 0.10
LOOSE = 0.005
MARGIN_S = 30.0


@dataclass(frozen=True)
class Remaining:
    """What is still to come: ``likely_s`` seconds, of which ``soak_s`` in soaks; ``grace_s``: a late soak may last."""

    likely_s: float
    soak_s: float
    grace_s: float = 0.0


def end_of_run(t_utc_s: float, left: Remaining, late_shares: Sequence[float]) -> dict[str, float]:
    """Range of the end, seconds since 1970 UTC. ``late_shares``: lateness over planned length of each soak done."""
    share = max([SHARE / (1 + len(late_shares)), *late_shares])
    likely = t_utc_s + left.likely_s
    spread_s = left.soak_s * share + left.grace_s + LOOSE * left.likely_s + MARGIN_S
    return {"earliest_utc_s": likely, "likely_utc_s": likely, "latest_utc_s": likely + spread_s}


def soak_to_come_s(soaks: Sequence[Step], step: Step, inside_s: float) -> float:
    """Planned soak time behind a moment of the plan, second; a soak under way counts from there on."""
    whole = sum(one.duration_s for one in soaks if one.number > step.number)
    return whole + (max(0.0, step.at_s + step.duration_s - inside_s) if isinstance(step, PlannedSoak) else 0.0)
