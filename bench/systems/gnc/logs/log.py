"""Columns of an imported log of an inertial unit: accelerometers and gyros as arrays, stretches by label.

What an imported log of an inertial unit says against the numbers that are found in it.

Each sensor moves as its noise makes it and answers mainly to its own axis. Source: docs/method-uncertainty.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from bench.analysis import Document, Estimate, Evidence, Floats, Material
from bench.maths.samples import few, frozen_runs, lone_values
from bench.maths.tests import SMALLEST
from bench.model.errors import FitError
from bench.systems.gnc.declaration import AXES
from bench.systems.gnc.estimators.triad import TriadFit
from bench.systems.gnc.wording import channel_name, quantity_word, say

MOTION_ERRORS = ("level_error", "velocity_error")
_MOST_LONE = 0.01  # of the samples of a stretch: more are the sensor's own nature
_PLAUSIBLE = 0.1  # of an axis's own sensitivity, from the two others


@dataclass(frozen=True)
class ImuLog:
    """``accel``, ``gyro`` (n, 3): as read, in ``accel_unit`` and ``gyro_unit`` ("1": counts); gyro None without one.

    ``gravity``: in m/s2.   ``t_s`` (n,).   ``rate_Hz``: mean rate.   ``segments``: as the mapping names them.
    """

    t_s: Floats
    accel: Floats
    accel_unit: str
    gyro: Floats | None
    gyro_unit: str
    gravity: float
    rate_Hz: float
    segments: tuple[Document, ...]

    def of(self, kind: str) -> Floats:
        """Return the samples of the "accelerometer" or the "gyro", (n, 3) if it is there."""
        return self.accel if kind == "accelerometer" or self.gyro is None else self.gyro

    def rows(self, segment: Document) -> slice:
        """Return rows of a segment; its last one is included."""
        return slice(int(segment["first"]), int(segment["last"]) + 1)


def imu_log(material: Material) -> ImuLog:
    """Return the log of a session.

    Raises: FitError B-GNC-006 if it has no accelerometer of three axes, no gravity or values that are missing.
    """
    t_s = material.series.get("t_s")
    accel, accel_unit = triad_of(material, "accelerometer")
    if t_s is None or accel is None:
        raise _unusable("there is no imported log with accelerometers of three axes")
    gyro, gyro_unit = triad_of(material, "gyro")
    whole = np.isfinite(accel).all() and (gyro is None or np.isfinite(gyro).all())
    if len(t_s) < 2 or not whole:
        raise _unusable("a value is missing in the columns of the sensors")
    if not t_s[-1] > t_s[0]:
        raise _unusable("all rows of the log have the same time")
    site = material.campaign.get("site") or {}
    if not site.get("gravity_m_s2"):
        raise _unusable("the mapping does not state the gravity of the site")
    return ImuLog(
        t_s=t_s,
        accel=accel,
        accel_unit=accel_unit,
        gyro=gyro,
        gyro_unit=gyro_unit,
        gravity=float(site["gravity_m_s2"]),
        rate_Hz=float(material.campaign.get("rate_Hz") or (len(t_s) - 1) / (t_s[-1] - t_s[0])),
        segments=tuple(material.campaign.get("segments") or ()),
    )


def triad_of(material: Material, role: str) -> tuple[Floats | None, str]:
    """Return readings of three axes, (n, 3), and their unit; None without them."""
    columns = {
        str(column.get("axis")): column for column in material.campaign.get("columns", ()) if column.get("role") == role
    }
    if set(columns) != set(AXES):
        return None, ""
    triad = np.column_stack([material.series[str(columns[axis]["name"])] for axis in AXES])
    return triad, str(columns["x"]["unit"])


def _unusable(why: str) -> FitError:
    return FitError(
        "B-GNC-006",
        why,
        next_step="map time, three accelerometers and the gravity of the site (docs/importing.md)",
    )


def stuck_sensors(
    stretches: Mapping[str, Sequence[Floats]], quantities: Mapping[str, Sequence[str]] | None = None
) -> list[Evidence]:
    """Return each sensor that stands still longer than its noise allows, at one chance in a million a stretch.

    Args: stretches: by kind ("accelerometer", "gyro"), parts of the log that are used, (n, 3) each.
          quantities: that depend on a kind; None for all.
    """
    found = []
    for kind, parts in stretches.items():
        for k, axis in enumerate(AXES):
            hung = [place for place, part in enumerate(parts, 1) if frozen_runs(axis, part[:, k])]
            if hung:
                key = "evidence.hung_log" if len(parts) == 1 else "evidence.hung_stretch"
                text = say(key, sensor=channel_name(f"{kind} {axis}"), stretches=", ".join(map(str, hung)))
                of_kind = quantities[kind] if quantities else ()
                found.append(Evidence("stands_still", text, float(len(hung)), 0.0, quantities=of_kind))
    return found


def without_lone_samples(
    log: ImuLog, segments: Mapping[str, Sequence[Document]], quantities: Mapping[str, Sequence[str]]
) -> tuple[ImuLog, list[str], list[Evidence]]:
    """Return the log with the course of the neighbours in place of each sample of the segments that stands alone.

    At rest only: where a hand turns the unit, shocks last for a sample too.

    Args:    segments: by kind ("accelerometer", "gyro").   quantities: that depend on a kind.
    Returns: the log; a sentence for each column and segment; a doubt where more than one sample in a hundred is so.
    """
    parts = {kind: log.of(kind).copy() for kind in segments}
    notes, evidence = [], []
    for kind, stretches in segments.items():
        for segment, (k, axis) in product(stretches, enumerate(AXES)):
            part = parts[kind][log.rows(segment), k]
            lone = lone_values(part)
            count = int(lone.sum())
            about = {"sensor": channel_name(f"{kind} {axis}"), "count": count, "row": segment["first"]}
            if not few(count, lone.size, _MOST_LONE):
                text = say("evidence.lone", **about, of=lone.size)
                evidence.append(Evidence("lone_samples", text, float(count), 0.0, quantities=quantities[kind]))
            elif count:
                part[lone] = np.interp(np.flatnonzero(lone), np.flatnonzero(~lone), part[~lone])
                notes.append(say("log.lone", **about))
    return replace(log, accel=parts["accelerometer"], gyro=parts.get("gyro")), notes, evidence


def wide_sizes(entries: Sequence[Estimate]) -> list[Evidence]:
    """Return each error of the motions whose interval is wider than the error itself: too few motions tell its size.

    Args: entries: the estimates of one log; those of motions are ``level_error`` and ``velocity_error``.
    """
    found = []
    for entry in entries:
        name, value, wide = entry.quantity, entry.value, entry.expanded_uncertainty
        if name in MOTION_ERRORS and wide > value:
            text = say(
                "evidence.few_motions",
                quantity=quantity_word(name),
                motions=entry.n,
                value=value,
                wide=wide,
                unit=entry.unit,
            )
            found.append(Evidence("too_few_motions", text, wide / value if value else None, 0.0, quantities=(name,)))
    return found


def own_axes(prefix: str, fit: TriadFit) -> list[Evidence]:
    """Return a refusal where a sensor does not answer mainly to its own axis; sensors may count in any unit."""
    own = fit.sensitivity.diagonal()
    cross = np.abs(fit.sensitivity - np.diag(own)) / np.maximum(np.abs(own), SMALLEST)[:, None]
    worst = float(cross.max())
    if worst <= _PLAUSIBLE and bool(np.all(own > 0.0)):
        return []
    row, column = np.unravel_index(int(np.argmax(cross)), cross.shape)
    text = say(
        "evidence.other_axis" if np.all(own > 0.0) else "evidence.wrong_sign",
        sensor=AXES[row],
        triad=say(f"triad.{prefix}"),
        axis=AXES[column],
        share=100 * worst,
        bound=100 * _PLAUSIBLE,
    )
    return [
        Evidence("implausible_axis", text, worst, 0.0, quantities=(f"{prefix}_matrix", f"{prefix}_bias"), refuses=True)
    ]
