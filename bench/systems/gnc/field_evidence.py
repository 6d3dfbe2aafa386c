"""What the readings of a magnetometer say against its ellipse and ellipsoid.

The Earth's field has a size, noise is shorter than the record, the surface is a quadric, and a turn about one axis is
a section of the surface that all attitudes give.
Source: docs/decisions/0025-doubt.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import special

from bench.analysis import Evidence, Floats
from bench.maths.verdict import coverage_factor
from bench.systems.gnc.estimators.magnetometer.ellipse import EllipseFit
from bench.systems.gnc.estimators.magnetometer.ellipsoid import EllipsoidFit
from bench.systems.gnc.estimators.magnetometer.misshape import misshape
from bench.systems.gnc.estimators.magnetometer.quadric import Quadric
from bench.systems.gnc.estimators.magnetometer.section import section_of
from bench.systems.gnc.wording import say

PLANE = ("mag_offset", "mag_gain", "mag_angle", "mag_radius", "mag_roll_error")
SPHERE = ("mag_hard_iron", "mag_soft_iron")
_FIELD_gauss = (0.15, 0.8)  # of the Earth 0.22 to 0.67 at the ground, and a scale that is off
_LARGEST_IRON = 5.0  # fields
_LARGEST_DISTORTION = 0.3  # of an axis: soft iron and differences of scale
_SMALLEST = 1e-300  # a probability that is lost in the arithmetic is still one
_ROUNDING = 1e-18  # variance, gauss^2


def surface_evidence(
    quadric: Quadric,
    points: Floats,
    begins: Sequence[int],
    what: str,
    about: Mapping[str, Any],
    unit: str = "gauss",
) -> list[Evidence]:
    """Return what the residuals of a curve or surface say: noise longer than the record tells, another shape.

    ``points``: those of the fit, in ``unit``.   ``what``: where the readings are from, in words.   ``about``:
    conditions of its estimates.
    """
    factor, name = shown_unit(unit)
    quantities = PLANE if points.shape[1] == 2 else SPHERE
    wander, bent = quadric.wander, misshape(quadric, points, begins)
    longer = say("evidence.wanders", what=what, together=wander.together)
    shape = say("evidence.shape", what=what, size=factor * bent.size, unit=name, move=bent.move)
    return [
        Evidence(
            "field_wanders",
            longer,
            wander.together,
            max(wander.probability, _SMALLEST),
            math.inf if wander.is_endless else 0.0,
            quantities,
            about,
        ),
        Evidence("not_an_ellipsoid", shape, factor * bent.size, bent.probability, bent.move, quantities, about),
    ]


def plausible_plane(fit: EllipseFit, about: Mapping[str, Any]) -> list[Evidence]:
    """Return what no magnetometer in the Earth's field shows in a turn; empty where all is as it may be."""
    found = fit.parameters
    reasons = _field(found.radius, 0.0) + _iron(float(np.abs(found.offset).max()), found.radius)
    reasons += _distortion(max(abs(found.gain - 1.0), abs(float(np.sin(np.deg2rad(found.alpha_deg))))))
    return [Evidence(code, text, figure, 0.0, quantities=PLANE, conditions=about) for code, text, figure in reasons]


def shown_unit(unit: str) -> tuple[float, str]:
    """Return factor and name of the unit in which a field is shown: mgauss, or counts as they are."""
    return (1e3, "mgauss") if unit == "gauss" else (1.0, "counts")


def plausible_sphere(fit: EllipsoidFit, unit: str = "gauss") -> list[Evidence]:
    """Return what no magnetometer in the Earth's field shows in many attitudes; empty where all is as it may be.

    Of counts (``unit`` "1") the size of the field is not known.
    """
    reasons = (_field(fit.norm, _FIELD_gauss[0]) if unit == "gauss" else []) + _iron(
        float(np.abs(fit.hard_iron).max()), fit.norm
    )
    reasons += _distortion(float(np.abs(fit.symmetric - np.eye(3)).max()))
    return [Evidence(code, text, figure, 0.0, quantities=SPHERE) for code, text, figure in reasons]


def _field(size_gauss: float, least_gauss: float) -> list[tuple[str, str, float]]:
    if least_gauss <= size_gauss <= _FIELD_gauss[1]:
        return []
    low, high = _FIELD_gauss
    text = say("evidence.field", size=size_gauss, low=low, high=high)
    return [("implausible_field", text, size_gauss)]


def _iron(iron_gauss: float, field_gauss: float) -> list[tuple[str, str, float]]:
    if iron_gauss <= _LARGEST_IRON * field_gauss:
        return []
    text = say("evidence.iron", iron=iron_gauss, times=_LARGEST_IRON)
    return [("implausible_iron", text, iron_gauss)]


def _distortion(part: float) -> list[tuple[str, str, float]]:
    if part <= _LARGEST_DISTORTION:
        return []
    text = say("evidence.distortion", part=100 * part, bound=100 * _LARGEST_DISTORTION)
    return [("implausible_soft_iron", text, 100 * part)]


def section_evidence(plane: EllipseFit, sphere: EllipsoidFit, turn: Floats, about: Mapping[str, Any]) -> Evidence:
    """Return whether the ellipse of a turn is the section of the ellipsoid at its readings ``turn`` (n, 3).

    The size of the field is left out: it may change from record to record, which moves neither iron nor gain.
    """
    there = section_of(sphere.quadric, turn[~plane.odd])
    apart = (plane.parameters.values - there.values)[:4]
    variance = np.diag(plane.parameters.covariance)[:4]
    score = np.abs(apart) / np.sqrt(np.maximum(variance + np.diag(there.covariance)[:4], _ROUNDING))
    score = np.nan_to_num(score, nan=np.inf)  # a plane beside the ellipsoid
    dof = np.minimum(plane.parameters.dof, there.dof)[:4]
    probability = float(min(1.0, 2.0 * score.size * special.stdtr(dof, -score).min()))
    least = np.minimum(variance, np.diag(there.covariance)[:4])
    move = float(
        np.nan_to_num(np.abs(apart) / (coverage_factor() * np.sqrt(np.maximum(least, _ROUNDING))), nan=np.inf).max()
    )
    text = say("evidence.section", score=float(score.max()), move=move)
    return Evidence(
        "turn_against_attitudes", text, float(score.max()), max(probability, _SMALLEST), move, (*PLANE, *SPHERE), about
    )
