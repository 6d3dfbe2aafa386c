"""The planned temperature of a whole run as corners of a polyline, moved by the slip so far."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from bench.plan import SetPoint, Step


def corners(
    thermal: Sequence[Step], start_of: Callable[[Step], float], end_utc_s: float, first_degC: float | None
) -> dict[str, list[float]]:
    """Corners of the set-point over time.

    Args: thermal: soaks and set-points of the chamber in order.   start_of: when a step began or will, UTC second.
          end_utc_s: end of the run.   first_degC: of the chamber before the first one; None: its own target.
    Returns: ``t_utc_s`` (rising or equal) and ``temperature_degC``, of equal length.
    """
    times: list[float] = []
    values: list[float] = []
    now_degC = first_degC
    starts = [start_of(step) for step in thermal]
    for index, step in enumerate(thermal):
        asked = step.set_point
        if asked is None:
            continue
        before_degC = asked.temperature_degC if now_degC is None else now_degC
        start = max(starts[index], times[-1] if times else starts[index])
        stop = max(start, starts[index + 1] if index + 1 < len(starts) else end_utc_s)
        there, now_degC = _ramp(start, stop, before_degC, asked)
        times += [start, there, stop]
        values += [before_degC, now_degC, now_degC]
    return {"t_utc_s": times, "temperature_degC": values}


def _ramp(start: float, stop: float, before_degC: float, asked: SetPoint) -> tuple[float, float]:
    """Return when the set-point is at its target, or how far it comes until the next one."""
    target_degC, rate_degC_s = asked.temperature_degC, asked.ramp_degC_min / 60.0
    if rate_degC_s <= 0.0:
        return start, target_degC
    there = start + abs(target_degC - before_degC) / rate_degC_s
    if there <= stop:
        return there, target_degC
    share = (stop - start) / (there - start)
    return stop, before_degC + share * (target_degC - before_degC)
