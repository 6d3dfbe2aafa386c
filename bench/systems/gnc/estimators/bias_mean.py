"""Bias as the mean of a record of minutes, its uncertainty from the Allan deviation, and the bias of a flip.

Source: GNC paper (001) section 5.1 3); IEEE Std 952-1997 annex C (white noise of the rate: N / sqrt(T)).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bench.maths.allan import (
    AllanDeviation,
    allan_deviation,
    expected_curve,
)
from bench.maths.arrays import Floats
from bench.model.errors import FitError
from bench.systems.gnc.estimators.sensor_noise import SensorNoise

LEAST_s = 60.0
_WHITE_s = 1.0  # averaging time at which the white noise is read
_SLOW_PARTS = 8  # of the record: the longest averages whose scatter is seen at all well
_UNDITHERED = 0.5  # noise in steps of the output below which its rounding does not average out


@dataclass(frozen=True)
class BiasMean:
    """Mean of a record, unit of the samples.

    Attributes:
        value: mean.   std: standard uncertainty, dof: its degrees of freedom.   samples, missing: counts.
    """

    value: float
    std: float
    dof: float
    samples: int
    missing: int


def mean_bias(samples: Floats, interval_s: float, resolution: float = 0.0) -> BiasMean:
    """Mean and its uncertainty from the scatter at 1 s (white noise) and at an eighth of the record (slow noise).

    Args:    samples: (m,), NaN where one is missing.   interval_s: between samples.   resolution: step of the output.
    Returns: BiasMean.
    Raises:  FitError B-FIT-092 for less than a minute of samples.
    Source:  see the head of this file; degrees of freedom by Welch and Satterthwaite, JCGM 100:2008 G.4.1.
    """
    good = np.isfinite(samples)
    length_s = float(good.sum()) * interval_s
    _require(length_s)
    curve = allan_deviation(samples, interval_s, factors=_factors(samples.size, interval_s))
    centre = float(np.median(samples[good]))
    value, spread = centre + float((samples[good] - centre).mean()), float(np.std(samples[good], ddof=1))
    return _mean(value, spread, curve, resolution, length_s, int(good.sum()), int((~good).sum()))


def declared_mean(value: float, noise: SensorNoise, samples: int) -> BiasMean:
    """Return the same of a record that is not there yet, by declared noise.

    Args:    value: of the mean.   noise: of the sensor.   samples: in the record.
    Returns: BiasMean.
    Raises:  FitError B-FIT-092 as ``mean_bias``.
    Source:  as ``mean_bias``, its Allan deviation the expected one and its degrees of freedom those of white noise.
    """
    interval_s, length_s = noise.interval_s, samples * noise.interval_s
    _require(length_s)
    factors = np.array(_factors(samples, interval_s))
    deviation = np.sqrt([noise.allan_variance(m * interval_s) for m in factors])
    curve = expected_curve(interval_s, samples, factors, deviation)
    return _mean(value, noise.sample_std, curve, noise.step, length_s, samples, 0)


def _factors(samples: int, interval_s: float) -> list[int]:
    return sorted({max(1, round(_WHITE_s / interval_s)), max(1, samples // _SLOW_PARTS)})


def _require(length_s: float) -> None:
    if length_s < LEAST_s:
        raise FitError(
            "B-FIT-092",
            f"{length_s:.1f} s of samples are too few for a bias (at least {LEAST_s:g} s)",
            next_step="record 3 minutes at rest",
        )


def _mean(
    value: float, spread: float, curve: AllanDeviation, resolution: float, length_s: float, samples: int, missing: int
) -> BiasMean:
    """Return a mean with its uncertainty by white noise, slow noise and steps; ``spread``: of single samples."""
    random_walk = float(curve.deviation[0] * math.sqrt(curve.tau_s[0]))
    white = random_walk / math.sqrt(length_s)
    slow, slow_dof = _slow_part(curve, random_walk)
    rounding = resolution / math.sqrt(12.0) if spread < _UNDITHERED * resolution else 0.0
    std = math.sqrt(white**2 + slow**2 + rounding**2)
    fourth = white**4 / float(curve.dof[0]) + slow**4 / slow_dof
    return BiasMean(
        value=value,
        std=std,
        dof=std**4 / fourth if fourth > 0.0 else math.inf,
        samples=samples,
        missing=missing,
    )


def flip_bias(first: BiasMean, second: BiasMean, *, axis: str, about: str) -> BiasMean:
    """Bias of a level accelerometer from readings before and after a half turn, (Y1 + Y2) / 2.

    The half turn must reverse the axis: a tilt of the table then changes sign with it and cancels. Turned about the
    axis itself the tilt stays where it is and is taken for bias: 0.29 mg for one arcminute.

    Args:    first, second: means before and after.   axis: which body axis is read, "x", "y" or "z".   about: body
             axis of the half turn.
    Returns: BiasMean.
    Raises:  FitError B-FIT-094 if the axis is the one that was turned about.
    Source:  GNC paper section 5.1 3), the flip about X for axis Y.
    """
    if axis == about:
        raise FitError(
            "B-FIT-094",
            f"a half turn about {about} does not reverse axis {axis}: the table's tilt would be taken for its bias",
            next_step=f"turn about {'x' if axis != 'x' else 'y'} to find the bias of {axis}",
        )
    parts = np.array([first.std / 2.0, second.std / 2.0])
    std = float(np.linalg.norm(parts))
    fourth = parts[0] ** 4 / first.dof + parts[1] ** 4 / second.dof
    return BiasMean(
        value=(first.value + second.value) / 2.0,
        std=std,
        dof=std**4 / fourth if fourth > 0.0 else math.inf,
        samples=first.samples + second.samples,
        missing=first.missing + second.missing,
    )


def _slow_part(curve: AllanDeviation, random_walk: float) -> tuple[float, float]:
    """Noise at the longest averages beyond the white one, where its interval leaves the white one out; its dof."""
    expected = random_walk / math.sqrt(float(curve.tau_s[-1]))
    if curve.tau_s.size < 2 or float(curve.low[-1]) <= expected:
        return 0.0, math.inf
    return math.sqrt(float(curve.deviation[-1]) ** 2 - expected**2), float(curve.dof[-1])
