"""What no recording of two units can show, by name, with the size that passes unseen.

Sizes are those that the checks of a recording see in half of all cases, for a turn of 90 deg in 8 s at 100 m/s and
units as the sequences state them (docs/time-sync.md); larger stated errors hide as much more.
Source: docs/decisions/0025-doubt.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from bench.model.assumptions import Assumption

_QUANTILE = 3.9  # standard deviations at which a check of a recording speaks
_MS = 1e3
_OFFSETS = ("time_offset", "time_offset_uncertainty")
_STAMPS = ("time_offset_from_stamps", "time_offset_drift", "clock_rate")
_TURN = "in a turn of 90 deg at 100 m/s"
# seen in half of all cases: offset step s, drift s/s, age of velocities s, lever arm m, axes deg, scales
_STEP_s, _DRIFT, _AGE_s, _LEVER_m, _AXES_deg = 0.7e-3, 160e-6, 1.3e-3, 0.11, 0.007
_GYRO, _ACCELEROMETER = 3.4e-4, 4.5e-4
_VELOCITY_m_s, _LEVEL_deg = 0.017, 0.0013  # errors of the EGI with which these were seen


def assumptions(campaign: Mapping[str, Any]) -> list[Assumption]:
    """Return what a recording takes for granted, from the section "campaign" of its plan or manifest."""
    stated = campaign.get("egi") or {}
    worse = float(stated.get("velocity_m_s", _VELOCITY_m_s)) / _VELOCITY_m_s
    tilted = float(stated.get("level_deg", _LEVEL_deg)) / _LEVEL_deg
    return [
        _latency(campaign.get("latency")),
        *_of_motion(worse),
        *_of_mounting(worse, tilted),
        Assumption(
            "steady_delay",
            "The least delay of either link is the same from the first frame to the last.",
            f"A delay that grows by up to {1e6 * _DRIFT * worse:.0f} ppm of the time; a change once of a third of the "
            "jitter.",
            "Drift and rates of the clocks are off by as much; the time offset by that times the seconds from the "
            "middle of the recording to the manoeuvre.",
            "A pulse of one clock that both units tag, at the begin and at the end.",
            (*_STAMPS, *_OFFSETS),
        ),
        Assumption(
            "errors_as_stated",
            "Errors of both units are as large, and alike for as long, as the sequence states.",
            "Errors of 1.2 times the stated size.",
            "Intervals are too small by as much.",
            "Ten recordings of the same motion: the scatter of their offsets.",
            _OFFSETS,
        ),
    ]


def _latency(stated: Mapping[str, Any] | None) -> Assumption:
    if stated is None:
        unseen = "A constant latency of any size: no latencies are stated, so nothing is held against the filter."
    else:
        seen_ms = _MS * _QUANTILE * math.sqrt(2.0) * float(stated["std_s"])
        unseen = f"A constant latency of up to {seen_ms:.1f} ms, beyond which filter and receive stamps disagree."
    return Assumption(
        "latency_as_stated",
        "A solution and a sample are of the instant that their tags say, and the stated latencies are right.",
        unseen,
        "The time offset contains the latency one to one; the offset by stamps contains an error of the stated one.",
        "Both units on a table, turned to and fro, with a trigger on the angle that a third clock tags.",
        (*_OFFSETS, "time_offset_from_stamps"),
    )


def _of_motion(worse: float) -> list[Assumption]:
    return [
        Assumption(
            "one_offset",
            "The offset is constant but for the drift that the receive stamps show.",
            f"A step of {_MS * _STEP_s * worse:.1f} ms within the manoeuvre, or a drift of {1e6 * _DRIFT * worse:.0f} "
            f"ppm beyond that of the stamps, {_TURN}.",
            "The time offset is that of the manoeuvre; before and after it may be another by as much.",
            "A second manoeuvre in the same recording: both must tell one offset.",
            _OFFSETS,
        ),
        Assumption(
            "one_age",
            "Position, velocity and attitude of a solution are of the same instant.",
            f"Velocities that are {_MS * _AGE_s * worse:.1f} ms older, {_TURN}.",
            "The offset of the tight filter moves by 0.2 ms for each millisecond, that of the loose one by 0.01 ms.",
            "A turn and an acceleration along the track: they weigh the parts of a solution differently.",
            _OFFSETS,
        ),
    ]


def _of_mounting(worse: float, tilted: float) -> list[Assumption]:
    return [
        Assumption(
            "one_place",
            "Both units are at one place, or the EGI's solution is for that of the inertial unit.",
            f"A lever arm of {_LEVER_m * worse:.2f} m, {_TURN}.",
            "A lever arm of 1 m moves the offset of the tight filter by 1.9 ms, and biases of accelerometers by 22 ug.",
            "A tape measure; the lever arm entered into the EGI.",
            _OFFSETS,
        ),
        Assumption(
            "same_axes",
            "The axes of both units are parallel.",
            f"Axes {_AXES_deg * tilted:.3f} deg apart, {_TURN}.",
            "For each 0.01 deg biases of accelerometers move by 8 ug, those of gyros by 0.6 deg/h, the time offset by "
            "0.05 ms.",
            "Both units at rest in two headings: the angles between them must stay.",
            (*_OFFSETS, "accel_bias"),
        ),
        Assumption(
            "scales_of_inertial_unit",
            "Gyros and accelerometers of the inertial unit have their stated scales.",
            f"{1e6 * _GYRO:.0f} ppm of the gyros, {1e6 * _ACCELEROMETER:.0f} ppm of the accelerometers, {_TURN}.",
            "For each 1,000 ppm biases of accelerometers move by 30 ug, that of the gyro about the axis of the turn by "
            "3.6 deg/h; the time offset by 0.1 ms.",
            "A turn to the right and one to the left in the same recording.",
            (*_OFFSETS, "gyro_bias", "accel_bias"),
        ),
    ]
