"""Random walk of one record before and behind every compensator, and the constants of its lock-in.

Estimates of a ring laser before and after compensation, and what is required of an alignment with it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from bench.analysis import Document, Estimates, estimate, stated_limits
from bench.maths.allan_terms import NoiseTerm
from bench.maths.tests import chi2_tail
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError
from bench.systems.lock_in.compensation import COMPENSATORS, GLOBAL, RAW, Compensated, compensated
from bench.systems.lock_in.declaration import DECLARATION
from bench.systems.lock_in.estimators.random_walk import (
    RandomWalk,
    alignment_time_s,
    expected_random_walk,
    gyro_gain,
    output_deviation,
    path_exponent,
    random_walk,
    shared_variance,
)
from bench.systems.lock_in.estimators.steadiness import bias_alignment_error_deg, bias_instability
from bench.systems.lock_in.records import Events, LaserRecord
from bench.systems.lock_in.wording import say

_ONE_SIDED = 1.645  # 95 % of a normal distribution lie below
_FEWEST_DOF = 4.0  # of a walk that quantisation hides
_PROBABILITY = 1e-4  # that a record without any other noise is called off
# The fit's shapes are of first order in the jumps. By exact integration without noise (backscatter phases of 0 to 165
# deg by 15, largest jumps of 0.07, 0.14 and 0.36 rad at 15 cm, 0.11 rad at 28 cm) its rate is off by these parts of the
# largest jump squared, constant, by cos 2 beta and by cos 4 beta, its phase by those of sin 2 beta and sin 4 beta, to
# what is left below.
_RATE_OFF, _PHASE_OFF_rad = (-0.0315, 0.0703, -0.0043), (-0.0422, 0.0035)
_LEFT, _LEFT_SHORT = 0.004, 1.5  # of the jump squared; the second over the swing of the dither, rad (5 cm)
_PARTS = 24  # of a turn of the phase, in which what is left is averaged
NATO_MIL_DEG = 360.0 / 6400.0
ARW_UNIT, ARCSEC = "deg/h^0.5", 3600.0


@dataclass(frozen=True)
class Measured:
    """A value and its standard uncertainty, with its degrees of freedom."""

    value: float
    std: float
    dof: float = math.inf

    @property
    def expanded(self) -> float:
        """Expanded uncertainty (95 %), as the estimates state it."""
        return coverage_factor(self.dof) * self.std


def squared(measured: Measured) -> Measured:
    """Square of a value and its standard uncertainty, by which a value of 0 is not known to be 0.

    Source: variance of the square of a normal variable; degrees of freedom as ``size_dof``.
    """
    value, std = measured.value**2, math.sqrt(4.0 * measured.value**2 * measured.std**2 + 2.0 * measured.std**4)
    return Measured(value, std, size_dof(value, std))


def size_dof(value: float, std: float) -> float:
    """Return degrees of freedom of a size, whose uncertainty goes with it: half its square over its variance.

    Of a variance with n degrees of freedom that is n / 4, of its root n: although both are skewed, symmetric intervals
    then hold a variance in 94.7 to 95.1 % for n of 16 to 1,000, its root in 93.3 % for 16 and 94.6 % for 60. Squared
    ratios of two such they hold in 96.5 % for n of 60. A value that quantisation hides has no fewer than 4.
    Source: JCGM 100:2008 equation (G.3); variance, and quantiles, of a chi-squared.
    """
    return math.inf if std == 0.0 else max(_FEWEST_DOF, 0.5 * (value / std) ** 2)


def misfit(walk: RandomWalk) -> float:
    """By how much the Allan deviation is off random walk and quantisation, in their uncertainties; 1 if it is not."""
    if chi2_tail(walk.chi2, walk.dof) > _PROBABILITY:
        return 1.0
    return max(1.0, math.sqrt(walk.chi2 / walk.dof))


def walk_std_deg_rth(walk: RandomWalk) -> float:
    """Return standard uncertainty of a random walk; of one that quantisation hides, from its upper limit.

    Where the two terms do not describe the deviation, as much wider as it is off them.
    """
    known = math.isfinite(walk.n_std_deg_rth)
    return misfit(walk) * (walk.n_std_deg_rth if known else walk.n_upper_deg_rth / _ONE_SIDED)


def walk_dof(walk: RandomWalk) -> float:
    """Return degrees of freedom of a random walk, as ``size_dof``.

    Source: as there.
    """
    return size_dof(walk.n_deg_rth, walk_std_deg_rth(walk))


def first_order_off(beta_rad: float, jump_squared: float) -> tuple[float, float]:
    """Return by what the global fit is off, as its shapes are of first order: its rate, relative, its phase, rad.

    Args: beta_rad: backscatter phase.   jump_squared: of the largest jump, rad^2.
    """
    twice_rad = 2.0 * beta_rad
    share = np.dot(_RATE_OFF, (1.0, math.cos(twice_rad), math.cos(2.0 * twice_rad)))
    turned_rad = np.dot(_PHASE_OFF_rad, (math.sin(twice_rad), math.sin(2.0 * twice_rad)))
    return jump_squared * float(share), jump_squared * float(turned_rad)


@dataclass(frozen=True)
class LaserResult:
    """Result of one record. ``walks``, ``biases``: by method and ``raw``; ``missing``: method to reason.

    ``shared``: squared correlation of an output with that before compensation, by method; 0 if it is not there.
    """

    record: LaserRecord
    clock_Hz: float
    events: Events
    found: Compensated
    walks: Mapping[str, RandomWalk]
    missing: Mapping[str, str]
    biases: Mapping[str, NoiseTerm] = field(default_factory=dict)
    shared: Mapping[str, float] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """As notes and figures call it."""
        record = self.record
        place = {"path": 100 * record.path_length_m, "clock": self.clock_Hz / 1e6}
        name = say("name", **place)
        if record.phase_setting_deg is not None:
            name = say("name.phase", **place, phase=record.phase_setting_deg)
        return say("name.record", name=name, number=record.number) if record.several else name

    @property
    def place(self) -> dict[str, Any]:
        """Conditions that tell its estimates from those of the others."""
        return self.record.place(self.clock_Hz)

    @property
    def gain(self) -> float:
        """Sagnac phase per angle, rad/rad."""
        return gyro_gain(self.record.path_length_m)

    @property
    def counted_dither_deg_s(self) -> float:
        """Mean amplitude of the dither rate, from the levels counted in a half cycle."""
        return math.degrees(self.found.swing_rad * self.found.omega_rad_s / (2.0 * self.gain))

    def ratio(self, method: str) -> Measured | None:
        """Random walk behind a compensator over that before it; what both scatter by together is in neither."""
        raw, walk = self.walks.get(RAW), self.walks.get(method)
        if raw is None or walk is None or not raw.n_deg_rth > 0.0:
            return None
        value = walk.n_deg_rth / raw.n_deg_rth
        own, before = walk_std_deg_rth(walk), value * walk_std_deg_rth(raw)
        std = math.sqrt(own**2 + before**2 - 2.0 * self.shared.get(method, 0.0) * own * before) / raw.n_deg_rth
        return Measured(value, std, size_dof(value, std))

    def is_worse(self, method: str) -> bool:
        """Return whether the compensator adds random walk, beyond the uncertainty of the ratio."""
        ratio = self.ratio(method)
        return ratio is not None and ratio.value - coverage_factor() * ratio.std > 1.0

    @property
    def lock_in_deg_s(self) -> Measured | None:
        """Lock-in rate by the global fit."""
        both = _weighted([(fit.kappa_rad_s, fit.kappa_std_rad_s) for fit in self.found.constants])
        if both is None:
            return None
        off = first_order_off(self.found.constants[0].beta_rad, self.jump_squared)[0]
        factor = math.degrees(1.0 / self.gain) / (1.0 + off)
        return Measured(factor * both.value, factor * math.hypot(both.std, self._left * both.value))

    @property
    def jump_squared(self) -> float:
        """Square of the largest jump of a turnaround, rad^2: twice the mean square."""
        return 2.0 * float(np.nanmean(np.square(self.found.constants[0].jumps.dpsi_rad)))

    @property
    def _left(self) -> float:
        """Standard uncertainty of what the corrections leave: of the rate, relative, and of the phase, rad."""
        left = _LEFT + _LEFT_SHORT / (self.found.swing_rad / 2.0)
        return left * self.jump_squared / math.sqrt(3.0)

    @property
    def backscatter_deg(self) -> Measured | None:
        """Backscatter phase by the global fit, in (-180, 180]."""
        fits = self.found.constants
        if not fits:
            return None
        about = fits[0].beta_rad
        turned = [(math.remainder(fit.beta_rad - about, math.tau), fit.beta_std_rad) for fit in fits]
        both = _weighted(turned)
        if both is None:
            return None
        phase_rad = about + both.value
        phase_rad -= first_order_off(phase_rad, self.jump_squared)[1]
        std_rad = math.hypot(both.std, self._left)
        return Measured(math.degrees(math.remainder(phase_rad, math.tau)), math.degrees(std_rad))

    @property
    def expected_deg_rth(self) -> float | None:
        """Random walk that the recovered lock-in rate gives by theory."""
        rate = self.lock_in_deg_s
        if rate is None:
            return None
        return float(expected_random_walk(rate.value, self.counted_dither_deg_s, self.record.path_length_m))

    @property
    def systematic_share(self) -> float | None:
        """Return what the crossings still show behind the global fit as a function of the phase, per RMS jump.

        Means over 24 parts of a turn of the phase, less what noise alone would give; 0 if the model holds.
        """
        shown = self.found.shown
        good = np.isfinite(shown.left_rad) & np.isfinite(shown.psi0_rad)
        jumps = shown.jumps.get(GLOBAL)
        if jumps is None or np.count_nonzero(good) < 10 * _PARTS:
            return None
        phase, left = np.mod(shown.psi0_rad[good], math.tau), shown.left_rad[good]
        part = np.minimum((phase / math.tau * _PARTS).astype(np.int64), _PARTS - 1)
        count = np.maximum(np.bincount(part, minlength=_PARTS), 1)
        mean = np.bincount(part, left, _PARTS) / count
        noise = np.bincount(part, (left - mean[part]) ** 2, _PARTS) / count**2
        return math.sqrt(max(0.0, float(np.mean(mean**2 - noise)))) / float(np.sqrt(np.nanmean(jumps**2)))


def laser_result(record: LaserRecord) -> LaserResult:
    """Decode, compensate and fit one record.

    Raises: FitError B-RLG-001, -002, -003, -007.
    """
    events = record.events()
    stretches, events = list(events.stretches), replace(events, stretches=())
    compensation = compensated(stretches, events, record.number)
    walks: dict[str, RandomWalk] = {}
    biases: dict[str, NoiseTerm] = {}
    missing = dict(compensation.refused)
    for method in (RAW, *COMPENSATORS):
        if method != RAW and not compensation.used.get(method):
            missing.setdefault(method, say("missing.no_turnaround"))
            continue
        try:
            of_output = compensation.increments[method], compensation.interval_s, record.path_length_m
            walks[method], biases[method] = random_walk(*of_output), bias_instability(output_deviation(*of_output))
        except FitError as error:
            missing[method] = say("error", why=error.message, code=error.code)
    outputs = compensation.increments
    shared = {method: shared_variance(outputs[RAW], outputs[method]) for method in walks if method != RAW}
    return LaserResult(record, events.clock_Hz, events, compensation, walks, missing, biases, shared)


def _weighted(values: list[tuple[float, float]]) -> Measured | None:
    """Return mean of values, each with its standard uncertainty."""
    if not values:
        return None
    weight = np.array([1.0 / std**2 for _, std in values])
    value = float(np.average([known for known, _ in values], weights=weight))
    return Measured(value, float(weight.sum() ** -0.5))


@dataclass(frozen=True)
class Requirement:
    """``error_deg``: largest azimuth error of the alignment.   ``time_s``: that it may take, None if nobody says.

    ``latitude_deg``: of the site, which the time depends on.
    """

    error_deg: float
    time_s: float | None
    latitude_deg: float


def requirement_of(campaign: Document) -> Requirement:
    """Read ``limits`` and ``site`` of the campaign; without a limit the error is one NATO mil (360 deg / 6400).

    Raises: FitError B-RLG-004 (a limit that no ring laser has, or in a wrong unit), B-RLG-005 (no latitude).
    """
    declared = DECLARATION.analysis("rlg_lock_in")
    stated = stated_limits(campaign, declared.limits, "B-RLG-004", "an alignment with a ring laser has no such limit")
    try:
        latitude_deg = float((campaign.get("site") or {})["latitude_deg"])
    except KeyError as error:
        raise FitError(
            "B-RLG-005",
            "the campaign does not state 'latitude_deg' of the site, which the alignment time depends on",
            where="manifest: campaign.site",
            next_step="give 'latitude' in the section 'site' of the sequence",
        ) from error
    return Requirement(stated.get("alignment_error", NATO_MIL_DEG), stated.get("alignment_time"), latitude_deg)


def record_estimates(laser: LaserResult, requirement: Requirement, judged: str) -> Estimates:
    """Of one record; the alignment time by the method ``judged`` carries the verdict, if the campaign limits it."""
    entries = constant_estimates(laser)
    for method in (RAW, *COMPENSATORS):
        walk = laser.walks.get(method)
        if walk is not None:
            limit_s = requirement.time_s if method == judged else None
            entries += _of_method(laser, method, walk, requirement, limit_s)
            entries += _bias(laser, method, requirement)
    return entries


def _bias(laser: LaserResult, method: str, requirement: Requirement) -> Estimates:
    """Return bias instability and the alignment error by it, where the record shows any."""
    bias = laser.biases.get(method)
    if bias is None or not bias.significant:
        return []
    place, n = laser.place | {"method": method}, laser.found.turnarounds
    error_deg, std_deg = (
        bias_alignment_error_deg(size, requirement.latitude_deg) for size in (bias.coefficient, bias.std_uncertainty)
    )
    return [
        estimate("bias_instability", "deg/h", bias.coefficient, bias.std_uncertainty, place, n=n),
        estimate("bias_alignment_error", "deg", error_deg, std_deg, place, n=n),
    ]


def _of_method(
    laser: LaserResult, method: str, walk: RandomWalk, requirement: Requirement, limit_s: float | None
) -> Estimates:
    place = laser.place | {"method": method}
    used = laser.found.turnarounds if method == RAW else laser.found.used[method]
    counted = {"n": used, "dropped": laser.found.turnarounds - used}
    time, dof = alignment_s(walk, requirement), walk_dof(walk)
    entries = [
        estimate("angle_random_walk", ARW_UNIT, walk.n_deg_rth, walk_std_deg_rth(walk), place, dof=dof, **counted),
        estimate("quantisation_noise", "arcsec", ARCSEC * walk.q_deg, ARCSEC * walk.q_std_deg, place, **counted),
        estimate("alignment_time", "s", time.value, time.std, place, limit=limit_s, dof=time.dof, **counted),
    ]
    ratio = None if method == RAW else laser.ratio(method)
    if ratio is not None:
        time_ratio = squared(ratio)
        for name, size in (("random_walk_ratio", ratio), ("alignment_time_ratio", time_ratio)):
            entries.append(estimate(name, "1", size.value, size.std, place, dof=size.dof, **counted))
    return [entry for entry in entries if math.isfinite(entry.value) and math.isfinite(entry.std_uncertainty)]


def alignment_s(walk: RandomWalk, requirement: Requirement) -> Measured:
    """Time until the random walk lets the azimuth be known to the required error: it goes with the walk's square."""
    square = squared(Measured(walk.n_deg_rth, walk_std_deg_rth(walk)))
    of_one_s = alignment_time_s(1.0, requirement.latitude_deg, requirement.error_deg)
    return Measured(of_one_s * square.value, of_one_s * square.std, square.dof)


def constant_estimates(laser: LaserResult) -> Estimates:
    """Lock-in rate and backscatter phase of one record; none where no two constants could be fitted."""
    place, of_all = laser.place, laser.found.turnarounds
    counted = {"n": of_all, "dropped": of_all - max(laser.found.used.values(), default=0)}
    rate, phase = laser.lock_in_deg_s, laser.backscatter_deg
    if rate is None or phase is None:
        return []
    return [
        estimate("lock_in_rate", "deg/s", rate.value, rate.std, place, **counted),
        estimate("backscatter_phase", "deg", phase.value, phase.std, place, **counted),
    ]


def exponent_estimates(results: Sequence[LaserResult], judged: str) -> Estimates:
    """How the random walk goes with the path length, by clock, before compensation (theory: -2.5) and behind it."""
    entries = []
    for clock_Hz in dict.fromkeys(laser.clock_Hz for laser in results):
        for method in (RAW, judged):
            seen = [laser for laser in results if laser.clock_Hz == clock_Hz and _is_seen(laser.walks.get(method))]
            if len({laser.record.path_length_m for laser in seen}) < 2:
                continue
            walks = [laser.walks[method] for laser in seen]
            try:
                exponent, std = path_exponent(
                    np.array([laser.record.path_length_m for laser in seen]),
                    np.array([walk.n_deg_rth for walk in walks]),
                    np.array([walk_std_deg_rth(walk) for walk in walks]),
                )
            except FitError:  # the walks of each path are there all the same
                continue
            place = {"clock_Hz": clock_Hz, "method": method}
            entries.append(estimate("path_length_exponent", "1", exponent, std, place, n=len(seen)))
    return entries


def _is_seen(walk: RandomWalk | None) -> bool:
    return walk is not None and walk.n_deg_rth > 0.0 and math.isfinite(walk.n_std_deg_rth)
