"""Crossings round the turnarounds of a dither that is known in closed form, and what gates them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from bench.model.errors import FitError
from bench.systems.lock_in.estimators.edges import EdgeLevels, edge_levels
from bench.systems.lock_in.estimators.global_constants import global_constants
from bench.systems.lock_in.estimators.random_walk import cycle_increments, net_angle
from bench.systems.lock_in.estimators.single_turnarounds import dither_shape, fresnel, parabolas
from bench.systems.lock_in.estimators.turnarounds import Turnarounds, turnarounds

CLOCK_Hz = 1e12  # so that the ticks say nothing
OMEGA = 2.0 * np.pi * 400.0
HALVES, AMPLITUDE_rad = 200, 150.0
Int64 = NDArray[np.int64]


def ideal(
    step_rad: float = 0.0, offset_rad: float = 0.3, beside_rad: float = 0.0
) -> tuple[EdgeLevels, Int64, NDArray[np.bool_]]:
    """Edges of psi = offset + A sin(w t) with a step at each turnaround, up at the maxima and down at the minima; the
    comparator switches ``beside_rad`` behind even levels and before odd ones.
    """
    times, levels, upward = [], [], []
    for quarter in range(1, 2 * HALVES, 2):  # from turnaround to turnaround, about the zero at ``half``
        half = quarter // 2
        sense = 1 - 2 * (half % 2)
        centre = offset_rad + (step_rad if half % 2 else 0.0)
        level = np.arange(-60, 61)[::sense]
        switched = level * np.pi + beside_rad * (1 - 2 * (level % 2)) - centre
        level, switched = level[np.abs(switched) < AMPLITUDE_rad], switched[np.abs(switched) < AMPLITUDE_rad]
        times.append((half * np.pi + sense * np.arcsin(switched / AMPLITUDE_rad)) / OMEGA)
        levels.append(level)
        upward.append(np.full(level.size, sense > 0))
    time, level, up = np.concatenate(times), np.concatenate(levels), np.concatenate(upward)
    time += np.pi / OMEGA  # the first zero is a falling one now, and no tick is negative
    even = level % 2 == 0
    zero = np.rint((np.arange(HALVES) + 1) * np.pi / OMEGA * CLOCK_Hz).astype(np.int64)
    edges = edge_levels(np.rint(time * CLOCK_Hz).astype(np.int64), up == even, even)
    return edges, zero, np.arange(HALVES) % 2 == 0


def turning(edges: EdgeLevels, zero: Int64, rising: NDArray[np.bool_], crossings: int = 16) -> Turnarounds:
    return turnarounds(edges, zero, rising, CLOCK_Hz, crossings)


def test_a_pure_dither_has_no_jump() -> None:
    turns = turning(*ideal())
    assert turns.usable.all()
    assert turns.omega_rad_s == pytest.approx(OMEGA, rel=1e-9)
    assert abs(turns.rate_rad_s) < 1e-9
    for jumps in (dither_shape(turns, 4), dither_shape(turns, 16), fresnel(turns), global_constants(turns).jumps):
        assert np.abs(jumps.dpsi_rad).max() < 1e-6
        np.testing.assert_allclose(jumps.curvature_rad_s2, AMPLITUDE_rad * OMEGA**2, rtol=1e-6)
        truth = 0.3 - turns.sign * AMPLITUDE_rad
        np.testing.assert_allclose(np.cos(jumps.psi0_rad - truth), 1.0, atol=1e-9)
        at = turns.reference_tick / CLOCK_Hz + jumps.zero_rate_s
        np.testing.assert_allclose(at, (np.arange(HALVES - 1) + 1.5) * np.pi / OMEGA, atol=1e-10)
    assert np.abs(parabolas(turns, 4).dpsi_rad).max() < 0.02  # the dither is no parabola


@pytest.mark.parametrize("step_rad", [-0.05, 0.02])
def test_a_step_at_the_turnaround_is_found(step_rad: float) -> None:
    turns = turning(*ideal(step_rad))
    truth = np.where(turns.sign < 0, step_rad, -step_rad)
    for crossings in (4, 16):
        np.testing.assert_allclose(dither_shape(turns, crossings).dpsi_rad, truth, atol=1e-6)
    for crossings in (3, 4):
        np.testing.assert_allclose(parabolas(turns, crossings).dpsi_rad, truth, atol=0.02)


def test_net_angle_and_increments() -> None:
    edges, zero, rising = ideal(0.02)
    psi = net_angle(edges, zero)
    inside = np.isfinite(psi)
    assert inside.sum() >= HALVES - 1
    truth = 0.3 + np.where(np.arange(HALVES) % 2, 0.02, 0.0)
    off = (psi - truth)[inside]
    np.testing.assert_allclose(off - off[0], 0.0, atol=1e-6)
    turns = turning(edges, zero, rising)
    for jumps in (None, dither_shape(turns)):
        found = cycle_increments(psi, rising, turns, jumps)
        assert found.interval_s == pytest.approx(2.5e-3, rel=1e-9)
        assert np.nanmax(np.abs(found.increment_rad)) < 1e-5
        assert rising[found.start].all()


@pytest.mark.parametrize("beside_rad", [-0.5, 0.1])
def test_a_comparator_beside_zero_leaves_the_net_angle(beside_rad: float) -> None:
    """Of all phases at the pick-off: a straight line through its edges would be off by up to a tenth of the offset."""
    off = []
    for offset_rad in np.linspace(0.1, 6.2, 12):
        edges, zero, _ = ideal(offset_rad=offset_rad, beside_rad=beside_rad)
        off.append(np.nanmean(net_angle(edges, zero)) - offset_rad)
    turns = np.round(np.array(off) / np.pi)  # the first level is any
    np.testing.assert_allclose(off - np.pi * turns, 0.0, atol=2e-5)


def test_a_grazing_pair_is_left_out() -> None:
    offset = 48 * np.pi - AMPLITUDE_rad + 0.004  # the maxima pass level 48 by 0.004 rad
    turns = turning(*ideal(offset_rad=offset))
    assert np.array_equal(turns.grazing, turns.sign < 0)
    assert turns.usable.all()
    inner = turns.phase_rad[turns.grazing][:, 15:17]
    assert np.array_equal(inner[:, 0], inner[:, 1])
    assert np.abs(dither_shape(turns).dpsi_rad).max() < 1e-6


def test_a_pair_that_is_passed_clearly_stays() -> None:
    turns = turning(*ideal(offset_rad=48 * np.pi - AMPLITUDE_rad + 0.02))
    assert not turns.grazing.any()
    assert turns.usable.all()


def test_a_lost_pick_off_spoils_its_interval_only() -> None:
    edges, zero, rising = ideal()
    turns = turning(edges, np.delete(zero, 50), np.delete(rising, 50))
    assert turns.counts == {"pickoff": 1, "few_crossings": 0, "break": 0, "suspect": 0}
    assert turns.omega_rad_s == pytest.approx(OMEGA, rel=1e-9)
    assert np.flatnonzero(~turns.usable).tolist() == [49]
    jumps = dither_shape(turns)
    assert np.flatnonzero(np.isnan(jumps.dpsi_rad)).tolist() == [49]
    psi = net_angle(edges, np.delete(zero, 50))
    gaps = np.isnan(cycle_increments(psi, np.delete(rising, 50), turns, jumps).increment_rad)
    assert 1 <= gaps.sum() <= 3
    raw = cycle_increments(psi, np.delete(rising, 50), turns).increment_rad
    np.testing.assert_array_equal(np.isnan(raw), gaps)  # a period and a half is no period, compensated or not


def test_a_lost_edge_at_a_turnaround_is_a_gap() -> None:
    edges, zero, rising = ideal()
    turn = np.flatnonzero(np.diff(edges.direction))[20] + 1
    kept = np.delete(np.arange(edges.tick.size), turn)
    even = edges.level[kept] % 2 == 0
    torn = edge_levels(edges.tick[kept], (edges.direction[kept] > 0) == even, even)
    assert torn.breaks.tolist() == [turn]
    turns = turning(torn, zero, rising)
    assert turns.counts["break"] == 1
    psi = net_angle(torn, zero)
    assert np.isnan(psi[1:-1]).sum() == 1
    steps = cycle_increments(psi, rising, turns).increment_rad
    assert np.nanmax(np.abs(steps)) < 1e-5  # the turn of 2 pi that may be missing is in no increment


def test_an_edge_pair_that_changed_places_is_not_used() -> None:
    edges, zero, rising = ideal()
    turn = np.flatnonzero(np.diff(edges.direction))[20]  # the innermost pair before and behind
    even = edges.level % 2 == 0
    up = (edges.direction > 0) == even
    order = np.arange(edges.tick.size)
    order[[turn, turn + 1]] = turn + 1, turn
    swapped = edge_levels(edges.tick, up[order], even[order])
    assert np.flatnonzero(swapped.suspect).tolist() == [turn, turn + 1]
    turns = turning(swapped, zero, rising)
    assert turns.usable.all()
    assert turns.grazing.sum() == 1
    assert np.abs(dither_shape(turns).dpsi_rad).max() < 1e-6


def test_too_few_crossings() -> None:
    with pytest.raises(FitError, match="few_crossings 199") as caught:
        turning(*ideal(), crossings=60)
    assert caught.value.code == "B-FIT-097"


def test_no_pick_off() -> None:
    edges, zero, rising = ideal()
    with pytest.raises(FitError, match="period") as caught:
        turning(edges, zero[:2], rising[:2])
    assert caught.value.code == "B-FIT-096"


def test_too_few_turnarounds_for_constants() -> None:
    edges, zero, rising = ideal()
    with pytest.raises(FitError, match="lock-in constants") as caught:
        global_constants(turning(edges, zero[:40], rising[:40]))
    assert caught.value.code == "B-FIT-098"
