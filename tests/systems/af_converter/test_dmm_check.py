"""The plan with zeros in every range on the simulated bench: its length, its zeros, and a drifting calibrator."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from rehearsal import Rehearsal
from units_campaign import cut

from bench.analysis import analyse
from bench.plan import Plan, check_plan, compile_sequence
from bench.session.service import read_view
from bench.session.view import material_of
from sim_instruments.worlds.common.world import World

CUTS = (
    ("sequence: scale_factor_zero_per_range", "sequence: tiny_zeros"),
    ("duration: 163200 s\nrecords: 985", "duration: 5190 s\nrecords: 53"),
    ("dwell: 100 s", "dwell: 10 s"),
    ("slot: 9000 s", "slot: 3600 s"),
    ("in: [-10 degC, 5 degC, 20 degC, 35 degC, 50 degC]", "in: [25 degC]"),
    ("in: [50 degC]", "in: [25 degC]"),
    ("numbers: 1-6, kind: gyro", "numbers: 1, kind: gyro"),
    ("numbers: 7-10, kind", "numbers: 7, kind"),
    ("in: {channels: 1-6}", "in: {channels: 1}"),
    ("in: {channels: 7-10}", "in: {channels: 7}"),
)
RATE_ppm_d = 20.0


def tiny(folder: Path) -> Plan:
    path = folder / "tiny_zeros.yaml"
    path.write_text(cut("scale_factor_zero_per_range", list(CUTS)))
    return compile_sequence(path, None, {"world.calibrator_gain": "off"})


def test_the_whole_plan_lasts_45_hours_and_a_third() -> None:
    plan = compile_sequence("scale_factor_zero_per_range", None, {})
    assert check_plan(plan) == []
    campaign = plan.phase("campaign")
    assert campaign[-1].at_s + campaign[-1].duration_s == 163_200.0
    assert plan.record_count == 985
    closing = [step for step in campaign if step.kind == "record" and step.conditions["repeat"]]
    assert len(closing) == 15
    zeros = {
        (step.conditions["kind"], step.conditions["range_A"])
        for step in campaign
        if step.kind == "record" and step.conditions["route"] == "closed" and step.conditions["current_A"] == 0
    }
    assert zeros == {("gyro", one) for one in (2.2e-4, 2.2e-3, 2.2e-2, 2.2e-1)} | {
        ("accelerometer", one) for one in (2.2e-3, 2.2e-2)
    }


@pytest.mark.validates(
    "drift of the calibrator from a check by the meter before and after",
    against="a simulated calibrator that rises by 20 ppm a day, read through the instruments",
)
def test_a_drifting_calibrator_is_seen_by_the_meter(
    record_property: Callable[[str, object], None], tmp_path: Path, rehearse: Callable[..., Rehearsal]
) -> None:
    plan = tiny(tmp_path)
    assert check_plan(plan) == []

    def drifting(world: World) -> None:
        world.options["calibrator_drift_ppm"] = RATE_ppm_d

    rehearsal = rehearse(plan, arrange=drifting)
    assert rehearsal.run.outcome.error is None
    assert rehearsal.run.outcome.overruns == 0
    analysis = analyse(material_of(read_view(rehearsal.run.folder)))
    found = [one for one in analysis.estimates if one["quantity"] == "calibrator_drift"]
    checks = [one for one in found if one["conditions"]["check"] == "check by the meter"]
    assert [one["conditions"]["current_A"] for one in checks] == [1e-3, 1e-2, 1e-1]
    for one in checks:
        expected_ppm = RATE_ppm_d * one["conditions"]["hours"] / 24.0
        sys.stdout.write(f"{one['value']:.3f} +- {one['expanded_uncertainty']:.3f} ppm, drawn {expected_ppm:.3f} ppm\n")
        record_property("obtained", f"{one['value']:.3f} of {expected_ppm:.3f} ppm")
        assert expected_ppm > 2.0
        assert one["value"] == pytest.approx(expected_ppm, abs=0.05)
    component = {one["std_uncertainty_ppm"] for one in analysis.components if "drift" in one["component"]}
    assert component == {max(abs(one["value"]) + one["expanded_uncertainty"] for one in checks) / 2}
    assert any("Zeros in every range" in note for note in analysis.notes)
    assert analysis.missing == []
