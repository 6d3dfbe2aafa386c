"""From blocks of a time tagger to turnarounds: bytes by hand, levels counted, a dither known in closed form."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rlg_rig import as_row, block_bytes

from bench.model.errors import FitError
from bench.systems.lock_in.estimators.global_constants import global_constants
from bench.systems.lock_in.estimators.random_walk import cycle_increments, net_angle
from bench.systems.lock_in.estimators.single_turnarounds import dither_shape, fresnel, parabolas, stepped_motion
from bench.systems.lock_in.estimators.turnarounds import EdgeLevels, Turnarounds, edge_levels, turnarounds
from bench.systems.lock_in.records import record_events

CLOCK_HZ, PER_BLOCK = 100_000_000, 1_000_000
FINE_Hz = 1e12  # so that the ticks say nothing
OMEGA = 2.0 * np.pi * 400.0
HALVES, AMPLITUDE_rad = 200, 150.0
Int64, Bool = NDArray[np.int64], NDArray[np.bool_]


def row(blocks: int = 4, *, dropped: Any = None, counter: Any = None, clock: Any = None, **change: Any) -> Any:
    """Blocks of four events each: beat up, pick-off up, beat down, beat up; ticks 10, 20, 30, 40 of the block."""
    events = np.empty(blocks, object)
    for k in range(blocks):
        events[k] = block_bytes([10, 20, 30, 40], [1, 1, 0, 1], [1, 0, 0, 1], [0, 1, 0, 0])
    columns: dict[str, Any] = {
        "tick": np.arange(5, 5 + blocks, dtype=np.uint64) * np.uint64(PER_BLOCK),
        "clock": np.full(blocks, CLOCK_HZ, np.uint32) if clock is None else np.array(clock, np.uint32),
        "dropped": np.zeros(blocks, np.uint32) if dropped is None else np.array(dropped, np.uint32),
        "edges": np.full(blocks, 4, np.uint16),
        "events": events,
    }
    numbers = np.arange(7, 7 + blocks) if counter is None else np.array(counter)
    return as_row(columns | change, numbers, 3, {"path_length_m": 0.28, "clock_Hz": CLOCK_HZ})


def test_events_by_hand() -> None:
    """The golden block of the frame: 0x2693 = 9875: level 1, cosine 1, channel 0, 1234 ticks; 0xb170; 0x7a11fd."""
    golden = bytes.fromhex("93260000 70b10000 fd117a00")
    one = np.empty(1, object)
    one[0] = golden
    found = record_events(row(1, edges=np.array([3], np.uint16), events=one))
    (stretch,) = found.stretches
    assert stretch.begin_tick == 5 * PER_BLOCK
    assert stretch.ticks.tolist() == [1234, 5678]
    assert stretch.rising.tolist() == [True, False]
    assert stretch.cosine.tolist() == [True, False]
    assert stretch.pickoff_ticks.tolist() == [999999]
    assert stretch.pickoff_rising.tolist() == [True]
    assert found.clock_Hz == CLOCK_HZ


def dark(blocks: int, *at: int) -> dict[str, Any]:
    """Blocks of which some came without an edge."""
    events = row(blocks).samples.columns["events"].copy()
    for k in at:
        events[k] = b""
    return {"events": events, "edges": np.array([0 if k in at else 4 for k in range(blocks)], np.uint16)}


def at_blocks(*numbers: int) -> Any:
    return np.array(numbers, np.uint64) * np.uint64(PER_BLOCK)


@pytest.mark.parametrize(
    ("blocks", "change", "begins", "sizes", "lost"),
    [
        (4, {"counter": [7, 8, 11, 12], "tick": at_blocks(5, 6, 9, 10)}, [5, 9], [6, 6], {"lost_blocks": 2}),
        (5, {"dropped": [0, 0, 40, 40, 40]}, [5, 8], [6, 6], {"lost_edges": 40, "torn": 1}),
        (3, {"dropped": [40, 40, 40]}, [6], [6], {"lost_edges": 0}),  # the first one behind losses is not trusted
        (6, dark(6, 0, 2, 3), [6, 9], [3, 6], {"dark": 3, "torn": 0, "lost_blocks": 0}),  # numbered all the same
        (2, dark(2, 0, 1), [], [], {"dark": 2}),
        (4, {"tick": at_blocks(5, 6, 0, 1)}, [5, 0], [6, 6], {}),  # a tagger that was started again
        (5, {"dropped": [0, 40, 0, 0, 3]}, [5, 8], [3, 3], {"lost_edges": 43}),  # its own count begins at 0 again
        (3, {"edges": np.array([4, 5, 4], np.uint16)}, [5, 7], [3, 3], {"torn": 1}),  # too few bytes
    ],
)
def test_what_is_not_whole_is_left_out_and_never_bridged(
    blocks: int, change: dict[str, Any], begins: list[int], sizes: list[int], lost: dict[str, int]
) -> None:
    found = record_events(row(blocks, **change))
    assert [one.begin_tick // PER_BLOCK for one in found.stretches] == begins
    assert [one.ticks.size for one in found.stretches] == sizes
    assert {name: getattr(found, name) for name in lost} == lost


@pytest.mark.parametrize(
    ("wrong", "code"),
    [
        (lambda: replace(row(), samples=None), "B-RLG-001"),
        (lambda: row(0), "B-RLG-001"),
        (lambda: as_row({"gyro": np.zeros(4, np.int16)}, np.arange(4), 3, {}), "B-RLG-002"),
        (lambda: row(clock=[CLOCK_HZ, CLOCK_HZ, 20_000_000, 20_000_000]), "B-RLG-003"),
    ],
)
def test_what_is_no_record_of_edges_is_refused(wrong: Any, code: str) -> None:
    with pytest.raises(FitError, match=f"{code}.*record 3"):
        record_events(wrong())


def edges_of(cells: Int64) -> tuple[Int64, Bool, Bool]:
    """True levels, rising and cosine of the edges on a way through cells floor(psi / pi), one step at a time."""
    up = np.diff(cells) > 0
    level = np.maximum(cells[1:], cells[:-1])
    even = level % 2 == 0
    return level, up == even, even


def counted(rising: Bool, cosine: Bool) -> EdgeLevels:
    return edge_levels(np.arange(rising.size), rising, cosine)


@pytest.mark.parametrize("seed", range(20))
def test_any_way_is_counted(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cells = np.cumsum(np.concatenate(([rng.integers(-9, 9)], rng.choice([-1, 1], 300))))
    level, rising, cosine = edges_of(cells)
    found = counted(rising, cosine)
    assert np.unique(found.level - level).size == 1
    assert (found.level - level)[0] % 2 == 0  # an even number of levels: a sine and a cosine tell no more
    assert np.array_equal(found.direction, np.diff(cells))
    assert not found.suspect.any()
    assert found.breaks.size == 0
    assert found.repaired == 0


def test_an_edge_lost_in_a_run_is_bridged_and_one_at_a_turnaround_breaks_the_count() -> None:
    once = np.concatenate((np.arange(12), np.arange(12, 0, -1)))  # cells of a phase that goes up and down again
    level, rising, cosine = edges_of(np.concatenate((np.tile(once, 6), [0])))
    kept = np.delete(np.arange(level.size), [5, 17, 30])
    found = counted(rising[kept], cosine[kept])
    assert found.repaired == 3
    assert np.array_equal(found.level, level[kept])
    kept = np.delete(np.arange(level.size), 12)  # the first one down from the top
    found = counted(rising[kept], cosine[kept])
    assert found.breaks.tolist() == [12]
    assert np.array_equal(found.level[:12], level[:12])
    off = found.level[12:] - level[kept][12:]
    assert np.unique(off).size == 1
    assert abs(int(off[0])) in (0, 2)  # its parity is right, whichever of the two it was
    assert np.array_equal(found.level % 2 == 0, cosine[kept])


@pytest.mark.parametrize("tick", [[3], [5, 4, 6]])
def test_no_stretch(tick: list[int]) -> None:
    ones = np.ones(len(tick), bool)
    with pytest.raises(FitError, match=r"B-FIT-095.*no stretch"):
        edge_levels(np.array(tick), ones, ones)


def ideal(step_rad: float = 0.0, offset_rad: float = 0.3, beside_rad: float = 0.0) -> tuple[EdgeLevels, Int64, Bool]:
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
    zero = np.rint((np.arange(HALVES) + 1) * np.pi / OMEGA * FINE_Hz).astype(np.int64)
    edges = edge_levels(np.rint(time * FINE_Hz).astype(np.int64), up == even, even)
    return edges, zero, np.arange(HALVES) % 2 == 0


def turning(edges: EdgeLevels, zero: Int64, rising: Bool) -> Turnarounds:
    return turnarounds(edges, zero, rising, FINE_Hz)


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
    at = turns.reference_tick / FINE_Hz + stepped_motion(turns, 16)[1].zero_rate_s
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
        assert np.nanmax(np.abs(cycle_increments(psi, rising, turns, jumps))) < 1e-5


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
    turns = turning(*ideal(offset_rad=48 * np.pi - AMPLITUDE_rad + 0.02))  # passed clearly
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
    gaps = np.isnan(cycle_increments(psi, np.delete(rising, 50), turns, jumps))
    assert 1 <= gaps.sum() <= 3
    raw = cycle_increments(psi, np.delete(rising, 50), turns)
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
    steps = cycle_increments(psi, rising, turns)
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
    assert np.array_equal(swapped.level - swapped.level[0], edges.level[order] - edges.level[0])
    assert swapped.breaks.size == 0
    turns = turning(swapped, zero, rising)
    assert turns.usable.all()
    assert turns.grazing.sum() == 1
    assert np.abs(dither_shape(turns).dpsi_rad).max() < 1e-6


def test_too_few_crossings_pick_offs_or_turnarounds_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    edges, zero, rising = ideal()
    with monkeypatch.context() as patch:
        patch.setattr("bench.systems.lock_in.estimators.turnarounds.CROSSINGS", 60)
        with pytest.raises(FitError, match=r"B-FIT-097.*few_crossings 199"):
            turning(edges, zero, rising)
    with pytest.raises(FitError, match=r"B-FIT-096.*period"):
        turning(edges, zero[:2], rising[:2])
    with pytest.raises(FitError, match=r"B-FIT-098.*lock-in constants"):
        global_constants(turning(edges, zero[:40], rising[:40]))
