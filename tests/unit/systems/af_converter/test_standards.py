"""Every standard enters once: by a label that all results with the same error carry, each by its own derivative."""

import copy
import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any

import dmm_simulation
import fit_simulation as sim
import numpy as np
import pytest
from one_estimate import every
from scipy import special

from bench.analysis import (
    Analysis,
    Material,
    analyse,
    build_results,
    covariance_by_standards,
    documents,
    validate_results,
)
from bench.systems.af_converter.dmm_method import analysis as dmm_method
from bench.systems.af_converter.scale_factor.analysis import analyse as scale_factor

SEED = 3
LAST_RANGE = 2.2e-1
PROVENANCE = {"simulated": True, "plan_sha256": "", "frame_sha256": "", "session_sha256": "", "software": "a test"}


@pytest.fixture(scope="module")
def campaign() -> sim.SimulatedCampaign:
    return sim.simulate(SEED)


def register(campaign: sim.SimulatedCampaign, entry: Mapping[str, Any] = {}, **words: Any) -> dict[str, Any]:
    """Return the register of a campaign: ``words`` in every range of the calibrator, ``entry`` in its entry."""
    plain = campaign.standards["calibrator"]
    lines = [line | words for line in plain["uncertainty"]]
    return {"calibrator": plain | {"model": "5720A", "certificate": "C-1", "uncertainty": lines} | dict(entry)}


def run(campaign: sim.SimulatedCampaign, standards: Mapping[str, Any], **more: Any) -> Analysis:
    """Fit without the budgets' tables, which nothing here reads."""
    return scale_factor(Material(campaign.rows, campaign.campaign | more, standards))


def traced(campaign: sim.SimulatedCampaign, expanded: float = 8e-6, **words: Any) -> dict[str, Any]:
    return register(campaign, specification="relative", certificate_U=expanded, **{"common_with": "R 7"} | words)


@pytest.fixture(scope="module")
def plain(campaign: sim.SimulatedCampaign) -> Analysis:
    return run(campaign, register(campaign))


def stds(analysis: Analysis, quantity: str) -> np.ndarray:
    return np.array([entry.std_uncertainty for entry in every(analysis, quantity)])


@pytest.mark.validates(
    "certificate of the calibrator in U", against="root sum of squares by hand, U / k of the certificate"
)
@pytest.mark.parametrize(("expanded", "k", "std_ppm"), [(8e-6, 2.0, 4.0), (24e-6, 2.4, 10.0)])
def test_the_certificate_comes_on_top_of_a_relative_specification(
    campaign: sim.SimulatedCampaign, plain: Analysis, record_property: Callable[[str, object], None], expanded: float,
    k: float, std_ppm: float,
) -> None:  # fmt: skip
    found = run(campaign, traced(campaign, expanded, k=k))
    for quantity in ("dsf_n", "dsf_p", "dsf_n_tc0"):
        more_ppm = np.sqrt(stds(found, quantity) ** 2 - stds(plain, quantity) ** 2)
        np.testing.assert_allclose(more_ppm, std_ppm, rtol=2e-3)
    for quantity in ("dsf_asymmetry", "dsf_n_tc1", "dsf_p_tc2", "dsf_n_residual"):  # the gain leaves nothing
        np.testing.assert_allclose(stds(found, quantity), stds(plain, quantity), rtol=0.05)
    assert [entry.value for entry in found.estimates] == [entry.value for entry in plain.estimates]
    absolute = run(campaign, register(campaign, specification="absolute"))  # it holds the certificate already
    assert absolute.estimates == plain.estimates
    notes = [any("relative to its own calibration" in note for note in one.notes) for one in (plain, found, absolute)]
    assert notes == [True, False, False]
    record_property(
        "obtained", f"U of dsf_n {1.96 * stds(plain, 'dsf_n')[0]:.2f} to {1.96 * stds(found, 'dsf_n')[0]:.2f} ppm"
    )


def test_ranges_without_a_common_calibration_add_less(campaign: sim.SimulatedCampaign) -> None:
    common, own = (stds(run(campaign, traced(campaign, common_with=name)), "dsf_n") for name in ("R 7", None))
    assert (own < common).all()


def test_degrees_of_freedom_of_the_certificate(campaign: sim.SimulatedCampaign) -> None:
    """By hand: 10 ppm of 5 degrees in the combined uncertainty (Welch and Satterthwaite), and Student's t."""
    entry = run(campaign, traced(campaign, 20e-6, dof=5.0)).estimates[0]
    assert entry.dof == pytest.approx(entry.std_uncertainty**4 / (10.0**4 / 5.0), rel=1e-2)
    assert entry.coverage_factor == pytest.approx(special.stdtrit(entry.dof, 0.975))


@pytest.mark.validates(
    "what an error of the calibrator brings to each of 32 results",
    against="the campaign fitted again with the register's correction off by that error",
)
@pytest.mark.parametrize(
    ("label", "ranges", "correction"),
    [
        ("5720A 1 C-1: gain", sim.FLOOR_A, {"gain": 10e-6}),
        ("R 7", sim.FLOOR_A, {"gain": 4e-6}),
        (f"5720A 1 C-1: calibration of the range {LAST_RANGE:g} A", [LAST_RANGE], {"gain": 4e-6}),
        (f"5720A 1 C-1: offset of the range {LAST_RANGE:g} A", [LAST_RANGE], {"offset_A": 0.35e-6}),
    ],
)
def test_a_label_says_by_how_much_its_error_moves_a_result(
    campaign: sim.SimulatedCampaign, label: str, ranges: Any, correction: dict[str, float]
) -> None:
    standards = traced(campaign, common_with="R 7" if label == "R 7" else None)
    moved = copy.deepcopy(standards)
    for line in moved["calibrator"]["corrections"]:
        # zero rows have the offset of their range too: as in the model, both change sign with the switch
        line.update(correction if line["range_A"] in ranges else {})
    pairs = zip(run(campaign, standards).estimates, run(campaign, moved).estimates, strict=True)
    held = [(one, other) for one, other in pairs if one.quantity in ("dsf_n", "dsf_p", "dsf_asymmetry", "dsf_n_tc0")]
    assert len(held) == 32
    for one, other in held:
        part = one.common.standards.get(label, 0.0)
        assert other.value - one.value == pytest.approx(part, rel=2e-3, abs=1e-4)


def test_what_an_estimate_shares_is_a_part_of_its_uncertainty(campaign: sim.SimulatedCampaign) -> None:
    analysis = run(campaign, traced(campaign) | {"function_generator": {"serial": "2", "certificate": "F-1"}})
    document = build_results("s", analysis, {}, PROVENANCE)
    validate_results(document)
    for entry in document["estimates"]:
        if "common" in entry:
            parts = [*entry["common"]["standards"].values(), *entry["common"]["campaign"].values()]
            assert math.hypot(*parts) <= entry["std_uncertainty"] * (1.0 + 1e-9)
    (clock,) = {tuple(e["common"]["standards"]) for e in document["estimates"] if e["quantity"] == "master_clock_error"}
    assert clock == ("2 F-1: frequency",)


def test_a_standard_nobody_can_name_is_shared_within_the_campaign_only(campaign: sim.SimulatedCampaign) -> None:
    unknown = register(campaign, {"certificate": ""}, specification="relative", certificate_U=8e-6)
    common = run(campaign, unknown).estimates[0].common
    assert common.standards == {}
    assert "calibrator: gain" in common.campaign


def test_a_change_leaves_out_what_both_calibrations_share(campaign: sim.SimulatedCampaign) -> None:
    """Against itself, as an earlier calibration with the same calibrator, and as one that does not say."""
    earlier = run(campaign, traced(campaign)).estimates
    said = documents(earlier)
    silent = [{key: value for key, value in entry.items() if key != "common"} for entry in said]
    of = {
        name: stds(run(campaign, traced(campaign), previous=previous), "dsf_n_change")
        for name, previous in (("said", said), ("silent", silent))
    }
    np.testing.assert_allclose(of["silent"], stds(run(campaign, traced(campaign)), "dsf_n") * np.sqrt(2.0))
    shared = [covariance_by_standards(entry.common, entry.common) for entry in earlier if entry.quantity == "dsf_n"]
    np.testing.assert_allclose(of["said"] ** 2, of["silent"] ** 2 - 2.0 * np.array(shared))
    assert (of["said"] < 0.2 * of["silent"]).all()


@pytest.mark.parametrize(("days", "expired"), [(90.0, True), (91.5, False)])
def test_a_specification_that_ends_before_the_campaign_makes_it_doubtful(
    campaign: sim.SimulatedCampaign, days: float, expired: bool
) -> None:
    """Calibrated on 1 January 2000; the campaign ends 91 days and some hours after it."""
    standards = register(campaign, {"calibrated": "2000-01-01"}, age_s=86_400.0 * days)
    end_s = 1e-9 * max(row.window.t_end_ns for row in campaign.rows)
    begun = 946_684_800.0 + 91.0 * 86_400.0 + 3600.0 - end_s
    material = Material(campaign.rows, campaign.campaign, standards, utc_offset_s=begun)
    document = build_results("s", analyse(material), {}, PROVENANCE)
    unsound = {entry["quantity"] for entry in document["estimates"] if entry["quality"] == "doubtful"}
    assert bool(unsound) is expired
    assert not any("common" in entry for entry in document["estimates"] if entry["quality"] == "doubtful")
    if expired:
        assert {"dsf_n", "dsf_p", "dsf_asymmetry", "dsf_n_tc1"} <= unsound
        assert not any(quantity.startswith(("bias", "clock", "master")) for quantity in unsound)
        assert "holds 90 days after its calibration, and the measurement ended 91 days" in str(document)
    unknown = analyse(dataclasses.replace(material, utc_offset_s=None))
    assert not [seen for seen in unknown.evidence if seen.code == "specification_expired"]


def agreement(named: str | None) -> tuple[np.ndarray, list[Any]]:
    """Return U of the difference of both methods, and the table; both standards with the same calibration or not."""
    campaign, drawn = dmm_simulation.simulate(SEED)
    material = dmm_simulation.material(campaign, dmm_simulation.readings_of(campaign, drawn))
    standards = copy.deepcopy(dict(material.standards))
    for role in ("dmm", "calibrator"):
        for line in standards[role]["uncertainty"]:
            line |= {"specification": "relative", "certificate_U": 24e-6, "k": 2.0, "common_with": named or role}
    analysis = dmm_method.analyse(dataclasses.replace(material, standards=standards))
    (table,) = [table for table in analysis.tables if "calibrator method" in table.title]
    return np.array([row[6] for row in table.rows]), table.rows


@pytest.mark.validates(
    "agreement of two methods whose standards were calibrated with one", against="JCGM 100:2008 equation (16) by hand"
)
def test_the_agreement_of_methods_leaves_out_a_calibration_that_both_standards_share() -> None:
    """12 ppm each: 2 x 144 ppm² of the variance of the difference go, whatever else is in it."""
    apart, rows = agreement(None)
    shared, same = agreement("R 7")
    np.testing.assert_allclose((apart / 1.959964) ** 2 - (shared / 1.959964) ** 2, 2.0 * 144.0, rtol=5e-3)
    assert [row[5] for row in rows] == [row[5] for row in same]
