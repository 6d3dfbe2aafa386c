"""Which class of inertial sensors a drift belongs to: consumer, industrial, tactical or navigation.

Source: El-Sheimy and Youssef, Inertial sensors technologies for navigation applications: state of the art and future
trends, Satellite Navigation 1:2 (2020), table 1: navigation below 0.01 deg/h, 0.002 deg/sqrt(h), 100 ug; tactical 1 to
10 deg/h, 0.02 to 0.05 deg/sqrt(h), 1 to 5 mg; commercial 0.1 deg/s, several deg/sqrt(h), taken as 5, and 100 to 1000,
printed in ug beside the 1 to 5 mg of the better class and taken as mg. The table knows no industrial class; makers sell
one between tactical and commercial. Here it ends at the geometric mean of both: a convention of this program.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

BEYOND = "beyond consumer"


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
NAMES: tuple[str, ...] = (*(one.name for one in CLASSES), BEYOND)


def class_of(figure: str, value: float) -> str:
    """The best class whose bound a figure keeps.

    Args:    figure: name of the bound, such as "gyro_deg_h".   value: >= 0, in its unit.
    Returns: one of ``NAMES``.
    Source:  the table of this module.
    """
    return next((one.name for one in CLASSES if value <= float(getattr(one, figure))), BEYOND)


def worst_class(names: Sequence[str]) -> str:
    """Return the class of a unit: that of its worst figure.

    Args:    names: of ``NAMES``, at least one.
    Returns: one of them.
    Source:  none: a unit navigates no better than its worst sensor lets it.
    """
    return max(names, key=NAMES.index)
