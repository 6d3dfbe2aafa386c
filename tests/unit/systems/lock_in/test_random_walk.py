"""Angle random walk, quantisation, alignment time and the theory beside them; what the global fit states."""

import math
from dataclasses import replace
from typing import Any

import allantools
import numpy as np
import pytest
from doubt_lock_in import simulated
from laser_physics import World, added, higher, integrals
from scipy.integrate import solve_ivp

from bench.model.errors import FitError
from bench.systems.lock_in.compensation import SINGLE
from bench.systems.lock_in.estimators import global_constants as expecting
from bench.systems.lock_in.estimators import random_walk as walking
from bench.systems.lock_in.estimators.random_walk import expected_random_walk, gyro_gain, walk_of_phase_deg_rth
from bench.systems.lock_in.estimators.steadiness import change, line, wander
from bench.systems.lock_in.estimators.turnarounds import Jumps, Turnarounds
from bench.systems.lock_in.records import laser_records
from bench.systems.lock_in.result import LaserResult, laser_result

PERIOD_s = 1.0 / 400.0
MIL_deg = 0.05625
RECORDS, PERIODS = 400, 800
TIME = np.arange(PERIODS)
TICKS = 49962.8048  # of a 20 MHz clock in a period of 2.498 ms


def walk_deg_rth(walk_rad: float) -> float:
    """What steps of a walk in half a period make of the angle."""
    return float(np.rad2deg(walk_rad * np.sqrt(2.0 / PERIOD_s) / walking.gyro_gain(0.28)) * 60.0)


def walks_of(walk_rad: float, quantum_rad: float, halves: int, records: int) -> list[walking.RandomWalk]:
    """Results of records of seeds from 0 on."""
    return [
        walking.random_walk(increments(walk_rad, quantum_rad, halves, seed), PERIOD_s, 0.28) for seed in range(records)
    ]


def increments(walk_rad: float, quantum_rad: float, halves: int, seed: int) -> np.ndarray:
    """Both senses' mean of steps of a walk in half a period and of a white error of each latched phase."""
    rng = np.random.default_rng(seed)
    psi = np.concatenate(([0.0], np.cumsum(walk_rad * rng.standard_normal(halves))))
    step = np.diff(psi + quantum_rad * rng.standard_normal(psi.size))
    start = np.arange(0, halves - 2, 2)
    return (step[start] + step[start + 2]) / 2.0 + step[start + 1]


@pytest.mark.parametrize(
    ("walk_rad", "quantum_rad", "bias", "scatter"),
    [(0.02, 0.0, 0.02, 0.03), (0.02, 0.02, 0.02, 0.04), (2e-3, 0.02, 0.04, 0.08)],
)
def test_walk_and_quantisation_are_told_apart(walk_rad: float, quantum_rad: float, bias: float, scatter: float) -> None:
    found = walks_of(walk_rad, quantum_rad, 8_000, 24)
    walks = np.array([each.n_deg_rth for each in found]) / walk_deg_rth(walk_rad)
    assert abs(walks.mean() - 1.0) < bias + 3.0 * scatter / np.sqrt(24)
    assert walks.std() < 1.8 * scatter
    stated = np.nanmean([each.n_std_deg_rth for each in found]) / walk_deg_rth(walk_rad)
    assert 0.5 * walks.std() < stated < 2.0 * walks.std()
    if quantum_rad > walk_rad:
        quanta = np.deg2rad([each.q_deg for each in found]) * walking.gyro_gain(0.28)
        assert quanta.mean() == pytest.approx(quantum_rad / np.sqrt(2.0), rel=0.03)  # a mean of two readings


def test_stated_uncertainties_and_limits_are_those_of_many_records() -> None:
    """60 records with a walk of half the quantisation: scores of one, 95 of 100 below the upper limit."""
    found, due = walks_of(0.01, 0.02, 2_000, 60), walk_deg_rth(0.01)
    quantum_deg = np.rad2deg(0.02 / np.sqrt(2.0) / walking.gyro_gain(0.28))
    walks = np.array([(each.n_deg_rth - due) / each.n_std_deg_rth for each in found])
    quanta = np.array([(each.q_deg - quantum_deg) / each.q_std_deg for each in found])
    assert 0.85 < walks.std() < 1.25
    assert 0.7 < np.nanstd(quanta) < 1.15
    assert abs(walks.mean()) < 0.35
    assert 0.9 <= np.mean([due < each.n_upper_deg_rth for each in found]) < 1.0


def test_a_walk_beside_hardly_any_quantisation_is_right_on_average() -> None:
    """Half of the records have a quantisation of 0; a walk fitted beside that 0 is low by 0.4 of its uncertainty."""
    found = walks_of(0.02, 0.002, 2_000, 150)
    scores = np.array([(each.n_deg_rth - walk_deg_rth(0.02)) / each.n_std_deg_rth for each in found])
    assert 50 < sum(each.q_deg == 0.0 for each in found) < 100
    assert abs(scores.mean()) < 0.25
    assert 0.88 < scores.std() < 1.12


def test_the_deviation_is_that_of_the_walk_and_not_of_its_smoothed_phases() -> None:
    """The mean of both senses would take 7.5 % off the variance at five periods."""
    found = walks_of(0.02, 0.0, 4_000, 24)
    assert found[0].tau_s[0] == pytest.approx(5.0 * PERIOD_s)
    variance = np.mean([each.deviation_deg_h[0] ** 2 for each in found])
    assert variance == pytest.approx((60.0 * walk_deg_rth(0.02)) ** 2 / (5.0 * PERIOD_s), rel=0.04)


def test_the_curve_is_that_of_another_package() -> None:
    steps = increments(1e-3, 0.02, 8_000, 3)
    found = walking.random_walk(steps, PERIOD_s, 0.28)
    angle_deg = np.rad2deg(np.concatenate(([0.0], np.cumsum(steps))) / walking.gyro_gain(0.28))
    _, deviation, _, _ = allantools.oadev(angle_deg, rate=1.0 / PERIOD_s, data_type="phase", taus=found.tau_s)
    np.testing.assert_allclose(found.deviation_deg_h, deviation * 3600.0, rtol=2e-3)  # less the smoothing of the walk


@pytest.mark.parametrize("part", [0.0, 0.6, 1.0])
def test_walks_of_two_outputs_scatter_together_by_what_is_shared(part: float) -> None:
    """60 pairs of records, with the quantisation of one pick-off in both: the correlation of their squared walks."""
    walks, shared = [], []
    for seed in range(60):
        first, other = increments(0.02, 0.0, 4_000, seed), increments(0.02, 0.0, 4_000, 1000 + seed)
        same = increments(0.0, 0.02, 4_000, 2000 + seed)
        first, behind = first + same, part * first + np.sqrt(1.0 - part**2) * other + same
        walks.append([walking.random_walk(each, PERIOD_s, 0.28).n_deg_rth ** 2 for each in (first, behind)])
        behind[7] = np.nan
        shared.append(walking.shared_variance(first, behind))
    assert np.mean(shared) == pytest.approx(part**2, abs=0.03)
    assert np.corrcoef(np.transpose(walks))[0, 1] == pytest.approx(part**2, abs=0.4)


def test_a_gap_shifts_nothing_and_too_short_a_record_is_refused() -> None:
    steps = increments(0.02, 0.0, 8_000, 5)
    torn = steps + 4e-3  # a rate besides
    torn[2_000] = np.nan
    whole, found = (walking.random_walk(each, PERIOD_s, 0.28) for each in (steps, torn))
    assert found.n_deg_rth == pytest.approx(whole.n_deg_rth, rel=0.03)
    with pytest.raises(FitError, match=r"B-FIT-099.*averaging times"):
        walking.random_walk(np.zeros(150), PERIOD_s, 0.28)


def test_published_figures() -> None:
    """Paper: 0.005 deg/rt-h, 1 mil, 10 min; half the path, 5.7 times the walk; 28 cm: 1.865 arcsec in a fringe."""
    error_deg = np.rad2deg(1.04e-3 * 0.982)  # 1.04 NATO mil at latitude 37 deg
    assert walking.alignment_time_s(0.005, 37.0, error_deg) == pytest.approx(600.0, rel=0.01)
    per_s = 0.003 / 60.0 / (7.2921151e-5 * np.cos(np.deg2rad(37.0)) * MIL_deg)  # earth rate in rad/s
    assert walking.alignment_time_s(0.003, 37.0, MIL_deg) == pytest.approx(per_s**2, rel=1e-6)
    short, long = walking.expected_random_walk(0.2, 100.0, 0.14), walking.expected_random_walk(0.05, 100.0, 0.28)
    assert short / long == pytest.approx(5.66, abs=0.01)
    assert long == pytest.approx(2.724e-3, rel=1e-3)
    assert np.rad2deg(2.0 * np.pi / walking.gyro_gain(0.28)) * 3600.0 == pytest.approx(1.865, abs=1e-3)


def test_path_exponent_is_that_of_a_weighted_line() -> None:
    """Against numpy; the middle path is off the power law and hardly counts."""
    path_m = np.array([0.15, 0.28, 0.34])
    for off, relative in (([1.0, 1.0, 1.0], [0.02] * 3), ([1.0, 1.3, 1.0], [0.01, 0.5, 0.02])):
        walk = 3e-4 * path_m**-2.5 * off
        std = np.array(relative) * walk
        line, covariance = np.polyfit(np.log(path_m), np.log(walk), 1, w=walk / std, cov="unscaled")
        exponent, uncertainty = walking.path_exponent(path_m, walk, std)
        assert exponent == pytest.approx(line[0], rel=1e-9)
        assert uncertainty == pytest.approx(np.sqrt(covariance[0, 0]), rel=1e-9)
    for path, stds in (([0.28, 0.28], [1e-5, 1e-5]), ([0.15, 0.28], [1e-5, np.nan])):  # one path, an unknown walk
        with pytest.raises(FitError, match=r"B-FIT-100.*path lengths"):
            walking.path_exponent(np.array(path), np.array([1e-3, 2e-3]), np.array(stds))


def outputs(seed: int, quantum: float = 0.5) -> Any:
    rng = np.random.default_rng(seed)
    found = rng.standard_normal(PERIODS) + np.diff(quantum * rng.standard_normal(PERIODS + 1))
    found[rng.choice(PERIODS, 5, replace=False)] = np.nan
    return found


def assert_fair(chances: Any) -> None:
    """No more small probabilities than chance brings, at three levels (99.9 % of a binomial count)."""
    for level, most in ((0.1, 62), (0.01, 13), (0.001, 5)):
        assert np.sum(np.asarray(chances) < level) <= most


def test_chances_are_fair_where_nothing_is_odd() -> None:
    records = [outputs(seed) for seed in range(RECORDS)]
    assert_fair([wander(record).probability for record in records])
    assert_fair([line(record).probability for record in records])
    assert_fair([change(record)[0] for record in records])


@pytest.mark.parametrize(
    ("added", "check"),
    [
        (3e-3 * (TIME - 400.0), wander),
        (0.8 * (TIME > 500), wander),
        (1.0 * np.sin(2.0 * np.pi * 0.0313 * TIME), line),
    ],
    ids=["ramp", "step", "line"],
)
def test_what_is_odd_is_found_and_taken_off(added: Any, check: Any) -> None:
    right = outputs(1)
    seen = check(right + added)
    assert seen.probability < 1e-9
    scatter = [np.nanstd(values[: PERIODS // 5 * 5].reshape(-1, 5).mean(axis=1)) for values in (right, right + added)]
    left = np.nanstd(seen.left[: PERIODS // 5 * 5].reshape(-1, 5).mean(axis=1))
    assert abs(left - scatter[0]) < 0.35 * abs(scatter[1] - scatter[0])


def test_a_turn_that_is_lost_is_odd_and_a_late_pick_off_is_not() -> None:
    rng = np.random.default_rng(6)
    psi = np.concatenate(([0.0], np.cumsum(0.05 * rng.standard_normal(400))))
    rising = np.arange(401) % 2 == 0
    late = psi + 3.0 * rising
    assert walking.odd_steps(late, rising, np.ones(400, bool)).tolist() == []
    late[201:] += 2.0 * np.pi
    assert walking.odd_steps(late, rising, np.ones(400, bool)).tolist() == [200]
    assert walking.odd_steps(late, rising, np.arange(400) != 200).tolist() == []


def with_rounded_stamps(seed: int, vibration: float = 0.0) -> Any:
    """White noise and stamps that are rounded to ticks, of a steady dither whose comparator jitters by 0.1 ticks."""
    draw, when = np.random.default_rng(seed), np.arange(8001)
    stamp = when * TICKS + 0.3 + 0.1 * draw.standard_normal(when.size)
    moved = 0.3 * draw.standard_normal(8000) + vibration * np.sin(0.7 * when[1:])
    return moved + np.diff(np.rint(stamp) - stamp)


@pytest.mark.parametrize("seed", range(5))
def test_the_beat_of_clock_and_dither_is_no_line_of_the_rate(seed: int) -> None:
    assert line(with_rounded_stamps(seed)).probability < 1e-9
    assert line(with_rounded_stamps(seed), TICKS).probability > 1e-3
    assert line(with_rounded_stamps(seed, 0.1), TICKS).probability < 1e-9  # a vibration beside it is seen


GAIN, HALF_s = gyro_gain(0.28), 1.25e-3
LASER = expecting.NominalLaser(
    kappa_rad_s=GAIN * np.radians(0.05), beta_rad=np.radians(40.0), omega_rad_s=2.0 * np.pi * 400.0,
    rate_rad_s=GAIN * np.radians(100.0), walk_rad_rt_s=GAIN * np.radians(1.15e-4 / 60.0), tick_s=1e-8,
)  # fmt: skip


def result_of(seed: int, world: World, *, quiet: bool) -> LaserResult:
    (record,) = laser_records(simulated(seed, world, quiet=quiet).material)
    return laser_result(record)


def world_of(path_m: float, clock_Hz: int, beta_deg: float) -> World:
    """Four seconds of the laser of 28 cm with another path."""
    wider = (0.28 / path_m) ** 2
    return World(path_m=path_m, clock_Hz=clock_Hz, beta_deg=beta_deg, seconds=4.0,
                 lock_in_deg_s=0.05 * wider, quantum_deg_rth=1.15e-4 * wider)  # fmt: skip


def nominal(world: World) -> expecting.NominalLaser:
    """The laser of a world, by its own words."""
    return expecting.NominalLaser(
        kappa_rad_s=world.gain * math.radians(world.lock_in_deg_s),
        beta_rad=math.radians(world.beta_deg),
        omega_rad_s=world.omega,
        rate_rad_s=world.gain * math.radians(100.0),
        walk_rad_rt_s=world.gain * math.radians(world.quantum_deg_rth / 60.0),
        tick_s=1.0 / world.clock_Hz,
    )


@pytest.mark.parametrize("sense", [-1.0, 1.0])
def test_the_phase_of_the_tests_is_that_of_the_equation(sense: float) -> None:
    """Equation (10) about a turnaround, integrated step by step."""
    swing, g, v = 258.0, 0.04, np.array([-7.1, -1.2, 0.7, 2.0, 7.1])
    c, s = integrals(v, np.full(v.size, swing))
    for phase in np.linspace(0.0, 6.0, 5):

        def slope(at: float, x: np.ndarray, phase: float = phase) -> np.ndarray:
            return -g * np.sin(phase - sense * at * at + x) / math.sqrt(1.0 - at * at / (2.0 * swing))

        due = [solve_ivp(slope, (0.0, end), [0.0], rtol=1e-10, atol=1e-11, method="DOP853").y[0, -1] for end in v]
        found = added(g, phase, sense, (c + 1j * s, *higher(v, swing)))
        assert found == pytest.approx(due, abs=5e-6)


@pytest.mark.parametrize("beta_deg", [0.0, 40.0, 90.0, 130.0])
def test_rate_and_phase_are_true_without_noise(beta_deg: float) -> None:
    """To less than a fifth of the uncertainty of 4 s at 100 MHz."""
    world = World(seconds=4.0, beta_deg=beta_deg)
    found = result_of(7, world, quiet=True)
    print(f"{found.lock_in_deg_s.value / world.lock_in_deg_s - 1.0:.2e}, {found.backscatter_deg.value - beta_deg:.2e}")
    assert found.lock_in_deg_s.value == pytest.approx(world.lock_in_deg_s, rel=2.5e-5)
    assert found.backscatter_deg.value == pytest.approx(beta_deg, abs=2e-3)


def errors_of(first_seed: int, world: World, records: int) -> tuple[np.ndarray, np.ndarray]:
    """Errors of rate and phase and their stated standard uncertainties, (n, 2) each."""
    errors, stated = [], []
    for seed in range(first_seed, first_seed + records):
        found = result_of(seed, world, quiet=False)
        rate, phase = found.lock_in_deg_s, found.backscatter_deg
        errors.append((rate.value - world.lock_in_deg_s, phase.value - world.beta_deg))
        stated.append((rate.std, phase.std))
    return np.array(errors), np.array(stated)


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("first_seed", "path_m", "clock_Hz", "beta_deg"),
    [(8000, 0.15, 100_000_000, 65.0), (9000, 0.15, 20_000_000, 20.0), (9500, 0.28, 100_000_000, 20.0)],
)
def test_intervals_hold_the_truth(first_seed: int, path_m: float, clock_Hz: int, beta_deg: float) -> None:
    """Bands of 99.9 %: 200 records, of whose intervals of +-2 standard uncertainties 0.954 should hold the truth."""
    errors, stated = errors_of(first_seed, world_of(path_m, clock_Hz, beta_deg), 200)
    held = np.mean(np.abs(errors) < 2.0 * stated, axis=0)
    off = np.mean(errors, axis=0) / np.mean(stated, axis=0)
    print(f"seeds from {first_seed}: held {held}, mean off by {off} of u, spread {np.std(errors, axis=0)}")
    assert np.all(held > 0.90)
    assert np.all(np.abs(off) < 3.3 / np.sqrt(200.0))


def test_a_weak_dither_and_a_short_record_are_refused() -> None:
    laser = nominal(World())
    with pytest.raises(FitError, match="B-FIT-097"):
        expecting.expected_constants(replace(laser, rate_rad_s=laser.rate_rad_s / 6.0), 1000)
    with pytest.raises(FitError, match="B-FIT-098"):
        expecting.expected_constants(laser, 49)


def taking_off(share: float, laser: expecting.NominalLaser) -> Any:
    """A compensator that knows equation (5) and takes off a share of each jump."""

    def compensator(turns: Turnarounds) -> Jumps:
        motion = expecting.expected_turnarounds(laser)[1]
        curvature = laser.rate_rad_s * laser.omega_rad_s
        turned = motion.psi0_rad + laser.beta_rad + motion.sign * np.pi / 4.0
        jump = -laser.kappa_rad_s * np.sqrt(2.0 * np.pi / curvature) * np.sin(turned)
        return Jumps(share * jump, turned, turned)

    return compensator


@pytest.mark.parametrize(("share", "shared"), [(0.0, 1.0), (0.5, 1.0), (1.0, 0.0)])
def test_what_is_not_taken_off_is_left(share: float, shared: float) -> None:
    """Equation (6) for what is left of the lock-in, beside the quantum noise."""
    found = expecting.expected_output(LASER, taking_off(share, LASER))
    lock_in = (1.0 - share) * expected_random_walk(0.05, 100.0, 0.28)
    assert walk_of_phase_deg_rth(found.walk_rad_rt_s, 0.28) == pytest.approx(np.hypot(lock_in, 1.15e-4), rel=0.01)
    assert found.shared == pytest.approx(shared, abs=0.01)


@pytest.mark.parametrize("method", SINGLE)
def test_steps_of_the_clock_and_walk_are_those_of_draws(method: str) -> None:
    """Without lock-in: 400 draws of crossings that a walk moves and a clock of 20 MHz cuts off; the step from pick-off
    to pick-off less what the compensator takes for a jump. The walk is in steps from crossing to crossing.
    """
    laser = replace(LASER, kappa_rad_s=1e-9, tick_s=5e-8, walk_rad_rt_s=20.0 * LASER.walk_rad_rt_s)
    rng = np.random.default_rng(77)
    time_s, motion = expecting.expected_turnarounds(laser)
    phase, rate = motion.phase(time_s), laser.rate_rad_s * np.sin(laser.omega_rad_s * time_s)
    edges = np.column_stack((np.full(len(time_s), -HALF_s / 2.0), time_s, np.full(len(time_s), HALF_s / 2.0)))
    steps = laser.walk_rad_rt_s * np.sqrt(np.diff(edges, axis=1))
    left = []
    for _ in range(400):
        walk = np.cumsum(steps * rng.standard_normal(steps.shape), axis=1)
        ticks = motion.sign[:, None] * rate * laser.tick_s * (rng.random(time_s.shape) - 0.5)
        jumps = SINGLE[method](turning(laser, time_s, phase + walk[:, :-1] + ticks)).dpsi_rad
        left.append(walk[:, -1] - jumps)
    drawn = float(np.sqrt(np.mean(np.var(left, axis=0)) / HALF_s))
    assert expecting.expected_output(laser, SINGLE[method]).walk_rad_rt_s == pytest.approx(drawn, rel=0.03)


def turning(laser: expecting.NominalLaser, time_s: Any, phase_rad: Any) -> Turnarounds:
    every, none = np.ones(len(time_s), bool), np.zeros(len(time_s), np.int64)
    sign = expecting.expected_turnarounds(laser)[1].sign
    return Turnarounds(
        1.0 / laser.tick_s, laser.omega_rad_s, 0.0, sign, every, every, ~every, none, time_s, phase_rad, {}
    )
