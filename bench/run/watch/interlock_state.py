"""One interlock over time: beyond its level for the dwell it trips, back for long enough it releases."""

from __future__ import annotations

import math
from typing import Literal

from bench.model.clock import NS
from bench.plan import InterlockRule

Change = Literal["tripped", "stale", "released", "lasting"]
LASTING_S = 2.0  # a glitch is over by then


class InterlockState:
    """Feed it with ``take``; pure logic, no clock of its own.

    A value on the trip level is not beyond, a value on the release level is back. No reading, or one that is not
    finite, neither trips nor releases by itself; where ``stale_s`` is set, no reading for longer than that counts as
    beyond and trips at once.
    """

    def __init__(self, rule: InterlockRule, start_ns: int) -> None:
        self.rule = rule
        self.tripped = False
        self.value = math.nan  # the newest that was read
        self._read_ns = start_ns
        self._beyond_ns: int | None = None
        self._back_ns: int | None = None
        self._lasting_ns: int | None = None

    def take(self, t_ns: int, value: float | None) -> Change | None:
        """Return what changes with the reading at ``t_ns`` (None: there was none).

        "lasting" comes once, when a tripped interlock is still beyond after another dwell, 2 s at least.
        """
        if value is None or not math.isfinite(value):
            return self._without(t_ns)
        self.value, self._read_ns = value, t_ns
        return self._while_tripped(t_ns, value) if self.tripped else self._while_well(t_ns, value)

    def _without(self, t_ns: int) -> Change | None:
        self._back_ns = None
        stale_s = self.rule.stale_s
        if stale_s is None or self.tripped or t_ns - self._read_ns <= stale_s * NS:
            return self._lasting(t_ns) if self.tripped else None
        self.value = math.nan
        return self._trip(t_ns, "stale")

    def _while_well(self, t_ns: int, value: float) -> Change | None:
        if not self.rule.beyond(value):
            self._beyond_ns = None
            return None
        self._beyond_ns = t_ns if self._beyond_ns is None else self._beyond_ns
        return self._trip(t_ns, "tripped") if t_ns - self._beyond_ns >= self.rule.dwell_s * NS else None

    def _while_tripped(self, t_ns: int, value: float) -> Change | None:
        if not self.rule.back(value):
            self._back_ns = None
            return self._lasting(t_ns)
        self._back_ns = t_ns if self._back_ns is None else self._back_ns
        if t_ns - self._back_ns < self.rule.release_after_s * NS:
            return self._lasting(t_ns)
        self.tripped, self._beyond_ns, self._back_ns = False, None, None
        return "released"

    def _trip(self, t_ns: int, change: Change) -> Change:
        self.tripped, self._back_ns = True, None
        self._lasting_ns = t_ns + round(max(self.rule.dwell_s, LASTING_S) * NS)
        return change

    def _lasting(self, t_ns: int) -> Change | None:
        if self._lasting_ns is None or t_ns < self._lasting_ns:
            return None
        self._lasting_ns = None
        return "lasting"
