"""The campaign's timeline: planned times, slip, and how late steps really were.

Overrun policy: planned time advances only in settle, record and soak steps. A bus call that takes longer than the
settle time it shares shifts everything after it (a *slip*, recorded as an event and reported); a settle time never
gets shorter than what its plan leaves after the bus calls, and a record is never cut short.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from bench.model.clock import NS, Clock, to_ns
from bench.run.stop import StopSwitch

_CONTIGUOUS_S = 1e-6  # planned times are rounded to a thousandth of that
_WALL_SLICE_NS = NS // 4  # how soon a stop is honoured; a virtual wait takes no real time and is never sliced


@dataclass
class Timeline:
    """Maps planned seconds of one phase to the bench clock.

    ``slip_ns`` is how much later than planned the phase runs now; ``lateness_ns`` holds one value per timed wait.
    ``done_s``: planned end of the step that is done, None where the run has jumped for another reason than a decision.
    """

    clock: Clock
    stop: StopSwitch
    origin_ns: int
    slip_ns: int = 0
    lateness_ns: list[int] = field(default_factory=list)
    done_s: float | None = None

    def target_ns(self, at_s: float) -> int:
        """Return bench-clock time of a planned moment, slip included."""
        return self.origin_ns + to_ns(at_s) + self.slip_ns

    def wait_until(self, at_s: float) -> None:
        """Wait for a planned moment and note how late it is left."""
        target = self.target_ns(at_s)
        self.wait_until_ns(target)
        late = self.clock.now_ns() - target
        self.lateness_ns.append(late)

    def reach(self, at_s: float) -> None:
        """Wait for the planned start of a step; one that is already past by then starts at once."""
        if self.target_ns(at_s) > self.clock.now_ns():
            self.wait_until(at_s)

    def bring_forward(self, at_s: float) -> None:
        """Leave out the planned time that a decision leaves between the step that is done and the one that begins."""
        gap_s = 0.0 if self.done_s is None else at_s - self.done_s
        if gap_s > _CONTIGUOUS_S:
            self.leave_out(gap_s)

    def leave_out(self, seconds: float) -> None:
        """Bring everything that follows forward: so much planned time is left out."""
        self.origin_ns -= to_ns(seconds)

    def wait_until_ns(self, t_mono_ns: int) -> None:
        """Wait for a moment of the bench clock; a stop ends the wait."""
        while (now := self.clock.now_ns()) < t_mono_ns:
            self.stop.check()
            self.clock.sleep_until_ns(t_mono_ns if self.clock.virtual else min(t_mono_ns, now + _WALL_SLICE_NS))
        self.stop.check()

    def add_slip(self, slip_ns: int) -> None:
        """Shift everything that follows."""
        self.slip_ns += slip_ns
