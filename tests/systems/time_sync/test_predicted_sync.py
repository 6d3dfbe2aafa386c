"""Holds what ``bench check`` predicts of a time offset against the spread of many flights of the planned motion, one a
lane: an offset of its own each, errors of both units as declared. Recordings of wrong worlds: no offset that looks
sound, and none lost in a right one.

The path and the increments are the simulator's; the errors of the EGI wander by a recursion of their own. Those of
wrong worlds are made from the physics alone (``doubt_time_sync``).
"""

from dataclasses import replace
from functools import cache
from typing import Any

import doubt_time_sync as worlds
import numpy as np
import pytest
from doubt_classes import DOUBTED, REFUSED, WRONG, codes_of, right_world, sorted_classes
from numpy.typing import NDArray
from one_estimate import one as estimate_of
from scipy import stats
from spread_study import outside
from sync_rig import wandering_egi

from bench.analysis import Planned, Prediction
from bench.model.systems import Assumption, assumptions_of
from bench.plan import Plan, compile_sequence
from bench.session.predicted import planned_of, predicted
from bench.systems.time_sync.estimators.kalman.filter import run_filter
from bench.systems.time_sync.estimators.kalman.setup import LOOSE, TIGHT, EgiSpread, FilterSetup, ImuSamples
from bench.systems.time_sync.limits import latency_of
from bench.systems.time_sync.predicted import planned_samples
from bench.systems.time_sync.predicted import predicted as predict
from bench.systems.time_sync.records import Recording, Stream, clocks_of
from sim_instruments.worlds.time_sync.flight.imu import exact_increments, imu_runs
from sim_instruments.worlds.time_sync.flight.path import FlightPath

Array = NDArray[np.float64]
STATED = "stated uncertainty of receive_jitter"
GROUPS = {"augmented_loose": 0, "augmented_tight": 1}
OFFSET_STD_s = 0.03
NEAR_s, COARSE_s, TAG_NOISE_s = 0.05, 0.01, 1e-5
_MICRO_G, _DEG_H = 9.80665e-6, np.radians(1.0) / 3600.0


def brought_near(offsets_s: Array) -> Array:
    """Return what a filter has to find: of more than 50 ms whole steps of 10 ms are taken out beforehand (docs)."""
    return np.where(np.abs(offsets_s) > NEAR_s, offsets_s - COARSE_s * np.round(offsets_s / COARSE_s), offsets_s)


def errors_of_flights(planned: Planned, path: FlightPath, end_s: float, runs: int, seed: int) -> dict[Any, Array]:
    """Return estimate minus truth, (R,), in the units of the estimates, by quantity, method and axis."""
    rng = np.random.default_rng(seed)
    egi = planned.campaign["egi"]
    spread = EgiSpread(**egi)
    offsets_s = brought_near(rng.normal(0.0, OFFSET_STD_s, runs))
    unit = imu_runs(path, end_s, runs, seed)
    samples = ImuSamples(unit.t_s, unit.dv, unit.dtheta, np.zeros(unit.t_s.size, bool))
    setup = FilterSetup((True, True), (LOOSE, TIGHT), offset_sigma_s=OFFSET_STD_s, keep_every=50)
    run = run_filter(samples, wandering_egi(path, end_s, spread, offsets_s, rng), setup)
    found: dict[Any, Array] = {
        ("time_offset", method, None): run.offset_s[-1, group] - offsets_s for method, group in GROUPS.items()
    }
    for axis, letter in enumerate("xyz"):
        accel = run.accel_bias[-1, 0, :, axis] - unit.accel_bias[:, axis]
        gyro = run.gyro_bias[-1, 0, :, axis] - unit.gyro_bias[:, axis]
        found["accel_bias", "augmented_loose", letter] = accel / _MICRO_G
        found["gyro_bias", "augmented_loose", letter] = gyro / _DEG_H
    return found


def errors_of_stamps(planned: Planned, span_s: float, runs: int, seed: int) -> dict[Any, Array]:
    """Return estimate minus truth, (R,), of clocks by receive stamps of many pairs of units, by quantity and link.

    Stamps are drawn as the sequence declares them; what the makers state of a latency is off by its uncertainty. Beside
    them what is stated of each jitter.
    """
    stamps, latency = planned.campaign["stamps"], latency_of(planned.campaign)
    assert latency is not None
    rng, found = np.random.default_rng(seed), dict[Any, list[float]]()
    for _ in range(runs):
        rates = dict(zip(("imu", "egi"), stamps["clock"] * rng.uniform(-1.0, 1.0, 2), strict=True))
        offset_s, begin_s = float(rng.uniform(-OFFSET_STD_s, OFFSET_STD_s)), 100.0 + rng.uniform()
        streams = {}
        for link, least_s in (("imu", latency.imu_s), ("egi", latency.egi_s)):
            late_s = least_s + latency.std_s * rng.standard_normal()
            streams[link] = _stream(planned, link, span_s, begin_s + late_s, rates[link], rng)
        tags_s = streams["egi"].tick_s + offset_s
        pair = Recording(streams["imu"], replace(streams["egi"], tick_s=tags_s), None, "")
        clocks = clocks_of(pair, 0.5 * span_s, latency, {})
        apart_s = offset_s + 0.5 * span_s * (rates["egi"] - rates["imu"])  # both count from the begin
        errors = {
            ("time_offset_drift", None): 1e6 * (clocks.difference.drift - (rates["egi"] - rates["imu"])),
            ("time_offset_from_stamps", None): (clocks.offset_s or 0.0) - apart_s,
        }
        for link, port in (("imu", clocks.imu), ("egi", clocks.egi)):
            errors["clock_rate", link] = -1e6 * port.rate - 1e6 * rates[link]
            errors["receive_jitter", link] = port.jitter_s - stamps["jitter_s"]
            errors[STATED, link] = port.jitter_std_s
        for own, error in errors.items():
            found.setdefault(own, []).append(error)
    return {own: np.array(values) for own, values in found.items()}


def _stream(planned: Planned, link: str, span_s: float, first_s: float, rate: float, rng: Any) -> Stream:
    """Tags of a clock that is fast by ``rate`` and stamps of its frames, of which the first may come at ``first_s``."""
    stamps, step_s = planned.campaign["stamps"], planned.steps_s[link]
    own_s = np.arange(0.0, span_s, 1.0 / planned.rates_Hz[link])
    arrived_s = first_s + own_s / (1.0 + rate) + rng.exponential(stamps["jitter_s"], own_s.size)
    received_ns = np.rint(1e9 * np.ceil(arrived_s / step_s) * step_s).astype(np.int64)
    tags_s = own_s + TAG_NOISE_s * rng.standard_normal(own_s.size)
    return Stream(tags_s, np.arange(own_s.size), received_ns, {})


SPEED_m_s, SEED = 100.0, 3
SHORT = {
    "turn": {"straight": "5 s", "manoeuvre": "10 s", "rate": "9 deg/s"},
    "acceleration": {"straight": "5 s", "manoeuvre": "10 s"},
    "linear": {"time": "15 s"},
    "stationary": {"time": "15 s"},
}
WHOLE_s = 20.0  # before the manoeuvre of the shipped sequences, in it, and after it


def plan_of(name: str, straight_s: float = 5.0) -> Plan:
    """A shipped sequence as it is, or its short form."""
    return compile_sequence(f"time_sync_{name}", None, {} if straight_s == WHOLE_s else SHORT[name])


@cache
def found(name: str, straight_s: float = 5.0) -> Prediction:
    """What is predicted of it."""
    return predicted(plan_of(name, straight_s))


def path_of(name: str, straight_s: float, manoeuvre_s: float) -> FlightPath:
    """The motion that the sequences ask for, by hand."""
    turn_deg_s = 90.0 / manoeuvre_s if name == "turn" else 0.0
    along_m_s2 = 5.0 if name == "acceleration" else 0.0
    end_s = straight_s + manoeuvre_s
    return FlightPath(((0.0, 0.0, 0.0), (straight_s, along_m_s2, turn_deg_s), (end_s, 0.0, 0.0)), SPEED_m_s)


def ratios(name: str, straight_s: float, manoeuvre_s: float, blocks: int, runs: int) -> dict[Any, float]:
    """Spread of estimate minus truth over the predicted standard uncertainty, by quantity, method and axis."""
    planned = planned_of(compile_sequence(f"time_sync_{name}", None, {}))
    end_s, path = 2.0 * straight_s + manoeuvre_s, path_of(name, straight_s, manoeuvre_s)
    errors = [errors_of_flights(planned, path, end_s, runs, SEED + block) for block in range(blocks)]
    ratio = {}
    for entry in found(name, straight_s).estimates:
        own = entry.quantity, entry.conditions.get("method"), entry.conditions.get("axis")
        if own in errors[0]:
            seen = np.concatenate([each[own] for each in errors])
            ratio[own] = float(np.sqrt(np.mean(seen**2)) / entry.std_uncertainty)
    print(f"{name}, {blocks} x {runs} flights, seeds {SEED} on, median {np.median(list(ratio.values())):.3f}")
    print("\n".join(f"{value:.3f} {own}" for own, value in ratio.items()))
    return ratio


@cache
def stamps_errors(span_s: float, runs: int) -> dict[Any, Any]:
    return errors_of_stamps(planned_of(plan_of("turn")), span_s, runs, SEED)


def ratios_by_stamps(straight_s: float, span_s: float, runs: int) -> dict[Any, float]:
    """The same of the clocks by receive stamps; of the difference to a filter with what the filter is predicted."""
    errors = {own: seen for own, seen in stamps_errors(span_s, runs).items() if own[0] != STATED}
    by_filter = std_of("time_offset", straight_s, method="augmented_loose")
    offset_s = np.random.default_rng(SEED).normal(0.0, by_filter, runs)
    errors["stamps_difference", None] = offset_s - errors["time_offset_from_stamps", None]
    ratio = {
        own: float(
            np.sqrt(np.mean(seen**2)) / std_of(own[0], straight_s, **({} if own[1] is None else {"link": own[1]}))
        )
        for own, seen in errors.items()
    }
    print(f"stamps of {span_s:.0f} s, {runs} pairs, seed {SEED}, median {np.median(list(ratio.values())):.3f}")
    print("\n".join(f"{value:.3f} {own}" for own, value in ratio.items()))
    return ratio


def std_of(quantity: str, straight_s: float, **where: str) -> float:
    """The predicted one of a turn."""
    return estimate_of(found("turn", straight_s), quantity, **where).std_uncertainty


def alike(stated_s: Any) -> float:
    """How many errors of one size scatter in their mean square as those of many sizes; Welch and Satterthwaite."""
    variance = np.square(stated_s)
    return float(2.0 * stated_s.size / (3.0 * np.mean(variance**2) / np.mean(variance) ** 2 - 1.0))


@pytest.mark.parametrize(
    ("name", "times_s", "blocks", "runs", "within"),
    [
        ("turn", (5.0, 10.0), 1, 40, 0.15),
        pytest.param("turn", (WHOLE_s, WHOLE_s), 2, 250, 0.03, marks=pytest.mark.sweep),
        pytest.param("acceleration", (WHOLE_s, WHOLE_s), 2, 250, 0.03, marks=pytest.mark.sweep),
    ],
)
def test_predicted_is_the_spread_of_flights(
    name: str, times_s: tuple[float, float], blocks: int, runs: int, within: float
) -> None:
    """``times_s``: straight on, before and after, and in the manoeuvre."""
    ratio = ratios(name, *times_s, blocks, runs)
    assert outside(ratio, blocks * runs) == {}
    assert np.median(list(ratio.values())) == pytest.approx(1.0, abs=within)


def test_clocks_by_stamps_scatter_as_predicted() -> None:
    ratio = ratios_by_stamps(5.0, 20.0, 40)
    assert len(ratio) == 7
    del ratio["receive_jitter", "egi"]  # of 1,000 frames: where nothing shows the place within a step, it is a step's
    assert outside(ratio, 40) == {}


@pytest.mark.sweep
def test_clocks_of_500_pairs_scatter_as_predicted() -> None:
    """How well the jitter of 50 frames a second is known goes with the rate of its clock, by a factor of three."""
    ratio, errors = ratios_by_stamps(WHOLE_s, 3.0 * WHOLE_s, 500), stamps_errors(3.0 * WHOLE_s, 500)
    assert np.median(list(ratio.values())) == pytest.approx(1.0, abs=0.03)
    for link in ("imu", "egi"):
        own, stated_s = ("receive_jitter", link), errors[STATED, link]
        held = int(np.sum(np.abs(errors[own]) <= stats.norm.ppf(0.975) * stated_s))
        print(f"jitter, {link}: as {alike(stated_s):.0f} that are equally well known; {held} of 500 intervals hold")
        assert outside({own: ratio.pop(own)}, alike(stated_s)) == {}
        assert stats.binomtest(held, 500, 0.95).pvalue > 1e-3
    assert outside(ratio, 500) == {}


def test_results_and_predictions_are_of_the_same_epoch() -> None:
    """The results count time from the first frame, 10 s before the middle of 20 s."""
    epochs = {entry.conditions["at_s"] for entry in found("turn").estimates if "at_s" in entry.conditions}
    assert epochs == {10.0}


def test_scatter_of_stamps_that_is_not_declared_is_asked_for() -> None:
    planned = planned_of(plan_of("turn"))
    without = {name: value for name, value in planned.campaign.items() if name != "stamps"}
    known = predict(replace(planned, campaign=without))
    assert not {"clock_rate", "receive_jitter", "time_offset_drift"} & {entry.quantity for entry in known.estimates}
    assert [sentence for sentence in known.missing if "stamps: {jitter: " in sentence] == known.missing


@pytest.mark.parametrize("name", ["linear", "stationary"])
def test_a_motion_that_does_not_show_the_offset_is_named_with_one_that_would(name: str) -> None:
    assert [entry for entry in found(name).estimates if entry.quantity == "time_offset"] == []
    unseen = [sentence for sentence in found(name).missing if "does not show it" in sentence]
    assert len(unseen) == 2  # by both filters
    assert all("Plan a turn or an acceleration" in sentence for sentence in unseen)


@pytest.mark.parametrize(("section", "entry"), [("inertial", ""), ("egi", ""), ("egi", "position_m")])
def test_errors_that_are_not_declared_are_named(section: str, entry: str) -> None:
    planned = planned_of(plan_of("turn"))
    campaign = {name: value for name, value in planned.campaign.items() if entry or name != section}
    if entry:
        campaign[section] = {name: value for name, value in campaign[section].items() if name != entry}
    missing = predict(replace(planned, campaign=campaign))
    assert missing.estimates == []
    assert section in missing.missing[0]
    assert "Declare" in missing.missing[0]


@pytest.mark.parametrize("name", ["turn", "acceleration"])
def test_the_planned_motion_is_that_of_the_sequence(name: str) -> None:
    """Against the simulator's path and increments, which are integrals in closed form."""
    ready = planned_samples(planned_of(plan_of(name)))
    begin_s = float(ready.imu.t_s[0]) - 0.005
    path = path_of(name, 5.0, 10.0)
    true = path.state(ready.egi.t_s - begin_s)
    assert ready.span_s == pytest.approx(20.0, abs=0.01)
    np.testing.assert_allclose(ready.egi.v, true.v, atol=0.03)  # borders of the manoeuvre lie within a sample
    np.testing.assert_allclose(ready.egi.p, true.p - true.p[0] + ready.egi.p[0], atol=0.3)
    dv, dtheta = exact_increments(path, np.concatenate(([0.0], ready.imu.t_s - begin_s)))
    assert np.sqrt(np.mean((ready.imu.dv[:, 0] - dv) ** 2)) < 1e-3
    assert np.sqrt(np.mean((ready.imu.dtheta[:, 0] - dtheta) ** 2)) < 1e-5


_AGE, _DELAY = "Age of the solutions", "Least delay, "
GROSS: dict[str, tuple[int, list[str]]] = {  # estimates that are doubted at the least, and what is said
    "solutions_older_than_tags": (3, [f"{_AGE}: +30", "least delay, at frames of the EGI only"]),
    "latency_not_as_stated": (3, ["at frames of the EGI only", "age of the solutions"]),
    "age_steps": (2, [f"{_AGE}, step between 9.6 s and 10.1 s after the begin"]),
    "age_drifts": (4, ["drift from begin to end"]),
    "velocity_older": (2, [f"{_AGE}, at velocity only: +100 ms"]),
    "lever_arm": (2, ["Lever arm between both units, forward: -10 m", "enter it into the EGI"]),
    "axes_turned": (2, ["Axes of both units turned against each other, right: -0.09"]),
    "bad_burst": (2, ["8.4 s, there only"]),
    "frozen_solutions": (3, ["24 solutions of the EGI repeat the one before"]),
    "line_fills": (4, ["drift from begin to end"]),
    "line_switches": (3, [f"{_DELAY}frames of the EGI, step between 7.49 s and 9.97 s after the begin: +9.91 ms"]),
    "larger_errors": (2, ["What the fit leaves over is no noise"]),
}
BY_NAME = {switch.name: switch for switch in worlds.SWITCHES}


@pytest.mark.parametrize("name", GROSS)
def test_what_is_grossly_wrong_is_doubted_and_named(name: str) -> None:
    wrong = worlds.seen(0, BY_NAME[name], BY_NAME[name].sizes[-1])
    counted, (least, words) = sorted_classes(wrong, right_world(worlds, 0)), GROSS[name]
    assert counted[WRONG] == 0
    assert counted[DOUBTED] + counted[REFUSED] >= least
    said = " ".join(reason.sentence for entry in wrong.entries for reason in entry.reasons)
    assert all(word in said for word in words), said


@pytest.mark.parametrize(
    ("name", "size", "words"),
    [
        ("gyro_scale", 1e3, "Scale of the gyros of the inertial unit"),
        ("accelerometer_scale", 1e4, "Scale of the accelerometers of the inertial unit"),
        ("velocity_older", 10.0, "Age of the solutions, at velocity only"),
    ],
)
def test_what_departs_moves_results_as_far_as_it_says(name: str, size: float, words: str) -> None:
    """Against the filters themselves, of the same seed in a right world."""
    world = BY_NAME[name].world(size * (1e-6 if "scale" in name else 1e-3))
    right, wrong = (worlds.analyse(worlds.Recording(0, one).material()) for one in (worlds.World(), world))
    (found,) = [seen for seen in wrong.evidence if seen.code == "departs"]
    assert words in found.sentence
    assert found.figure == pytest.approx(size, rel=0.05)
    pairs = [pair for pair in zip(right.estimates, wrong.estimates, strict=True) if pair[1] in found.entries]
    moved = [abs(one.value - other.value) / other.expanded_uncertainty for one, other in pairs if other.std_uncertainty]
    assert max(moved) == pytest.approx(found.move, rel=0.1)


def test_an_offset_beyond_what_was_looked_for_is_refused() -> None:
    wrong = worlds.seen(0, BY_NAME["solutions_older_than_tags"], 0.2)
    assert sorted_classes(wrong, right_world(worlds, 0))[REFUSED] == 2
    assert "implausible_offset" in codes_of(wrong)


@pytest.mark.parametrize(
    ("name", "note"),
    [("one_bad_solution", "1 solutions of the EGI"), ("one_bad_increment", "1 samples of the inertial unit")],
)
def test_one_bad_reading_is_left_out_and_named(name: str, note: str) -> None:
    size = BY_NAME[name].sizes[-1]
    analysis = worlds.analyse(worlds.Recording(0, BY_NAME[name].world(size)).material())
    assert any(note in sentence for sentence in analysis.notes)
    wrong = worlds.seen(0, BY_NAME[name], size)
    assert codes_of(wrong) == set()
    for entry, before in zip(wrong.entries, right_world(worlds, 0).entries, strict=True):
        assert abs(entry.value - before.value) < 0.1 * before.expanded_uncertainty


@pytest.mark.parametrize("seed", range(3))
def test_a_right_world_is_not_doubted_and_nothing_is_left_out(seed: int) -> None:
    seen = right_world(worlds, seed)
    assert [entry.reasons for entry in seen.entries if entry.quality != "sound"] == []
    assert all(entry.dropped == 0 for entry in seen.entries)


def taken_for_granted(**sections: object) -> dict[str, Assumption]:
    stated = {"analysis": "time_sync", "latency": {"egi_s": 8e-3, "imu_s": 8e-4, "std_s": 1e-3}}
    return {taken.code: taken for taken in assumptions_of(stated | sections)}


def test_what_no_recording_can_show_is_named_with_its_size() -> None:
    assert {switch.assumption for switch in worlds.SWITCHES} - {""} <= set(taken_for_granted())
    assert "up to 7.1 ms" in taken_for_granted()["latency_as_stated"].unseen
    assert "any size" in taken_for_granted(latency=None)["latency_as_stated"].unseen
    for velocity_m_s, text in ((0.017, "0.5 ms"), (0.17, "5.0 ms")):
        assert text in taken_for_granted(egi={"velocity_m_s": velocity_m_s})["one_offset"].unseen
    assert len(assumptions_of(compile_sequence("time_sync_turn", None, {}).campaign)) == 4
