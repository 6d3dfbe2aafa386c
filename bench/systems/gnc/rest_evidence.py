"""What records at rest say against the biases found in them: the pose is the one named, nothing moves, nothing hangs.

Source: docs/decisions/0025-doubt.md.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench.analysis import Evidence, Floats
from bench.systems.gnc.estimators.earth_rate import up_in_body
from bench.systems.gnc.limits import Limits
from bench.systems.gnc.rows import AXES, SENSORS, SampledRow
from bench.systems.gnc.wording import channel_name, say

_PLAUSIBLE_g = 0.1  # bias and scale-factor error of an accelerometer together
_TIMES_STABILITY = 5.0  # a bias that wanders as specified changes less within a record
_SURE = 6.0  # standard deviations of the noise of both means
_QUANTITIES = {
    "bias": ("gyro_bias",),
    "flip": ("accel_bias",),
    "stability": ("gyro_bias_stability", "accel_bias_stability"),
    "repeatability": ("gyro_bias_repeatability", "accel_bias_repeatability"),
}
_UNITS = {"accelerometer": "g", "gyro": "deg/s"}


def evidence(rows: Sequence[SampledRow], limits: Limits) -> list[Evidence]:
    """Return what speaks against the biases of these records."""
    return [*(seen for row in rows for seen in (*_other_pose(row), *_moves(row, limits))), *_stands_still(rows)]


def _other_pose(row: SampledRow) -> list[Evidence]:
    """Return a refusal where gravity is not where the pose of the record has it."""
    off = row.values("accelerometer").mean(axis=0) - up_in_body(row.pose)
    worst = int(np.argmax(np.abs(off)))
    if abs(off[worst]) <= _PLAUSIBLE_g:
        return []
    text = say(
        "evidence.pose", number=row.number, item=row.item, axis=AXES[worst], off=float(off[worst]), bound=_PLAUSIBLE_g
    )
    return [Evidence("implausible_pose", text, float(off[worst]), 0.0, quantities=_QUANTITIES[row.item], refuses=True)]


def _moves(row: SampledRow, limits: Limits) -> list[Evidence]:
    """Return each axis whose mean changes from the first to the last quarter of a record beyond any bias of the kind.

    The accelerometers tell a unit that tips over its mounting, the gyros one that turns, either of them one that warms.
    """
    found = []
    for kind, prefix in (("accelerometer", "accel"), ("gyro", "gyro")):
        values = row.values(kind)
        quarter = len(values) // 4
        if not quarter:
            continue
        first, last = values[:quarter], values[-quarter:]
        change = last.mean(axis=0) - first.mean(axis=0)
        noise = np.sqrt((_variance(first) + _variance(last)) / quarter)
        far = np.abs(change) / np.maximum(_TIMES_STABILITY * limits[f"{prefix}_bias_stability"], _SURE * noise)
        worst = int(np.argmax(far))
        if far[worst] > 1.0:
            text = say(
                "evidence.moves",
                number=row.number,
                item=row.item,
                sensor=channel_name(f"{kind} {AXES[worst]}"),
                change=float(change[worst]),
                unit=_UNITS[kind],
                times=_TIMES_STABILITY,
            )
            found.append(Evidence("not_at_rest", text, float(change[worst]), 0.0, quantities=_QUANTITIES[row.item]))
    return found


def _variance(values: Floats) -> Floats:
    """Return the variance of white noise, from successive differences, (3,)."""
    return np.asarray(np.mean(np.diff(values, axis=0) ** 2, axis=0) / 2.0)


def _stands_still(rows: Sequence[SampledRow]) -> list[Evidence]:
    """Return each axis that never changes in any record while another one of its kind has noise: it is not there."""
    found = []
    for kind in ("accelerometer", "gyro"):
        still = np.array([np.ptp(row.samples.columns[SENSORS[kind]], axis=0) == 0 for row in rows]).all(axis=0)
        for k in np.flatnonzero(still) if rows and not still.all() else ():
            text = say("evidence.silent", sensor=channel_name(f"{kind} {AXES[k]}"))
            place = {"kind": kind, "axis": AXES[k]}
            found.append(Evidence("stands_still", text, float(len(rows)), 0.0, conditions=place, refuses=True))
    return found
