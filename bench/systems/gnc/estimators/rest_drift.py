"""Drift of an inertial unit that stands still: what it would say of its motion after bias and level were taken, and the
class of inertial sensors that such a drift belongs to: consumer, industrial, tactical or navigation.

A rest is cut into pairs of stretches of the same length T. The first one gives the bias of the gyroscopes, the level
and the size of gravity; over the second one the strapdown goes on from there, so attitude, velocity and position at its
end are drift. The noise of the first stretch is part of it: white noise N of a gyroscope gives N sqrt(2 T) of attitude.

Source: Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd edition, sections 5.6.2
(levelling) and 5.7 (error growth); the strapdown is that of ``bench.maths.strapdown``. Classes: El-Sheimy and Youssef,
Inertial sensors technologies for navigation applications: state of the art and future trends, Satellite Navigation 1:2
(2020), table 1: navigation below 0.01 deg/h, 0.002 deg/sqrt(h), 100 ug; tactical 1 to 10 deg/h, 0.02 to 0.05
deg/sqrt(h), 1 to 5 mg; commercial 0.1 deg/s, several deg/sqrt(h), taken as 5, and 100 to 1000, printed in ug beside the
1 to 5 mg of the better class and taken as mg. The table knows no industrial class; makers sell one between tactical and
commercial. Here it ends at the geometric mean of both: a convention of this program.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.maths.arrays import Floats, rms
from bench.maths.strapdown import earth_rate, navigate, normal_gravity
from bench.model.errors import FitError
from bench.systems.gnc.estimators.static_intervals import StaticIntervals

Spans = Sequence[tuple[int, int]]
HORIZONS_s = (3.0, 10.0, 30.0, 60.0)
LATITUDE_deg = 45.0  # where the log does not say: the Earth's rate is in the bias, so only its turning matters
BEYOND = "beyond consumer"


@dataclass(frozen=True)
class RestDrift:
    """Drift over ``horizon_s`` of rest, one row per pair of stretches, in a level frame of any azimuth.

    ``attitude_deg``, ``velocity_m_s``, ``position_m`` (n, 3): at the end; first two axes level, third one down.
    ``white_deg``: attitude per axis that the angle random walk alone would give.
    """

    horizon_s: float
    attitude_deg: Floats
    velocity_m_s: Floats
    position_m: Floats
    white_deg: float

    @property
    def windows(self) -> int:
        """Pairs of stretches."""
        return len(self.attitude_deg)

    @property
    def attitude_rms_deg(self) -> float:
        """Per axis."""
        return rms(self.attitude_deg)

    @property
    def velocity_rms_m_s(self) -> float:
        """Per level axis."""
        return rms(self.velocity_m_s[:, :2])

    @property
    def horizontal_rms_m(self) -> float:
        """Distance in the level plane."""
        return math.sqrt(2.0) * rms(self.position_m[:, :2])

    def std(self, value: float) -> float:
        """Return standard uncertainty of an RMS from so many windows, each counted as one degree of freedom."""
        return value / math.sqrt(2.0 * self.windows)


def drift_at_rest(
    accel: Floats,
    gyro_rad_s: Floats,
    rests: StaticIntervals,
    rate_Hz: float,
    latitude_deg: float = LATITUDE_deg,
    horizons_s: Sequence[float] = HORIZONS_s,
) -> list[RestDrift]:
    """Drift over rests, for every horizon of which twice fits into a rest.

    Args:    accel: (n, 3) m/s^2 or any multiple: gravity's size is taken from the rest.   gyro_rad_s: (n, 3).
             rests: where the unit was at rest.   rate_Hz: of the samples.   latitude_deg: of the site.
    Returns: RestDrift for each horizon that fits, at least one.
    Raises:  FitError B-FIT-140 if no rest is twice as long as the shortest horizon.
    Source:  see the head of this file.
    """
    walk = random_walk(gyro_rad_s, rests, rate_Hz).value
    drifts = []
    for horizon_s in horizons_s:
        count = round(horizon_s * rate_Hz)
        begins = [a + 2 * count * pair for a, b in rests.spans for pair in range((b - a) // (2 * count))]
        if begins:
            drifts.append(_drift(accel, gyro_rad_s, begins, count, rate_Hz, latitude_deg, walk))
    if not drifts:
        longest = float((rests.end - rests.begin).max()) / rate_Hz
        raise FitError(
            "B-FIT-140",
            f"the longest rest is {longest:.3g} s long, {2.0 * min(horizons_s):g} s are needed for bias and drift",
            next_step="leave the unit at rest for two minutes: a drift over 60 s then has its bias from 60 s",
        )
    return drifts


@dataclass(frozen=True)
class RandomWalk:
    """``value`` rad/sqrt(s) per axis, ``std`` its standard uncertainty, ``differences``: of means of 1 s, per axis."""

    value: float
    std: float
    differences: int


def random_walk(gyro_rad_s: Floats, rests: StaticIntervals, rate_Hz: float) -> RandomWalk:
    """Angle random walk from means over 1 s: half the mean square of what follow each other is the Allan variance.

    Args:    gyro_rad_s: (n, 3).   rests: where the unit was at rest.   rate_Hz: of the samples.
    Returns: RandomWalk over all axes and rests; NaN if no rest is 2 s long.
    Source:  IEEE Std 952-1997, annex C.1.1, equation C.8: N is the Allan deviation at 1 s.
    """
    count = max(1, round(rate_Hz))
    steps = []
    for a, b in rests.spans:
        whole = (b - a) // count
        means = gyro_rad_s[a : a + whole * count].reshape(whole, count, 3).mean(axis=1)
        steps.append(np.diff(means, axis=0))
    joined = np.concatenate(steps)
    if not len(joined):
        return RandomWalk(math.nan, math.nan, 0)
    value = rms(joined) / math.sqrt(2.0) * math.sqrt(count / rate_Hz)
    # neighbouring differences share a mean: 1.5 times the variance of independent ones
    return RandomWalk(value, value * math.sqrt(1.5 / (2.0 * joined.size)), len(joined))


def _drift(
    accel: Floats, gyro_rad_s: Floats, begins: list[int], count: int, rate_Hz: float, latitude_deg: float, walk: float
) -> RestDrift:
    calm = [(begin, begin + count) for begin in begins]
    drifting = [(begin + count, begin + 2 * count) for begin in begins]
    run = run_from_rest(accel, gyro_rad_s, calm, drifting, rate_Hz, latitude_deg)
    horizon_s = count / rate_Hz
    return RestDrift(
        horizon_s=horizon_s,
        attitude_deg=np.degrees(_rotation_vectors(run.C @ np.swapaxes(run.C0, 1, 2))),
        velocity_m_s=run.v,
        position_m=run.p,
        white_deg=math.degrees(walk * math.sqrt(2.0 * horizon_s)),
    )


@dataclass(frozen=True)
class RestRun:
    """Strapdown of k lanes from rest: ``C0``, ``C`` (k, 3, 3) body to level at begin and end, ``v`` m/s and ``p`` m
    (k, 3) at the end.
    """

    C0: Floats
    C: Floats
    v: Floats
    p: Floats


def run_from_rest(
    accel: Floats, gyro_rad_s: Floats, calm: Spans, moving: Spans, rate_Hz: float, latitude_deg: float
) -> RestRun:
    """Bias, level and size of gravity from one stretch each, strapdown over another one.

    Azimuth is not known: body x, or y where x stands up, points to the north of the frame. What the gyroscopes read at
    rest, the Earth's rate with it, counts as bias; a unit that is turned away by 90 degrees then errs by 15 deg/h.

    Args:    accel (any unit), gyro_rad_s: (n, 3).   calm, moving: first sample and the one behind the last.
    Returns: RestRun.
    Source:  Groves, section 5.6.2.
    """
    down = normal_gravity(latitude_deg)
    mean = np.stack([accel[a:b].mean(axis=0) for a, b in calm])
    scale = down / np.linalg.norm(mean, axis=1)
    start = np.stack([level(force) for force in mean])
    bias = np.stack([gyro_rad_s[a:b].mean(axis=0) for a, b in calm]) - np.swapaxes(start, 1, 2) @ earth_rate(
        latitude_deg
    )
    lengths = [b - a for a, b in moving]
    dv, dtheta = (np.zeros((max(lengths), len(moving), 3)) for _ in range(2))
    for lane, (a, b) in enumerate(moving):
        dv[: b - a, lane] = accel[a:b] * (scale[lane] / rate_Hz)
        dtheta[: b - a, lane] = (gyro_rad_s[a:b] - bias[lane]) / rate_Hz
    t_s = np.arange(1, len(dv) + 1) / rate_Hz
    track = navigate(t_s, dv, dtheta, np.zeros(3), np.zeros(3), start, latitude_deg, begin_s=0.0)
    last, lanes = np.array(lengths) - 1, np.arange(len(moving))
    return RestRun(start, track.C[last, lanes], track.v[last, lanes], track.p[last, lanes])


def level(force: Floats) -> Floats:
    """Rotation from the body to a level frame, north-east-down, whose north lies as near to body x as it can.

    Args:    force: (3,) mean specific force at rest: it points up.
    Returns: (3, 3).
    Source:  Groves, section 5.6.2.
    """
    down = -force / np.linalg.norm(force)
    ahead = np.eye(3)[0 if abs(down[0]) < 0.9 else 1]
    north = ahead - down * (ahead @ down)
    north /= np.linalg.norm(north)
    return np.stack([north, np.cross(down, north), down])


def _rotation_vectors(matrix: Floats) -> Floats:
    """(n, 3) rad, of rotations by less than half a turn."""
    axis = 0.5 * np.stack(
        [matrix[:, 2, 1] - matrix[:, 1, 2], matrix[:, 0, 2] - matrix[:, 2, 0], matrix[:, 1, 0] - matrix[:, 0, 1]],
        axis=1,
    )
    sine = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(sine, 0.5 * (np.trace(matrix, axis1=1, axis2=2) - 1.0))
    return axis * np.where(sine > 0.0, angle / np.where(sine > 0.0, sine, 1.0), 1.0)[:, None]


@dataclass(frozen=True)
class SensorClass:
    """Largest drift of a class: ``gyro_deg_h``, ``walk_deg_rt_h`` (angle random walk), ``accel_mg``."""

    name: str
    gyro_deg_h: float
    walk_deg_rt_h: float
    accel_mg: float


_TACTICAL = SensorClass("tactical", 10.0, 0.05, 5.0)
_CONSUMER = SensorClass("consumer", 360.0, 5.0, 1000.0)
CLASSES: tuple[SensorClass, ...] = (
    SensorClass("navigation", 0.01, 0.002, 0.1),
    _TACTICAL,
    SensorClass(
        "industrial",
        math.sqrt(_TACTICAL.gyro_deg_h * _CONSUMER.gyro_deg_h),
        math.sqrt(_TACTICAL.walk_deg_rt_h * _CONSUMER.walk_deg_rt_h),
        math.sqrt(_TACTICAL.accel_mg * _CONSUMER.accel_mg),
    ),
    _CONSUMER,
)  # best first
NAMES: tuple[str, ...] = (*(sensor_class.name for sensor_class in CLASSES), BEYOND)


def class_of(figure: str, value: float) -> str:
    """The best class whose bound a figure keeps.

    Args:    figure: name of the bound, such as "gyro_deg_h".   value: >= 0, in its unit.
    Returns: one of ``NAMES``.
    Source:  the table of this module.
    """
    return next(
        (sensor_class.name for sensor_class in CLASSES if value <= float(getattr(sensor_class, figure))), BEYOND
    )


def worst_class(names: Sequence[str]) -> str:
    """Return the class of a unit: that of its worst figure.

    Args:    names: of ``NAMES``, at least one.
    Returns: one of them.
    Source:  none: a unit navigates no better than its worst sensor lets it.
    """
    return max(names, key=NAMES.index)
