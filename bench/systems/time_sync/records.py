"""Records of two units that stream side by side as one recording, and the clocks of both ports by its receive stamps.

Samples of each port come by counter, without doubles. The clocks are the check of the filter that knows nothing of
motion.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bench.analysis import Material
from bench.maths.arrays import Flags, Floats, Integers
from bench.maths.stamps import first_step
from bench.model.errors import FitError
from bench.model.quantities import Quality
from bench.systems.time_sync.estimators.port_clocks import (
    PortClock,
    StampsDifference,
    clock_difference,
    port_clock,
)
from bench.systems.time_sync.estimators.stamp_grid import grid_s
from bench.systems.time_sync.limits import Latency

if TYPE_CHECKING:
    from bench.record import RecordRow, Samples

ITEM = "time_sync"
EGI, RADAR = "egi", "radar"
COLUMNS: Mapping[str, tuple[str, ...]] = {
    "imu": ("tick", "delta_angle", "delta_velocity", "status"),
    EGI: ("tick", "latitude", "longitude", "height", "velocity", "attitude", "position_sigma", "mode", "status"),
    RADAR: ("tick", "near_range", "spacing", "wavelength", "echo", "status"),
}
NS = 1e-9
_NEAR_s = 0.05  # an offset that the filter finds by itself
_COARSE_s = 0.01  # steps of what is taken out of the tags before it


@dataclass(frozen=True)
class Stream:
    """Samples of one port in the order of their counter, none twice.

    ``tick_s``: time tags from the first tag of the inertial unit on, as the unit's own clock says, (n,).   ``counter``:
    (n,).   ``received_ns``: receive stamps, (n,).   ``columns``: by field, in its unit.   ``lost``: frames between the
    first and the last that are not there.
    """

    tick_s: Floats
    counter: Integers
    received_ns: Integers
    columns: Mapping[str, Floats]

    def __len__(self) -> int:
        return len(self.counter)

    @property
    def lost(self) -> int:
        """Frames between the first and the last that are missing."""
        return int(self.counter[-1] - self.counter[0]) + 1 - len(self)

    def part(self, keep: slice | Flags) -> Stream:
        """Some of the samples."""
        columns = {name: column[keep] for name, column in self.columns.items()}
        return Stream(self.tick_s[keep], self.counter[keep], self.received_ns[keep], columns)


@dataclass(frozen=True)
class Recording:
    """Everything both units (and the radar) sent while the records ran; ``manoeuvre``: as the records say."""

    imu: Stream
    egi: Stream
    radar: Stream | None
    manoeuvre: str


def recording(material: Material) -> Recording:
    """Join the records of the session.

    Raises: FitError B-SYNC-001 (no record with samples), B-SYNC-002 (no EGI beside them, or frames of another kind),
            B-SYNC-004 (a clock was set or started again).
    """
    rows = _rows(material)
    first = int(rows[0].samples.columns["tick"][0]) if rows[0].samples is not None else 0
    imu = _stream([row.samples for row in rows], "imu", first)
    egi = _stream([row.beside.get(EGI) for row in rows], EGI, first)
    if imu is None or egi is None:
        raise FitError(
            "B-SYNC-002",
            f"no samples of the link {EGI!r} beside the records of the inertial unit",
            where=f"record {rows[0].window.number}",
            next_step=f"name both links in 'frame' of the sequence, {EGI!r} among them; look at its lost frames",
        )
    radar = _stream([row.beside.get(RADAR) for row in rows], RADAR, first)
    for name, stream in (("imu", imu), (EGI, egi)):
        check_clock(name, stream)
    return Recording(imu, egi, radar, str(rows[0].window.conditions.get("manoeuvre", "")))


def _rows(material: Material) -> Sequence[RecordRow]:
    rows = [
        row
        for row in material.rows
        if row.window.conditions.get("item") == ITEM and not row.quality & Quality.RETAKEN
        and row.samples is not None and len(row.samples)
    ]  # fmt: skip
    if not rows:
        raise FitError(
            "B-SYNC-001",
            f"the session holds no record with samples and the condition 'item: {ITEM}'",
            next_step="give the records of the inertial unit 'samples: true' and that condition",
        )
    return rows


def _stream(parts: Sequence[Samples | None], link: str, first_tick: int) -> Stream | None:
    present = [part for part in parts if part is not None and len(part)]
    if not present:
        return None
    if unknown := [name for name in COLUMNS[link] if any(name not in part.columns for part in present)]:
        raise FitError(
            "B-SYNC-002",
            f"the frames of the link {link!r} carry no {', '.join(unknown)}",
            next_step="use frames with the fields of imu_200, egi_50, sar_pulse; docs/method-time-sync.md names them",
        )
    counter = np.concatenate([part.counter for part in present])
    before = np.maximum.accumulate(np.concatenate(([np.iinfo(np.int64).min], counter)))[:-1]
    new = counter > before  # a frame at a joint is in both records
    tick = np.concatenate([part.columns["tick"] for part in present])[new].astype(np.uint64)
    scale = present[0].scales["tick"][0]
    # the difference of two 64-bit counters, whatever they began with and whether or not they went through zero
    tick_s = (tick - np.uint64(first_tick)).view(np.int64).astype(np.float64) * scale
    columns = {
        name: np.concatenate([part.scaled(name) for part in present])[new] for name in COLUMNS[link] if name != "tick"
    }
    return Stream(tick_s, counter[new], np.concatenate([part.t_ns for part in present])[new], columns)


def check_clock(name: str, stream: Stream) -> None:
    """Check that the tags of a port go on evenly. Raises: FitError B-SYNC-004 where its clock was set."""
    at = first_step(stream.tick_s, stream.counter)
    if at is None:
        return
    step_s = float(stream.tick_s[at] - stream.tick_s[at - 1])
    after_s = 1e-9 * float(stream.received_ns[at] - stream.received_ns[0])
    raise FitError(
        "B-SYNC-004",
        f"the clock of the unit on the link {name!r} was set or started again {after_s:.3f} s after its first frame: "
        f"its time tag goes on by {step_s:.6g} s over {int(stream.counter[at] - stream.counter[at - 1])} frames",
        next_step="keep both units powered and their clocks free during the recording; take it again",
    )


@dataclass(frozen=True)
class Clocks:
    """Both ports and their difference, EGI minus inertial unit.

    ``coarse_s``: whole part of the offset, taken out of the EGI's tags beforehand, exact.   ``difference``: of what is
    left.   ``latency``: as stated, None if nobody does.   ``line_s``: that the frames take on the line, EGI minus
    inertial unit.   ``place_s``: time of the unit of each frame of both ports, for figures.
    """

    imu: PortClock
    egi: PortClock
    coarse_s: float
    difference: StampsDifference
    latency: Latency | None
    line_s: float
    imu_s: Floats
    egi_s: Floats

    @property
    def offset_s(self) -> float | None:
        """Offset of the EGI's clock in the middle of the recording, None without stated latencies."""
        return None if self.latency is None else self.coarse_s + self.difference.offset_s


def clocks_of(taken: Recording, middle_s: float, latency: Latency | None, line_s: Mapping[str, float]) -> Clocks:
    """Line of least delay of either port, and the difference at ``middle_s``.

    Raises: FitError B-SYNC-009 for too few frames.
    """
    origin_ns = int(taken.imu.received_ns[0])
    step_s = grid_s(np.concatenate((taken.imu.received_ns, taken.egi.received_ns)))
    coarse_s = _coarse_s(taken, origin_ns)
    imu_s, egi_s = taken.imu.tick_s, taken.egi.tick_s - coarse_s
    imu = port_clock(imu_s, taken.imu.counter, _received_s(taken.imu, origin_ns), step_s)
    egi = port_clock(egi_s, taken.egi.counter, _received_s(taken.egi, origin_ns), step_s)
    on_line_s = line_s.get("egi", 0.0) - line_s.get("imu", 0.0)
    stated_s, std_s = on_line_s, 0.0
    if latency is not None:
        stated_s, std_s = on_line_s + latency.egi_s - latency.imu_s, math.sqrt(2.0) * latency.std_s
    difference = clock_difference(egi, imu, middle_s, stated_s, std_s)
    return Clocks(imu, egi, coarse_s, difference, latency, on_line_s, imu_s, egi_s)


def _received_s(stream: Stream, origin_ns: int) -> Floats:
    return np.asarray((stream.received_ns - origin_ns) * NS)


def _coarse_s(taken: Recording, origin_ns: int) -> float:
    """Clocks may have begun at any time: what both delays are apart, in whole steps, if it is more than a little."""
    apart_s = float(
        np.median(taken.egi.tick_s - _received_s(taken.egi, origin_ns))
        - np.median(taken.imu.tick_s - _received_s(taken.imu, origin_ns))
    )
    return round(apart_s / _COARSE_s) * _COARSE_s if abs(apart_s) > _NEAR_s else 0.0
