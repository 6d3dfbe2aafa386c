"""A wait is shown as a wait: what for, since when, until when, and the last that was read or said."""

from __future__ import annotations

from collections import deque
from typing import Any

from bench.plan import PlannedPrompt, PlannedRecord, PlannedSettle, PlannedSoak, Step
from bench.run.feed.place import Place

SLOPE_S = 600.0
LONG_CALL_S = 2.0  # an instrument that takes longer to do what it was told is waited for
_KEPT = 400


class Temperature:
    """Newest temperature of the unit, and its slope over the last ten minutes."""

    def __init__(self) -> None:
        self._readings: deque[tuple[float, float]] = deque(maxlen=_KEPT)

    def add(self, t_utc_s: float, unit_degC: float) -> None:
        """A reading; one that comes within 2 s of the one before takes its place."""
        if len(self._readings) > 1 and t_utc_s - self._readings[-2][0] < 2.0:
            self._readings.pop()
        self._readings.append((t_utc_s, unit_degC))
        while t_utc_s - self._readings[0][0] > SLOPE_S:
            self._readings.popleft()

    @property
    def sentence(self) -> str | None:
        """Such as "48.21 degC, +0.401 degC/min"; None before the first reading."""
        if not self._readings:
            return None
        (t0, first), (t1, last) = self._readings[0], self._readings[-1]
        slope = f", {(last - first) / (t1 - t0) * 60.0:+.3f} degC/min" if t1 - t0 >= 30.0 else ""
        return f"{last:.2f} degC{slope}"


def wait_of(t: float, step: Step, place: Place, unit: Temperature, said: str | None) -> dict[str, Any] | None:
    """Return what a step waits for; None for one that takes no time worth telling."""
    if isinstance(step, PlannedSoak):
        limit = place.late_until(step)
        until = place.time_of(step, step.at_s + step.duration_s) if limit is None else limit
        reason = f"soak {step.temperature_degC:g} degC"
        reason += "" if limit is None else ", later than planned"
        return _wait(reason, place, until, unit.sentence)
    if isinstance(step, PlannedSettle):
        return _wait(f"settle {step.duration_s:g} s", place, place.time_of(step, step.at_s + step.duration_s), said)
    if isinstance(step, PlannedRecord):
        until = place.time_of(step, step.at_s + step.duration_s)
        return _wait(f"record of {step.seconds:g} s", place, until, unit.sentence)
    since = place.since_utc_s
    if isinstance(step, PlannedPrompt) or since is None or t - since < LONG_CALL_S:
        return None
    return _wait(f"{step.role}.{step.name or step.kind}", place, None, said)


def _wait(reason: str, place: Place, until: float | None, last: str | None) -> dict[str, Any]:
    return {"reason": reason, "since_utc_s": place.since_utc_s, "until_utc_s": until, "last": last}
