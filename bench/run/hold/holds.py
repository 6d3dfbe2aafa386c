"""Why a run stands still, and what somebody beside the sequencer wants of it."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Literal

Kind = Literal["hold", "retake", "skip"]
HOLD_LIMIT_S = 4 * 3600.0  # a cause that nobody removed by then will not go away by itself


@dataclass(frozen=True)
class Wish:
    """A wish at the point under way: take it again, skip it, or stand still; ``by`` = who wishes it."""

    kind: Kind
    by: str
    reason: str


class Interruption(Exception):
    """Leaves the step under way because of a wish; only the sequencer catches it."""

    def __init__(self, wish: Wish) -> None:
        super().__init__(f"{wish.kind}: {wish.reason}")
        self.wish = wish


class Holds:
    """The reasons to stand still, by who gave them; the run goes on when the last one is gone. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._reasons: dict[str, str] = {}
        self._limits_s: dict[str, float] = {}
        self._since_s: dict[str, float] = {}  # when a reason was first seen while the run stood still
        self._wish: Wish | None = None

    def hold(self, by: str, reason: str, limit_s: float = HOLD_LIMIT_S) -> None:
        """Stand still from the next check on, until ``release`` is called with the same ``by``.

        ``limit_s``: the run ends safely when it has stood still that long for this reason.
        """
        with self._lock:
            self._reasons[by] = reason
            self._limits_s[by] = limit_s

    def release(self, by: str) -> bool:
        """Take a reason back; False if there was none."""
        with self._lock:
            self._limits_s.pop(by, None)
            self._since_s.pop(by, None)
            return self._reasons.pop(by, None) is not None

    def wish(self, wish: Wish) -> None:
        """Retake or skip the point under way; the first wish counts until it is granted."""
        with self._lock:
            self._wish = self._wish or wish

    @property
    def reasons(self) -> dict[str, str]:
        """Reasons to stand still, by who gave them."""
        with self._lock:
            return dict(self._reasons)

    def overdue(self, held_s: float) -> tuple[str, str, float] | None:
        """The first reason whose limit is over after standing still for ``held_s``: (by, reason, limit in second).

        A reason that comes while the run stands still for another one has its whole limit from then on.
        """
        with self._lock:
            for by, limit_s in self._limits_s.items():
                if held_s - self._since_s.setdefault(by, held_s) > limit_s:
                    return by, self._reasons[by], limit_s
            return None

    def take(self) -> Wish | None:
        """Return what is wished now: standing still comes first. A retake or skip is handed out once."""
        with self._lock:
            if self._reasons:
                by, reason = next(iter(self._reasons.items()))
                return Wish("hold", by, reason)
            wish, self._wish = self._wish, None
            return wish
