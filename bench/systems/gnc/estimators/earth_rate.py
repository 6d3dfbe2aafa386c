"""The Earth's rate and gravity as a unit on a three-axis table sees them.

Local frame: East, North, Up. A vector of the body stands in the local frame as
``v_n = Rz(90 deg - azimuth) Rz(outer) Ry(middle) Rx(inner) M v_b``, right-handed; M says which body axis lies along
the inner axis of the table, the other two follow cyclically.

Source: GNC module paper section 4.2 (mounts); Groves, Principles of GNSS, Inertial, and Multisensor Integrated
Navigation Systems, section 2.4 (Earth rate in local coordinates).

Records of a gyroscope triad on a turning table: time grid, integrals, noise.

A sample stands for the interval that ends at its own time stamp, so an integral is the sum of output times the step to
the stamp before, as the paper's (its sum of Delta-T N). That is exact for sensors that average over their output
period. For samples taken at an instant it is the trapezoidal rule but for half of the difference of the two ends,
which are both at rest here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.maths.arrays import Flags, Floats, Integers
from bench.model.errors import FitError
from bench.systems.gnc.estimators.triad import AXES, propagate_inputs

EARTH_RATE_DEG_S = math.degrees(7.292115e-5)
TURNED = ("inner", "outer")
_BLOCK_S = 0.25  # noise correlated over less than that is taken in full
_MOVING = 0.02  # of the highest rate: above it the table moves
MARGIN_S = 0.5  # kept clear of a movement: ramps end softly
_LEAST_BLOCKS = 8
_REST_BLOCKS = 20  # of a record at rest
_GAP = 1.5  # steps of the time stamp


@dataclass(frozen=True)
class Site:
    """Where the table stands: latitude and azimuth of the inner axis at zero angles (clockwise from North), degrees.

    ``tilt_std_deg``: standard uncertainty of each of the three small angles by which the unit is not in the pose asked
    for.
    """

    latitude_deg: float
    azimuth_deg: float
    tilt_std_deg: float = 0.0


@dataclass(frozen=True)
class Pose:
    """Angles of the table in degrees, and the body axis ("x", "y", "z") that lies along its inner axis."""

    outer_deg: float = 0.0
    middle_deg: float = 0.0
    inner_deg: float = 0.0
    mounting: str = "x"


def mounting_matrix(mounting: str) -> Floats:
    """M (3, 3): table = M body. "x": identity; "y": (y, z, x); "z": (z, x, y). Source: the frame of this module."""
    return np.roll(np.eye(3), AXES.index(mounting), axis=1)


def table_to_local(site: Site) -> Floats:
    """(3, 3) from the frame of the table's base (inner axis at zero angles first, Up last) to East, North, Up."""
    return turned_about(2, 90.0 - site.azimuth_deg)


def attitude(pose: Pose, site: Site) -> Floats:
    """(3, 3) matrix that takes a vector from the body to East, North, Up. Source: the formula of this module."""
    return table_to_local(site) @ body_to_table(pose)


def body_to_table(pose: Pose) -> Floats:
    """(3, 3) from the body to the frame of the table's base."""
    outer, middle = turned_about(2, pose.outer_deg), turned_about(1, pose.middle_deg)
    return outer @ middle @ turned_about(0, pose.inner_deg) @ mounting_matrix(pose.mounting)


def turned_about(axis: int, angle_deg: float) -> Floats:
    """Right-handed rotation matrix (3, 3) about axis 0, 1 or 2 by an angle in degrees."""
    angle, second, third = math.radians(angle_deg), (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[second, second] = matrix[third, third] = math.cos(angle)
    matrix[second, third], matrix[third, second] = -math.sin(angle), math.sin(angle)
    return matrix


def earth_rate_local_deg_s(latitude_deg: float) -> Floats:
    """(3,) East, North, Up: omega (0, cos lat, sin lat), deg/s. Source: Groves, equation (2.123) turned to ENU."""
    latitude = math.radians(latitude_deg)
    return EARTH_RATE_DEG_S * np.array([0.0, math.cos(latitude), math.sin(latitude)])


def earth_rate_body_deg_s(pose: Pose, site: Site) -> Floats:
    """(3,) what ideal gyroscopes read on a table at rest, deg/s; to be taken off a measured rate.

    Args:    pose, site: of the unit.
    Returns: (3,) deg/s in body axes. For a level axis it is omega cos(latitude) cos(its azimuth).
    Raises:  nothing.
    Source:  the formula of this module.
    """
    return attitude(pose, site).T @ earth_rate_local_deg_s(site.latitude_deg)


def earth_rate_covariance(pose: Pose, site: Site) -> Floats:
    """Return covariance (3, 3), (deg/s)^2, of ``earth_rate_body_deg_s`` from the tilt of the site.

    Args:    pose, site: as above.
    Returns: (3, 3).
    Raises:  nothing.
    Source:  JCGM 102:2011 section 6.2.
    """
    seen = earth_rate_body_deg_s(pose, site)

    def tilted(tilt_deg: Floats) -> Floats:
        return seen + np.cross(seen, np.radians(tilt_deg))

    return propagate_inputs(tilted, np.zeros(3), np.eye(3) * site.tilt_std_deg**2)


def up_in_body(pose: Pose) -> Floats:
    """(3,) unit vector: the specific force at rest, in g, that ideal accelerometers read. Source: this module."""
    return np.asarray(body_to_table(pose)[2])


def direction_of(up: str) -> Floats:
    """(3,) unit vector in body axes of an axis that points up, such as "-x"."""
    direction = np.zeros(3)
    direction[AXES.index(up[1])] = 1.0 if up[0] == "+" else -1.0
    return direction


def turn_axis_in_body(pose: Pose, turned: str) -> Floats:
    """(3,) unit vector in body axes about which the unit turns at a positive rate of the table axis.

    Args:    pose: at the begin of the turn.   turned: "inner" or "outer".
    Returns: (3,), constant during the turn.
    Raises:  ValueError for another axis.
    Source:  the formula of this module.
    """
    if turned not in TURNED:
        raise ValueError(f"a table axis {turned!r} is none of {', '.join(TURNED)}")
    if turned == "outer":
        return up_in_body(pose)
    return np.asarray(mounting_matrix(pose.mounting)[0])


@dataclass(frozen=True)
class RotationRecord:
    """One turn about one body axis, with rest before or behind it.

    ``axis``: body axis "x", "y" or "z".   ``turn_deg``: the turn about it, right-handed, signed.
    ``counter`` (n,): of the samples, unwrapped.   ``time_s`` (n,): time stamps of the unit, unwrapped, increasing.
    ``rate`` (n, 3): indicated rates.   ``pose``: of the table at the begin, None if the Earth's rate is not to be
    compensated.   ``turned``: the table axis that turns, "inner" or "outer".   ``begin_s``: by any clock.
    """

    axis: str
    turn_deg: float
    counter: Integers
    time_s: Floats
    rate: Floats
    pose: Pose | None = None
    turned: str = "inner"
    begin_s: float = 0.0

    @property
    def name(self) -> str:
        """As the paper files it: X+1080."""
        return f"{self.axis.upper()}{self.turn_deg:+.0f}"


@dataclass(frozen=True)
class Samples:
    """Good samples of a record: ``step_s`` (n,) to the stamp before, ``rate`` (n, 3), ``duplicates`` dropped."""

    step_s: Floats
    rate: Floats
    duplicates: int

    @property
    def duration_s(self) -> float:
        return float(np.sum(self.step_s))

    def first(self, count: int) -> Samples:
        return Samples(self.step_s[:count], self.rate[:count], self.duplicates)


def record_about(records: Sequence[RotationRecord], axis: str, sign: float | None) -> RotationRecord:
    """The one record about an axis, in a direction if it is given.

    Args:    records: all.   axis: "x", "y" or "z".   sign: of the turn, or None for either.
    Returns: the record.
    Raises:  FitError B-FIT-081 if there is none or more than one.
    Source:  GNC module paper section 4.2 1): one record each.
    """
    chosen = [r for r in records if r.axis == axis and (sign is None or r.turn_deg * sign > 0.0)]
    if len(chosen) != 1:
        direction = "" if sign is None else f" in the direction {'+' if sign > 0.0 else '-'}"
        raise FitError(
            "B-FIT-081",
            f"{len(chosen)} records turn about {axis}{direction}, 1 is due",
            next_step="take each axis once forth and once back; leave repeated records out",
        )
    return chosen[0]


def good_samples(record: RotationRecord) -> Samples:
    """Drop samples whose counter was there already; refuse a record with a gap.

    Args:    record: as recorded.
    Returns: Samples; the first one stands for a step of the usual length.
    Raises:  FitError B-FIT-080 naming the counter at which samples are missing: an integral over a gap is invented.
    Source:  GNC module paper section 4.2 1): an integral needs every sample.
    """
    new = np.concatenate([[True], np.diff(record.counter) != 0])
    counter, time_s, rate = record.counter[new], record.time_s[new], record.rate[new]
    if len(counter) < 2:
        raise _no_rest(record.name, len(counter))
    step_s = np.diff(time_s)
    usual = float(np.median(step_s))
    wrong = (np.diff(counter) != 1) | (step_s > _GAP * usual) | (step_s <= 0.0)
    if wrong.any():
        place = int(np.argmax(wrong))
        raise FitError(
            "B-FIT-080",
            f"record {record.name}: samples are missing or out of order behind counter {counter[place]}: the next one "
            f"is {counter[place + 1]}, {step_s[place]:.4g} s later, where {usual:.4g} s are usual",
            next_step="take this rotation again; an integral cannot bridge a gap",
        )
    return Samples(np.concatenate([[usual], step_s]), rate, int(np.sum(~new)))


def resting(samples: Samples, axis: str) -> Flags:
    """(n,) samples before and behind the movement, with a margin of 0.5 s. Source: GNC module paper 4.2 1), 10 s."""
    rate = samples.rate[:, AXES.index(axis)]
    level = float(np.median(rate[-max(len(rate) // 20, 1) :]))
    moving = np.flatnonzero(np.abs(rate - level) > _MOVING * np.max(np.abs(rate - level)))
    if moving.size == 0:
        return np.ones(len(rate), dtype=bool)
    time_s = np.cumsum(samples.step_s)
    begin, end = time_s[moving[0]], time_s[moving[-1]]
    return np.asarray((time_s < begin - MARGIN_S) | (time_s > end + MARGIN_S))


def noise_density(samples: Samples, axis: str, name: str) -> tuple[Floats, float]:
    """White noise of the outputs from the samples at rest, as means of 0.25 s so that short correlation counts.

    Args:    samples: of one record.   axis: that turns.   name: of the record, for the message.
    Returns: covariance per second (3, 3): times T it is that of the integral over T; its degrees of freedom.
    Raises:  FitError B-FIT-083 if less than 2 s at rest are left.
    Source:  IEEE Std 952 annex C (angle random walk); blocks as in batch means.
    """
    rest = samples.rate[resting(samples, axis)]
    step_s = float(np.median(samples.step_s))
    length, blocks = _blocks(samples, len(rest), name)
    means = rest[len(rest) - blocks * length :].reshape(blocks, length, 3).mean(axis=1)
    return np.atleast_2d(np.cov(means.T)) * length * step_s, blocks - 1.0


def noise_dof(samples: Samples, axis: str, name: str) -> float:
    """Return the degrees of freedom that ``noise_density`` has. Args, Raises: as there. Source: batch means."""
    return _blocks(samples, int(resting(samples, axis).sum()), name)[1] - 1.0


def _blocks(samples: Samples, resting_samples: int, name: str) -> tuple[int, int]:
    """Return samples in a block and the number of blocks."""
    step_s = float(np.median(samples.step_s))
    length = max(1, round(_BLOCK_S / step_s))
    blocks = resting_samples // length
    if blocks < _LEAST_BLOCKS:
        raise _no_rest(name, blocks * length * step_s)
    return length, blocks


def quantisation_variance(std: Floats, resolution: float) -> Floats:
    """Variance of the mean of a resting output that quantisation leaves although many samples are averaged.

    The mean of a quantised value is off by the sum over k of q / (pi k) exp(-2 pi^2 k^2 sigma^2 / q^2) times a sine
    over the position within a step, which is taken as uniform; without noise that is the q^2 / 12 of one reading.

    Args:    std: (...,) of single samples.   resolution: q, same unit.
    Returns: (...,) unit squared, to be taken as common to a whole record.
    Raises:  nothing.
    Source:  Widrow and Kollar, Quantization Noise, chapter 4 (moments of a quantised variable).
    """
    if resolution <= 0.0:
        return np.zeros_like(std)
    k = np.arange(1, 201)
    size = resolution / (math.pi * k) * np.exp(-2.0 * (math.pi * k * std[..., None] / resolution) ** 2)
    return np.asarray(np.sum(size**2, axis=-1) / 2.0)


@dataclass(frozen=True)
class RestNoise:
    """Noise at rest.   ``density`` (3, 3): times 1 / samples it is the covariance of their mean.   ``std`` (3,): of a
    sample.   ``slow`` (3,): variance that averages out no further within a record.
    """

    density: Floats
    std: Floats
    slow: Floats

    def of_means(self, samples: Sequence[int], resolution: float) -> Floats:
        """Return the covariance of the means of records of so many samples, (n, 3, 3)."""
        fixed = np.diag(quantisation_variance(self.std, resolution)) + np.diag(self.slow)
        return np.stack([self.density / count + fixed for count in samples])


def rest_dof(samples: Sequence[int], rate_Hz: float) -> float:
    """Return the degrees of freedom of the noise of records of so many samples.

    Args:    samples: (n,), of each record.   rate_Hz: of the samples.
    Raises:  FitError B-FIT-083 for a record of fewer samples than blocks.
    Source:  batch means.
    """
    if min(samples) < _REST_BLOCKS:
        raise _no_rest("at rest", min(samples) / rate_Hz)
    return (_REST_BLOCKS - 1.0) * len(samples)


def static_means(poses: list[Floats], rate_Hz: float, *, resolution: float = 0.0) -> tuple[Floats, Floats, float]:
    """Return mean output of each record at rest and its covariance, the noise density pooled over all records.

    What the halves of the records differ by beyond that noise is slower than it and averages out no further: it is
    added to each mean. The noise is taken from 20 means per record, so noise correlated over 1/20 of it counts.

    Args:    poses: arrays (m, 3) of samples.   rate_Hz: of the samples.   resolution: of one step of the output.
    Returns: means (n, 3), their covariance (n, 3, 3), and its degrees of freedom.
    Raises:  FitError B-FIT-083 for a record of fewer samples than blocks.
    Source:  batch means; Allan variance of two samples, half a record each, IEEE Std 952-1997 annex C; quantisation as
             in ``quantisation_variance``.
    """
    counts = [len(samples) for samples in poses]
    dof = rest_dof(counts, rate_Hz)
    density, std2, slow = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    for samples in poses:
        length, half = len(samples) // _REST_BLOCKS, len(samples) // 2
        means = samples[: _REST_BLOCKS * length].reshape(_REST_BLOCKS, length, 3).mean(axis=1)
        density += np.cov(means.T) * length / len(poses)
        std2 += np.var(samples, axis=0) / len(poses)
        slow += (samples[:half].mean(axis=0) - samples[-half:].mean(axis=0)) ** 2 / 2.0 / len(poses)
    slow -= density.diagonal() * np.mean([2.0 / count for count in counts])
    noise = RestNoise(density, np.sqrt(std2), np.maximum(slow, 0.0))
    return np.stack([samples.mean(axis=0) for samples in poses]), noise.of_means(counts, resolution), dof


def _no_rest(name: str, seconds: float) -> FitError:
    return FitError(
        "B-FIT-083",
        f"record {name}: {seconds:.3g} s at rest are too few to tell the noise (2 s, or 20 means)",
        next_step="keep recording for 10 s after the table has stopped, as the paper does",
    )
