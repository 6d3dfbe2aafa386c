"""Records of a ring laser: which are meant for the analysis, and what their conditions say."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

from bench.analysis import Material
from bench.model.errors import FitError
from bench.model.quality import Quality

if TYPE_CHECKING:
    from bench.record import RecordRow

PATH, CLOCK, PHASE = "path_length_m", "clock_Hz", "phase_setting_deg"
_HARMLESS = Quality.LOST | Quality.BAD_FRAMES | Quality.DUPLICATE | Quality.STALE | Quality.SPLICE
_DITHER = "dither_amplitude_deg/s"


@dataclass(frozen=True)
class LaserRecord:
    """A record and the laser it is of. ``several``: another record has the same path, clock and phase setting."""

    row: RecordRow
    path_length_m: float
    phase_setting_deg: float | None
    several: bool = False

    @property
    def number(self) -> int:
        """Of the record in its session."""
        return self.row.window.number

    def sensed(self, name: str) -> float | None:
        """Mean of the housekeeping over the record, None if there was none."""
        found = self.row.context.get(name)
        return None if found is None else float(found)

    @property
    def dither_deg_s(self) -> float | None:
        """Mean amplitude of the dither rate by the sensor of the unit."""
        return self.sensed(_DITHER)

    def place(self, clock_Hz: float) -> dict[str, Any]:
        """Return conditions that tell its estimates from those of the others."""
        found: dict[str, Any] = {PATH: self.path_length_m, CLOCK: clock_Hz}
        if self.phase_setting_deg is not None:
            found[PHASE] = self.phase_setting_deg
        return found | ({"record": self.number} if self.several else {})


def laser_records(material: Material) -> list[LaserRecord]:
    """Return the records with a path length, in their order; without those that were taken again.

    Raises: FitError B-RLG-001 if there is not one; B-RLG-006 for a path length that is none.
    """
    rows = [row for row in material.rows if PATH in row.window.conditions and not row.quality & Quality.RETAKEN]
    if not rows:
        raise FitError(
            "B-RLG-001",
            f"the session holds no record with the condition {PATH!r}",
            next_step=f"look at the session with 'bench recover'; records need 'samples: true', {PATH} and {CLOCK}",
        )
    times = Counter(_key(row) for row in rows)
    return [LaserRecord(row, _path_m(row), _phase_deg(row), times[_key(row)] > 1) for row in rows]


def flagged(records: Sequence[LaserRecord]) -> dict[int, str]:
    """Records that must not be used, by number, with what they are flagged for; losses of the link are no reason."""
    flags = {one.number: Quality(one.row.quality) & ~_HARMLESS for one in records}
    return {number: str(found.name).replace("|", ", ") for number, found in flags.items() if found}


def not_recorded(records: Sequence[LaserRecord]) -> list[str]:
    """Combinations of path and clock that the others promise and that no record is of."""
    there = {(one.path_length_m, one.row.window.conditions.get(CLOCK)) for one in records}
    paths, clocks = ([*dict.fromkeys(column)] for column in zip(*sorted(there, key=str), strict=True))
    return [
        f"path {100 * path:g} cm with the clock of {float(clock) / 1e6:g} MHz: no record"
        for path, clock in product(paths, clocks)
        if (path, clock) not in there and clock is not None
    ]


def none_usable(bad: Mapping[int, str]) -> FitError:
    """The error of a session whose records are all flagged."""
    why = ", ".join(f"record {number} {flags}" for number, flags in bad.items())
    return FitError(
        "B-RLG-008", f"every record is flagged: {why}", next_step="see what happened during them, run again"
    )


def _key(row: RecordRow) -> tuple[Any, ...]:
    return tuple(row.window.conditions.get(name) for name in (PATH, CLOCK, PHASE))


def _path_m(row: RecordRow) -> float:
    stated = row.window.conditions[PATH]
    if isinstance(stated, bool) or not isinstance(stated, int | float) or not stated > 0:
        raise FitError(
            "B-RLG-006",
            f"its path length is {stated!r}",
            where=f"record {row.window.number}",
            next_step=f"state the optical path as a condition, for example {PATH}: 0.28 m",
        )
    return float(stated)


def _phase_deg(row: RecordRow) -> float | None:
    stated = row.window.conditions.get(PHASE)
    return None if stated is None else float(stated)
