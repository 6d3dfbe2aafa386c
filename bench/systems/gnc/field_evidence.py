"""What the readings of a magnetometer say against its ellipse and ellipsoid.

The Earth's field has a size, and noise is shorter than the record; what departs from a surface: ``field_departures``.
Source: docs/method-uncertainty.md.

Roll angle that a module returns over the link, against the table and against other coefficients.

The module answers with its roll angle and the field as it corrects it now. Its own correction is undone, so that the
coefficients of this session can be tried on the same answers: readings that took no part in the fit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bench.analysis import Document, Estimates, Evidence, Exchange, Material, estimate
from bench.model.errors import BenchError
from bench.systems.gnc.estimators.magnetometer.ellipse import EllipseFit, PlaneParameters
from bench.systems.gnc.estimators.magnetometer.ellipsoid import EllipsoidFit
from bench.systems.gnc.estimators.magnetometer.plane import roll_deg
from bench.systems.gnc.estimators.magnetometer.quadric import Quadric
from bench.systems.gnc.wording import say

PLANE = ("mag_offset", "mag_gain", "mag_angle", "mag_radius", "mag_roll_error")
SPHERE = ("mag_hard_iron", "mag_soft_iron")
_FIELD_gauss = (0.15, 0.8)  # of the Earth 0.22 to 0.67 at the ground, and a scale that is off
_LARGEST_IRON = 5.0  # fields
_LARGEST_DISTORTION = 0.3  # of an axis: soft iron and differences of scale
ROLL, SET, RETURNED = "roll", "set_magnetometer", "returned"
_LEAST = 3  # angles that leave something over beside the direction of the field
_STEP_deg, _STEP_gauss = 0.01 / 12.0**0.5, 120e-6 / 12.0**0.5
_NONE: Document = {"offset": [0.0, 0.0, 0.0], "gain": 1.0, "sin_alpha": 0.0}


def endless_noise(quadric: Quadric, what: str, about: Document) -> Evidence:
    """Return whether noise lasts longer than the blocks whose scatter is the uncertainty: that is no departure.

    ``what``: where the readings are from, in words.   ``about``: conditions of its estimates.
    """
    wander, quantities = quadric.wander, PLANE if len(quadric.centre) == 2 else SPHERE
    longer, move = say("evidence.wanders", what=what, together=wander.together), math.inf if wander.is_endless else 0.0
    return Evidence("field_wanders", longer, wander.together, wander.probability, move, quantities, about)


def plausible_plane(fit: EllipseFit, about: Document) -> list[Evidence]:
    """Return what no magnetometer in the Earth's field shows in a turn; empty where all is as it may be."""
    found = fit.parameters
    skew = max(abs(found.gain - 1.0), abs(float(np.sin(np.deg2rad(found.alpha_deg)))))
    return list(_implausible(found.radius, 0.0, float(np.abs(found.offset).max()), skew, PLANE, about))


def shown_unit(unit: str) -> tuple[float, str]:
    """Return factor and name of the unit in which a field is shown: mgauss, or counts as they are."""
    return (1e3, "mgauss") if unit == "gauss" else (1.0, "counts")


def plausible_sphere(fit: EllipsoidFit, unit: str = "gauss") -> list[Evidence]:
    """Return what no magnetometer in the Earth's field shows in many attitudes; empty where all is as it may be.

    Of counts (``unit`` "1") the size of the field is not known.
    """
    least_gauss = _FIELD_gauss[0] if unit == "gauss" else None
    skew = float(np.abs(fit.symmetric - np.eye(3)).max())
    return list(_implausible(fit.norm, least_gauss, float(np.abs(fit.hard_iron).max()), skew, SPHERE, {}))


def _implausible(
    field: float, least_gauss: float | None, iron: float, skew: float, quantities: tuple[str, ...], about: Document
) -> Iterator[Evidence]:
    """Yield what is out of bounds; ``least_gauss`` of the field, None where its size is not known."""
    low, high = _FIELD_gauss
    if least_gauss is not None and not least_gauss <= field <= high:
        text = say("evidence.field", size=field, low=low, high=high)
        yield Evidence("implausible_field", text, field, 0.0, quantities=quantities, conditions=about)
    if iron > _LARGEST_IRON * field:
        text = say("evidence.iron", iron=iron, times=_LARGEST_IRON)
        yield Evidence("implausible_iron", text, iron, 0.0, quantities=quantities, conditions=about)
    if skew > _LARGEST_DISTORTION:
        text = say("evidence.distortion", part=100 * skew, bound=100 * _LARGEST_DISTORTION)
        yield Evidence("implausible_soft_iron", text, 100 * skew, 0.0, quantities=quantities, conditions=about)


@dataclass(frozen=True)
class RollAnswer:
    """``roll_deg``: as returned.   ``x``, ``y``: field before any correction, gauss.   ``size``: of the corrected one.
    ``table_deg``: of the table, NaN if the step does not say.
    """

    roll_deg: float
    x: float
    y: float
    size: float
    table_deg: float


def roll_estimates(
    answers: Sequence[RollAnswer],
    methods: Mapping[str, PlaneParameters],
    chosen: str,
    limit_deg: float,
    noise: float,
) -> Estimates:
    """Return mag_roll as it came, and mag_roll_error against the table by method; a limit judges that of ``chosen``.

    The direction of the field is not known, so one angle common to all answers is taken off. Each answer is a single
    reading: ``noise``, that of the sensor in gauss over the field that the angle is taken from, is the larger part of
    the uncertainty. That of the coefficients is not in it: the error that they leave is what is shown.
    """
    returned_deg = [math.hypot(_STEP_deg, math.degrees(noise / answer.size)) for answer in answers]
    entries = [
        estimate("mag_roll", "deg", answer.roll_deg, std_deg, {"kind": "magnetometer", "answer": number}, n=1)
        for number, (answer, std_deg) in enumerate(zip(answers, returned_deg, strict=True), 1)
    ]
    placed = [answer for answer in answers if math.isfinite(answer.table_deg)]
    if len(placed) < _LEAST:
        return entries
    own_deg = [std_deg for answer, std_deg in zip(answers, returned_deg, strict=True) if answer in placed]
    rolls = {RETURNED: (np.array([answer.roll_deg for answer in placed]), np.array(own_deg))}
    x, y = np.array([answer.x for answer in placed]), np.array([answer.y for answer in placed])
    for name, parameters in methods.items():
        corrected = parameters.corrected(x, y)
        rolls[name] = roll_deg(*corrected), np.degrees(math.hypot(_STEP_gauss, noise) / np.hypot(*corrected))
    table = np.array([answer.table_deg for answer in placed])
    for name, (angles, std_deg) in rolls.items():
        apart = np.exp(1j * np.radians(angles - table))
        error = np.degrees(np.angle(apart / np.mean(apart)))
        less_mean_deg = np.sqrt(std_deg**2 * (1.0 - 2.0 / error.size) + np.mean(std_deg**2) / error.size)
        for answer, value, std in zip(placed, error.tolist(), less_mean_deg.tolist(), strict=True):
            place = {"kind": "magnetometer", "method": name, "roll_deg": answer.table_deg}
            limit = limit_deg if name == chosen and math.isfinite(limit_deg) else None
            entries.append(estimate("mag_roll_error", "deg", value, std, place, n=1, limit=limit))
    return entries


def nominal_answers(exchanges: Sequence[Exchange], radius: float) -> list[RollAnswer]:
    """Return what a module without error will answer where a field of this size turns with the table."""
    tables_deg = [_table_deg(exchange) for exchange in exchanges if exchange.name == ROLL]
    angles_deg = [0.0 if math.isnan(table_deg) else table_deg for table_deg in tables_deg]
    return [
        RollAnswer(angle_deg, radius * math.cos(roll), -radius * math.sin(roll), radius, table_deg)
        for angle_deg, roll, table_deg in zip(angles_deg, map(math.radians, angles_deg), tables_deg, strict=True)
    ]


def _table_deg(exchange: Exchange) -> float:
    return float(exchange.conditions.get("roll_deg", math.nan))


def answers_of(material: Material) -> list[RollAnswer]:
    """Return the answers in their order, each with the correction that was in force."""
    answers, now = [], _NONE
    for exchange in material.exchanges:
        if exchange.status != 0 or exchange.name not in (ROLL, SET) or exchange.name not in material.layouts:
            continue
        layout = material.layouts[exchange.name]
        try:
            if exchange.name == SET:
                now = layout.request.decode(exchange.sent)
            else:
                answers.append(_answer(exchange, layout.decode(exchange.received), now))
        except BenchError:
            continue  # an answer of another length says nothing about a roll angle
    return answers


def _answer(exchange: Exchange, fields: Document, now: Document) -> RollAnswer:
    x, y = float(fields["mag"][0]), float(fields["mag"][1])
    sine = float(now["sin_alpha"])
    return RollAnswer(
        roll_deg=float(fields["roll"]),
        x=x * math.sqrt(1.0 - sine**2) + y * sine + float(now["offset"][0]),
        y=y / float(now["gain"]) + float(now["offset"][1]),
        size=max(math.hypot(x, y), _STEP_gauss),
        table_deg=_table_deg(exchange),
    )
