"""Inputs and outputs of the filter of the time offset.

Conventions: navigation frame t = local tangent plane, north-east-down, fixed to the Earth; errors are estimate minus
truth; T_d > 0 means that the EGI sample is old: a sample tagged t_k is the truth at t_k - T_d, in times of the IMU.

Source: Lee et al., JKSAS 48(4), 2020, equations (4)-(13), with the signs of errors taken as estimate minus truth.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Protocol

import numpy as np

from bench.maths.arrays import Flags, Floats
from bench.maths.geodesy import TangentFrame

STATES = 16  # position, velocity, attitude, accelerometer bias, gyro bias (3 each), time offset
OFFSET = 15  # index of the time offset
NIS_BLOCKS = ("all", "position", "velocity", "attitude")  # last axis of the innovations squared
STANDARD_GRAVITY_m_s2 = 9.80665


class EgiSource(Protocol):
    """EGI samples, handed out in blocks so that a study need not hold them all.

    ``t_s`` (m,): tags, ascending, by the clock of the EGI; they need not lie on the grid of the IMU, and lost samples
    are absent or NaN.
    """

    @property
    def t_s(self) -> Floats: ...

    def block(self, k0: int, k1: int) -> tuple[Floats, Floats, Floats]:
        """Position (k, G, R, 3) m, velocity (k, G, R, 3) m/s and body-to-t matrix (k, G, R, 3, 3) of samples k0 to
        k1 - 1, or up to the last; NaN = missing or not usable. G and R may be 1: the same for all.
        """
        ...


@dataclass(frozen=True)
class EgiSamples:
    """Solutions of the EGI in the tangent frame at the first of them; an ``EgiSource`` that is the same for all.

    ``t_s``: (m,) time tags.   ``p`` (m, 3) m, ``v`` (m, 3) m/s, ``C`` (m, 3, 3) body to tangent frame.
    ``position_std_m``: as the unit states it, the median.
    """

    t_s: Floats
    p: Floats
    v: Floats
    C: Floats
    frame: TangentFrame
    position_std_m: float

    def part(self, which: Flags) -> EgiSamples:
        """Return some of them, ``which`` (m,)."""
        return replace(self, t_s=self.t_s[which], p=self.p[which], v=self.v[which], C=self.C[which])

    def block(self, k0: int, k1: int) -> tuple[Floats, Floats, Floats]:
        """Return samples k0 to k1 - 1, as one group of one lane."""
        part = slice(k0, k1), None, None
        return self.p[part], self.v[part], self.C[part]


@dataclass(frozen=True)
class ImuSamples:
    """Increments of the IMU; R lanes, shared by all groups.

    ``t_s`` (n,): ends of the intervals.   ``dv`` (n, R, 3): m/s, body.   ``dtheta`` (n, R, 3): rad, body.
    ``filled`` (n,): made up because the sample was lost; the process noise is wider there.
    """

    t_s: Floats
    dv: Floats
    dtheta: Floats
    filled: Flags


@dataclass(frozen=True)
class ImuDensities:
    """Errors of the IMU, one sigma; the defaults are Table 2 of the paper.

    ``accel_bias_ug``, ``gyro_bias_deg_h``: constant over the run.   ``velocity_walk_ug``: micro-g per root hertz.
    ``angle_walk_deg_rt_h``: degrees per root hour.
    """

    accel_bias_ug: float = 200.0
    velocity_walk_ug: float = 20.0
    gyro_bias_deg_h: float = 1.0
    angle_walk_deg_rt_h: float = 0.07

    @property
    def velocity_walk(self) -> float:
        """m/s per root second."""
        return self.velocity_walk_ug * 1e-6 * STANDARD_GRAVITY_m_s2

    @property
    def angle_walk(self) -> float:
        """rad per root second."""
        return float(np.deg2rad(self.angle_walk_deg_rt_h) / 60.0)

    @property
    def bias_sigmas(self) -> tuple[float, float]:
        """Accelerometers m/s^2, gyros rad/s."""
        accel = self.accel_bias_ug * 1e-6 * STANDARD_GRAVITY_m_s2
        return accel, float(np.deg2rad(self.gyro_bias_deg_h) / 3600.0)


@dataclass(frozen=True)
class EgiSpread:
    """Errors of an EGI, one sigma per axis.

    ``position_m``, ``velocity_m_s``: wander and return with the time constant ``wander_s``.   ``heading_deg``: does so
    with ``heading_wander_s``, for a manoeuvre shows the unit its heading while it lasts.   ``level_deg``: roll and
    pitch, constant. The defaults but the position are those of a navigation-grade unit with GPS (0.003 deg/h, 25 ug,
    paper's Table 1).
    """

    position_m: float = 0.3
    velocity_m_s: float = 0.017
    level_deg: float = 0.0013
    heading_deg: float = 0.0144
    wander_s: float = 20.0
    heading_wander_s: float = 100.0


TIGHT = (1.0, 0.05, 0.01)  # measurement noise: position m, velocity m/s, attitude deg
LOOSE = (10.0, 2.0, 0.05)


@dataclass(frozen=True)
class FilterSetup:
    """One filter per group; G groups run side by side on the same IMU.

    Attributes:
        augmented: (G,) the time offset is a state; where it is not it stays at ``offset0_s``.
        sigma_r: (G, 3) measurement noise, (position m, velocity m/s, attitude deg).
        latitude_deg: of the origin of the tangent frame.
        offset0_s: first estimate of the offset.   offset_sigma_s: its uncertainty.
        position_sigma_m, velocity_sigma_m_s, attitude_sigma_deg: first uncertainties per axis. The state begins at the
            first EGI sample, so its position is off by -v T_d too: a position sigma below v T_d (1 m) makes the filter
            take that for knowledge about the offset.
        imu: errors of the IMU.   egi: real errors of the EGI, of which the filter knows nothing; None if nobody asks
            what they do.
        look_ahead_s: the filter uses a sample tagged t once the IMU has come to t + look_ahead_s; offsets down to
            -look_ahead_s are then interpolated, beyond it extrapolated.
        reach_s: how old a sample may be: offsets up to here are interpolated.
        keep_every: EGI samples per kept epoch.
        fine_from_s: from here p, v and C are kept after every IMU sample.
        hold_position_from_s: from here (while the radar collects) only the attitude of the EGI is used; what it says
            about the position and velocity follows from their correlation alone and is small.
        edges_s: (b + 1,) of blocks of EGI samples; ``FilterRun.response`` says what an error of each does.
    """

    augmented: tuple[bool, ...]
    sigma_r: tuple[tuple[float, float, float], ...]
    latitude_deg: float = 37.5
    offset0_s: float = 0.0
    offset_sigma_s: float = 0.03
    position_sigma_m: float = 10.0
    velocity_sigma_m_s: float = 0.1
    attitude_sigma_deg: float = 0.05
    imu: ImuDensities = ImuDensities()
    egi: EgiSpread | None = None
    look_ahead_s: float = 0.05
    reach_s: float = 0.6
    keep_every: int = 1
    fine_from_s: float = np.inf
    hold_position_from_s: float = np.inf
    edges_s: Floats = field(default_factory=lambda: np.array([-np.inf, np.inf]))

    @property
    def groups(self) -> int:
        return len(self.augmented)


@dataclass(frozen=True)
class FineTrack:
    """Navigation solution after every IMU sample from ``fine_from_s`` on: ``t_s`` (q,), ``p``, ``v`` (q, G, R, 3),
    ``C`` (q, G, R, 3, 3) body to t.
    """

    t_s: Floats
    p: Floats
    v: Floats
    C: Floats


@dataclass(frozen=True)
class FilterRun:
    """Estimates at the kept epochs (m of them), right after the correction.

    Attributes:
        t_s: (m,) times of the IMU at which the estimates are valid.
        p, v: (m, G, R, 3).   C: (m, G, R, 3, 3) body to t.   accel_bias m/s^2, gyro_bias rad/s: (m, G, R, 3).
        offset_s: (m, G, R).
        covariance: (m, G, 16, 16), shared by the lanes of a group; order position, velocity, attitude (rotation
            vector in t), accelerometer bias, gyro bias, offset.
        nis: (m, G, 4) normalised innovations squared, by NIS_BLOCKS, mean over the lanes and over all EGI samples
            since the kept epoch before; NaN where there was none.   nis_outside: (m, G, 4) share of them outside
            their 95 % interval.   nis_count: (m, G, 4) how many they were.
        first_covariance: (G, 16, 16) at the begin.
        fine: every IMU sample of the end, or None.
        real_covariance: (G, 16, 16) of the errors at the end with the real errors of the EGI, None without them.
        response: (G, 16, b, 9) what an error of 1 of all EGI samples of a block makes of them, None likewise.
    """

    t_s: Floats
    p: Floats
    v: Floats
    C: Floats
    accel_bias: Floats
    gyro_bias: Floats
    offset_s: Floats
    covariance: Floats
    nis: Floats
    nis_outside: Floats
    nis_count: Floats
    _: KW_ONLY
    first_covariance: Floats
    fine: FineTrack | None
    real_covariance: Floats | None = None
    response: Floats | None = None

    @property
    def sigma(self) -> Floats:
        """(m, G, 16), roots of the diagonal of the covariance."""
        return np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1))
