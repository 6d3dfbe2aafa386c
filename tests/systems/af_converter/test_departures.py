"""The engine of doubt on scale-factor campaigns: what departs is named with its size, what does not is left alone.

Campaigns of one temperature whose unit still warms up, by 0.43 degC with a lag of 25 min (``fit_simulation``).
"""

import sys
from collections.abc import Callable
from typing import Any

import doubt_departures as worlds
import fit_simulation as sim
import numpy as np
import pytest
from doubt_classes import WRONG, right_world, sorted_classes
from scipy import stats
from spoken import english_left
from trials import without_budgets

from bench.analysis import Analysis, Departure, Estimates, Labels, Material, Planned, Residuals, departures_of, search
from bench.systems.af_converter.group_fit import UNKNOWN_SLOPE_ppm_degC
from bench.systems.af_converter.scale_factor.analysis import analyse, predicted
from bench.systems.af_converter.scale_factor.estimates import determine
from bench.systems.af_converter.wording import say

SWITCHES = {switch.name: switch for switch in worlds.SWITCHES}


@pytest.mark.parametrize(
    ("name", "size", "words"),
    [
        ("one_channel_steps", 2e-4, ["What is counted, channel 4, step between", "+200 ppm"]),
        ("exchanged", 1.0, ["hannels 3, 4 taken for each other"]),
        ("calibrator_cycle", 1e-4, ["What is counted, cycle of about 24 h: +100 ppm"]),
        ("calibrator_warms_up", 2e-4, ["settles in about"]),
        ("self_heating", 5e-4, ["grows with the power 2 of the level"]),
        ("memory", 20.0, ["the current of the step before"]),
        ("settling_tail", 5e-6, ["what a change leaves, gone in about 40 s: +5.01 ppm"]),
        ("settling_onset", 4e-5, ["what switching the current on leaves"]),
    ],
)
def test_what_departs_is_named_with_its_size(name: str, size: float, words: list[str]) -> None:
    seen = worlds.seen(11, SWITCHES[name], size)
    said = " ".join(reason.sentence for entry in seen.entries for reason in entry.reasons if reason.code == "departs")
    assert all(word in said for word in words), said
    assert sorted_classes(seen, right_world(worlds, 11))[WRONG] == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    "switch",
    [pytest.param(switch, marks=[pytest.mark.sweep] * (at % 3 > 0)) for at, switch in enumerate(worlds.SWITCHES[12:])],
    ids=lambda switch: switch.name,
)
def test_no_drawn_world_that_could_be_seen_is_believed(switch: worlds.Switch) -> None:
    size = switch.sizes[1]
    wrong = sorted_classes(worlds.seen(12, switch, size), right_world(worlds, 12))[WRONG]
    assert wrong == 0 or worlds.seen(0, switch, size, noise_free=True).chi2 < worlds.SEEN**2


@pytest.mark.parametrize(("number", "size", "seed"), [(4116, 3e-9, 901), (4120, 3e-8, 900), (4128, 1e-5, 900)])
def test_a_world_of_which_some_visits_were_believed(number: int, size: float, seed: int) -> None:
    """One range drifts, in steps that some visits show and some nearly; a counter differs behind a current."""
    seen = worlds.seen(seed, worlds.drawn_world(number), size)
    assert sorted_classes(seen, right_world(worlds, seed))[WRONG] == 0


@pytest.mark.parametrize(("visits", "doubted"), [(1, False), (14, True)])
def test_odd_records_that_are_alike_are_no_chance(visits: int, doubted: bool) -> None:
    """One level of one polarity is off by 0.1 % in some visits, each of which leaves that record out."""

    class OneLevel(sim.World):
        def counted(self, counts: dict[str, float], at: sim.Place) -> dict[str, float]:
            number = 4 * sim.TEMPERATURES_degC.index(at.nominal_degC) + list(worlds.KINDS).index(at.channel)
            level_A = sim.KIND[worlds.KINDS[at.channel]]["levels_A"][4]
            wrong = number < visits and at.step[1:3] == (level_A, 1)
            return counts | {"n": counts["n"] * (1.0 + 1e-3 * wrong)}

    said = sim.analysed(worlds.simulated(17, OneLevel())).evidence
    (found,) = [seen for seen in said if seen.code == "odd_alike"]
    assert visits / 2.0 < found.figure <= visits
    assert (found.probability < 1e-6) == doubted


@pytest.mark.parametrize(("limit_ppm", "departs"), [(1.0, True), (100.0, False), (None, False)])
def test_a_curve_is_the_units_own_as_far_as_its_limit_lets_it(limit_ppm: float | None, departs: bool) -> None:
    """A cubic of 81 ppm at the warmest; where no limit is set it may have any size."""
    campaign = worlds.simulated(18, SWITCHES["cubic_of_all"].world(3e-3))
    for channel in campaign.campaign["channels"]:
        channel["stability_limit_ppm"] = limit_ppm
    said = {seen.code for seen in sim.analysed(campaign).evidence}
    assert ("departs" in said) == departs


class Scattered(sim.World):
    """Counters that differ from visit to visit, and curves that are no parabolas: of the unit's own, ppm."""

    def __init__(self, seed: int, visits: float, curve: float) -> None:
        self.seed, self.visits, self.curve = seed, visits, curve

    def counted(self, counts: dict[str, float], at: sim.Place) -> dict[str, float]:
        share = (at.nominal_degC - sim.REFERENCE_degC) / 30.0
        rng = np.random.default_rng([self.seed, at.channel])
        curves = rng.normal(0.0, self.curve, (2, 2)) @ [share**3, share**4]
        place = np.random.default_rng([self.seed, at.channel, round(at.nominal_degC + 273.0), at.repeat])
        off_ppm = curves + place.normal(0.0, self.visits, 2)
        return counts | {name: counts[name] * (1.0 + 1e-6 * off) for name, off in zip("np", off_ppm, strict=True)}


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [3, pytest.param(10, marks=pytest.mark.sweep)])
@pytest.mark.parametrize(("visits", "curve"), [(0.05, 0.0), (0.5, 0.0), (0.0, 1.0), (0.0, 3.0)])
def test_a_unit_of_its_own_is_not_doubted(visits: float, curve: float, seeds: int) -> None:
    for seed in range(2000, 2000 + seeds):
        with without_budgets():
            heard = sim.analysed(worlds.simulated(seed, Scattered(seed, visits, curve))).evidence
        assert not [seen for seen in heard if seen.code in ("departs", "unexplained")], seed


def test_the_judge_sees_what_is_there_and_nothing_else() -> None:
    """A common gain is hidden; a row alone has the length of its error over the noise, less what its visit fits."""
    right = worlds.simulated(3, None, worlds.QUIET)
    hidden = worlds.Departed(1e-4, "gain", lambda at: 1.0)
    assert worlds.left_over(worlds.simulated(3, hidden, worlds.QUIET), right) < 0.05
    place = (4, 20.0, (1e-3, 1))
    one = worlds.Departed(1e-6, "current", lambda at: (at.channel, at.nominal_degC, at.step[1:3]) == place)
    quantum_A = sim.KIND["gyro"]["k0_C"] / 100.0 / np.sqrt(6.0)
    assert 0.85 < worlds.left_over(worlds.simulated(3, one, worlds.QUIET), right) * quantum_A / 1e-6 < 1.0


def test_a_gain_is_that_of_the_fit_with_the_column_free() -> None:
    """Against ordinary least squares with and without the column; no scatter but noise."""
    rng = np.random.default_rng(46)
    design, effect, readings = rng.normal(size=(60, 4)), rng.normal(size=(60, 1)), rng.normal(size=60)
    readings += 4.0 * effect[:, 0]
    operator = np.linalg.pinv(design)
    rows = Residuals(readings, readings, design, lambda columns: columns, operator, np.ones(4), np.ones(4))
    (found,) = search(rows, [Departure("gain", "drift", "ppm", effect)]).findings
    both = np.hstack([design, effect])
    chi2 = [float(np.linalg.lstsq(one, readings, rcond=None)[1][0]) for one in (design, both)]
    assert found.gain == pytest.approx(chi2[0] - chi2[1])
    assert found.size == pytest.approx(np.linalg.lstsq(both, readings, rcond=None)[0][-1])


def test_what_no_data_show_moves_a_result_by_its_uncertainty() -> None:
    """The gain of a channel alone is its scale factor, which is known as far as its uncertainty says."""
    with without_budgets():
        analysis = sim.analysed(worlds.simulated(11, None))
    sizes = {departure: rest for departure, *rest in analysis.tables[-1].rows}
    quantity, size, found = sizes["what is counted, at channel 7 only"]
    known = [entry for entry in analysis.estimates if entry.quantity == quantity and entry.conditions["channel"] == 7]
    assert (size, found) == (f"{min(float(entry.expanded_uncertainty) for entry in known):.2g} ppm", "never")


def test_labels_make_each_shape_once() -> None:
    labels = Labels(
        kinds={"channel": np.array([1, 1, 2, 2])},
        hours=np.arange(4.0),
        visit=np.array([0, 0, 1, 1]),
        scales={},
        carriers={"gain": ("ppm", np.ones(4))},
        scopes=[(), ("channel",)],
        corners=[],
        exchanged=("channel", "channel", "channel", "gain"),
    )
    effects = [one.effect.tobytes() for one in departures_of(labels) if one.carrier == "gain"]
    assert len(effects) == len(set(effects))


def test_a_korean_reader_gets_what_departs_in_korean() -> None:
    analysis = sim.analysed(worlds.simulated(11, SWITCHES["calibrator_cycle"].world(1e-4)))
    assert "departs" in {seen.code for seen in analysis.evidence}
    assert english_left(analysis) == set()


CAMPAIGNS = 60  # seeds from 0 on
INSIDE = 0.999
CHANGES = ("calibrator_drift", "dsf_n_drift", "dsf_p_drift")
OF_ONE: dict[str, Any] = {"temperatures": (20.0,), "repeat_channel": 1}


def material_of(campaign: sim.SimulatedCampaign) -> Material:
    return Material(campaign.rows, campaign.campaign, campaign.standards)


def planned(campaign: sim.SimulatedCampaign) -> Planned:
    return Planned(campaign.windows, campaign.campaign, campaign.standards)


def scores_of(slope_ppm_degC: float) -> dict[str, list[float]]:
    """Return error over standard uncertainty of each scale factor and change, by quantity; the calibrator is steady."""
    scores: dict[str, list[float]] = {}
    for seed in range(CAMPAIGNS):
        campaign = sim.simulate(seed, sim.Switches(tc1_sigma_ppm_degC=slope_ppm_degC), **OF_ONE)
        for entry in determine(material_of(campaign), "gls").estimates:
            quantity = entry.quantity
            if quantity.startswith("dsf") or quantity in CHANGES:
                truth = 0.0 if quantity in CHANGES else campaign.truth(entry)
                scores.setdefault(quantity, []).append((entry.value - truth) / entry.std_uncertainty)
    return scores


def drifts(estimates: Estimates) -> dict[str, Any]:
    return {entry.quantity: entry for entry in estimates if entry.quantity in CHANGES}


@pytest.mark.validates(
    "changes between visits and scale factors of a campaign of one temperature",
    against="60 simulated campaigns of units that warm by 0.43 degC, coefficients of 8 ppm/degC",
)
def test_intervals_hold_the_truth_while_the_unit_warms(record_property: Callable[[str, object], None]) -> None:
    """At least as many as chance leaves of 95 %: before, 0.48 to 0.62 of the changes and 0.05 of the asymmetries."""
    held = {name: [abs(score) <= 1.96 for score in each] for name, each in scores_of(8.0).items()}
    said = ", ".join(f"{name} {np.mean(each):.3f} of {len(each)}" for name, each in held.items())
    sys.stdout.write(f"seeds 0 to {CAMPAIGNS - 1}: {said}\n")
    record_property("obtained", said)
    assert held.keys() >= {*CHANGES, "dsf_n", "dsf_p", "dsf_asymmetry"}
    for name, each in held.items():
        assert sum(each) >= stats.binom.ppf(1.0 - INSIDE, len(each), 0.95), name


def test_uncertainties_are_those_of_the_coefficients_that_they_count() -> None:
    """Of units drawn with coefficients as large as nobody's, the scatter is the stated one, neither less nor more."""
    for name, each in scores_of(UNKNOWN_SLOPE_ppm_degC).items():
        low, high = stats.chi2.ppf([(1 - INSIDE) / 2, (1 + INSIDE) / 2], len(each)) / len(each)
        sys.stdout.write(f"{name}: {np.mean(np.square(each)):.3f}, {low:.3f} to {high:.3f}\n")
        if name not in ("dsf_n", "dsf_p"):  # their largest part is the calibrator's gain, which both kinds share
            assert low < np.mean(np.square(each)) < high, name


def run(drift_ppm: float, *, lag: bool) -> Analysis:
    """Return the analysis of a campaign whose calibrator delivers more in the repeat."""
    campaign = sim.simulate(4, sim.Switches(lag=lag), **OF_ONE)
    return analyse(Material(sim.repeated_off(campaign, drift_ppm), campaign.campaign, campaign.standards))


def component_ppm(analysis: Analysis) -> float:
    parts = (one for one in analysis.components if one["component"] == "calibrator drift over the campaign")
    return max((one["std_uncertainty_ppm"] for one in parts), default=0.0)


def test_a_steady_unit_shows_a_drift_and_it_counts() -> None:
    found = run(4.0, lag=False)
    drift = drifts(found.estimates)["calibrator_drift"]
    assert drift.value == pytest.approx(4.0, abs=drift.expanded_uncertainty)
    assert drift.expanded_uncertainty < 1.0
    assert component_ppm(found) > 2.0
    assert any("this is the drift of the calibrator in the budget" in note for note in found.notes)


def test_what_warming_can_explain_bounds_no_drift_and_says_so() -> None:
    found = run(4.0, lag=True)
    assert drifts(found.estimates)["calibrator_drift"].expanded_uncertainty > 20.0
    assert component_ppm(found) == 0.0
    (note,) = [note for note in found.notes if "cannot be told apart" in note]
    assert "temperature differed by +0.24 degC" in note
    assert any("a drift over the campaign is not included" in note for note in found.notes)
    assert component_ppm(run(100.0, lag=True)) > 50.0, "no coefficient makes as much of so little warming"


def test_the_prediction_names_what_warming_may_be() -> None:
    campaign = sim.simulate(4, **OF_ONE)
    found = predicted(planned(campaign))
    assert drifts(found.estimates) == {}
    assert {"dsf_n", "dsf_asymmetry", "bias"} <= {entry.quantity for entry in found.estimates}
    assert found.missing == [say("predicted.untold", place="channel 1 at 20 degC, repeat 1", step=1.0)]
    assert found.assumed == [say("predicted.steady", step=1.0)]
    several = predicted(planned(sim.simulate(4, temperatures=(5.0, 20.0), repeat_channel=1)))
    assert drifts(several.estimates).keys() == set(CHANGES)
    assert (several.missing, several.assumed) == ([], [])
