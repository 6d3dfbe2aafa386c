"""What the DMM method takes from its standards: zeros, certificates, limits; each number by hand."""

import copy
import dataclasses

import numpy as np
import pytest
from dmm_simulation import OFFSET_A, QUANTITIES, SPECIFICATION, material, meter_range, of, readings_of, simulate

from bench.analysis import Reading
from bench.systems.af_converter.dmm_method import analysis as dmm_method
from bench.systems.af_converter.dmm_method.readings import MeterLog, reading_sets


def test_the_reading_beside_a_record_is_the_current_the_meter_was_given() -> None:
    """A zero with the wrong sign would leave twice the zero, up to 8 uA here; given are the set-point and OFFSET_A."""
    campaign, drawn = simulate(3)
    drawn.gain, drawn.linearity_A = dict.fromkeys(SPECIFICATION, 0.0), {}
    drawn.zero_A = {full: 4e-6 * full for full in SPECIFICATION}
    closed = [row for row in campaign.rows if row.window.conditions["route"] == "closed"]
    levels = {row.window.conditions["current_A"] for row in closed}
    drawn.linearity_A = {(full, level): 0.0 for full in SPECIFICATION for level in levels}
    log = MeterLog(campaign.rows, readings_of(campaign, drawn))  # type: ignore[arg-type]
    meter = log.meter([row.window.number for row in closed])
    given_A = np.array([row.window.conditions["current_A"] * (1 + campaign.gain) + OFFSET_A for row in closed])
    assert (np.abs(meter.current_A - given_A) < 5e-9 * meter.range_A).all()


@pytest.mark.parametrize("method", ["joint", "as_printed"])
def test_the_calibration_of_the_meter_itself_is_a_component(method: str) -> None:
    """30 ppm (95 %) common to all ranges: 15 ppm in every scale factor, nothing in the asymmetry."""
    campaign, drawn = simulate(3)
    plain = material(campaign, readings_of(campaign, drawn))
    stated = copy.deepcopy(dict(plain.standards))
    stated["dmm"]["traceability_relative"] = 3e-5
    found = [dmm_method.analyse(dataclasses.replace(plain, standards=one), method) for one in (plain.standards, stated)]
    assert [any("relative to its own calibration" in note for note in one.notes) for one in found] == [True, False]
    for before, after in zip(*(of(one, *QUANTITIES, "dsf_asymmetry", "dsf_mean") for one in found), strict=True):
        more_ppm2 = after["std_uncertainty"] ** 2 - before["std_uncertainty"] ** 2
        assert more_ppm2 == pytest.approx(0.0 if before["quantity"] == "dsf_asymmetry" else 225.0, rel=1e-2, abs=1e-3)


def test_both_standards_count_in_full_in_the_agreement() -> None:
    """By hand: the meter's method, 10 ppm of gain and 20 ppm of a stated calibration of the calibrator."""
    campaign, drawn = simulate(3)
    plain = material(campaign, readings_of(campaign, drawn))
    stated = copy.deepcopy(dict(plain.standards))
    stated["calibrator"]["traceability_relative"] = 4e-5
    analysis = dmm_method.analyse(dataclasses.replace(plain, standards=stated))
    (table,) = [one for one in analysis.tables if one.title.startswith("DMM method and")]
    by_place = {(one["conditions"]["channel"], one["quantity"]): one for one in of(analysis, *QUANTITIES)}
    for row in table.rows:
        own_ppm = by_place[row[0], row[2]]["std_uncertainty"]
        assert row[6] == pytest.approx(1.96 * np.sqrt(own_ppm**2 + 10.0**2 + 20.0**2), rel=0.02)


def test_a_shift_is_judged_by_the_specification_and_knows_of_the_random_walk() -> None:
    campaign, drawn = simulate(8)
    plain = material(campaign, readings_of(campaign, drawn))
    walking = copy.deepcopy(dict(plain.campaign))
    for one in walking["channels"]:
        one["noise"]["walk_A_rth"] = 1e-6
    steady = of(dmm_method.analyse(plain), "repeat_shift")
    for one, other in zip(
        steady, of(dmm_method.analyse(dataclasses.replace(plain, campaign=walking)), "repeat_shift"), strict=True
    ):
        level_A, polarity = one["conditions"]["current_A"], one["conditions"]["polarity"]
        relative, floor = SPECIFICATION[meter_range(level_A)]
        assert one["limit"] == pytest.approx(1e6 * (relative + floor * meter_range(level_A) / level_A))
        wanted = {"channel": 1, "current_A": level_A, "polarity": polarity}
        places = [row.window.t_start_ns for row in campaign.rows if wanted.items() <= row.window.conditions.items()]
        hours = abs(places[1] - places[0]) / 3.6e12
        assert other["std_uncertainty"] == pytest.approx(1e6 * 1e-6 * np.sqrt(hours) / level_A, rel=0.05)


def test_readings_without_a_value_leave_the_others_of_their_set() -> None:
    values = [("configure_current", 1e-3), *[("measure_current", one) for one in (None, 1e-4, float("nan"), 3e-4)]]
    (found,) = reading_sets(Reading(float(at), 0, "dmm", name, value) for at, (name, value) in enumerate(values))
    assert (found.values_A, found.end_s) == ([1e-4, 3e-4], 4.0)
