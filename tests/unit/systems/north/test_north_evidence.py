"""What is left out of a north finder's data and named, and each check just below and just above what it looks for."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import doubt_north as worlds
import numpy as np
import pytest
from fog_material import AZIMUTH_DEG, Gyro, NorthRig, campaign

from bench.analysis import Evidence, build_results
from bench.maths.tests import best_step
from bench.model.errors import FitError
from bench.systems.north.analysis import analyse
from bench.systems.north.assumptions import assumptions
from bench.systems.north.evidence import f_test, t_test

SEED = 1811
PROVENANCE = {"simulated": True, "plan_sha256": "a", "frame_sha256": "b", "session_sha256": "c", "software": "x 1"}


@pytest.fixture(autouse=True)
def without_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of the time of an analysis is that of its figures."""
    for name in ("signal_figures", "error_figures"):
        monkeypatch.setattr(f"bench.systems.north.analysis.{name}", lambda *_: [])


def heard(material: Any, code: str) -> list[Evidence]:
    return [seen for seen in analyse(material).evidence if seen.code == code]


def material_of(world: worlds.World, seed: int = SEED) -> Any:
    return worlds._material(seed, world, 1.0)


@pytest.mark.parametrize(
    ("world", "code", "small", "large"),
    [
        (worlds.OncePerTurn, "once_per_turn", 1e-3, 3e-2),
        (worlds.Modulated, "twice_per_turn", 1e-3, 6e-2),
        (worlds.FieldMotor, "amplitude_at_place", 1e-3, 6e-2),
        (worlds.MarkWrong, "all_azimuths_off", 0.02, 2.0),
        (worlds.EncoderSlips, "methods_apart", 0.05, 4.0),
        (worlds.DelayAfterMove, "methods_step", 1e-3, 4.0),
        (worlds.BenchTurns, "north_drifts", 0.1, 6.0),
        (worlds.BenchKnocked, "north_steps", 0.1, 4.0),
        (worlds.Restless, "repeats_apart", 0.05, 2.0),
        (worlds.BenchKnocked, "known_azimuths_apart", 0.1, 4.0),
        (worlds.NoisyField, "noise_changes", 0.01, 1.0),
    ],
)
def test_a_check_finds_what_is_large_and_nothing_where_it_is_small(
    world: type[worlds.World], code: str, small: float, large: float
) -> None:
    assert min(seen.probability for seen in heard(material_of(world(small)), code)) > 1e-3
    found = min(heard(material_of(world(large)), code), key=lambda seen: seen.probability)
    assert found.probability < 1e-5
    assert found.move > 0.3


def refused_for(rig: NorthRig, code: str) -> set[str]:
    """Return the methods whose azimuth is refused for this reason in results.json."""
    document = build_results("one", analyse(rig.material(), "likelihood"), {}, PROVENANCE)
    return {
        entry["conditions"]["method"]
        for entry in document["estimates"]
        if entry["quality"] == "refused" and code in {reason["code"] for reason in entry["reasons"]}
    }


@pytest.mark.parametrize("rate_deg_s", [-360.0, 330.0])
def test_a_rate_or_sense_that_is_stated_wrong_leaves_nothing_of_the_lock_ins(rate_deg_s: float) -> None:
    """Lock-ins that tell no frequency are held against the encoder."""
    rig = campaign(NorthRig(SEED, Gyro(noise_V=0.01)), (0.0, 90.0), 1)
    for row in rig.rows:
        row.window.conditions["rate_deg_s"] = rate_deg_s
    with pytest.raises(FitError, match=r"B-FIT-111|the table turns at"):
        analyse(rig.material(), "least_squares")
    if rate_deg_s > 0.0:
        material = rig.material()
        for reading in material.readings:
            reading.value.pop("frequency_Hz", None)
        document = build_results("one", analyse(material, "least_squares"), {}, PROVENANCE)
        entry = next(
            one for one in document["estimates"]
            if (one["quantity"], one["conditions"].get("method")) == ("azimuth_error", "least_squares")
        )  # fmt: skip
        assert (entry["quality"], [one["code"] for one in entry["reasons"]]) == ("doubtful", ["rate_not_as_stated"])


def test_a_signal_that_drowns_is_refused() -> None:
    assert "likelihood" in refused_for(campaign(NorthRig(SEED, Gyro(noise_V=100.0)), (0.0, 90.0), 1), "no_signal")
    assert refused_for(campaign(NorthRig(SEED, Gyro(noise_V=2.0)), (0.0, 90.0), 1), "no_signal") == set()


def test_one_bad_reading_costs_its_set_and_is_named_as_a_lock_in_that_stands_still() -> None:
    bad = analyse(material_of(worlds.OneBadReading(0.1)))
    (sentence,) = bad.missing
    assert "test at head 90 deg, repeat 1: lock_in_1 reads" in sentence
    (entry,) = (
        one for one in bad.estimates if one["quantity"] == "azimuth_error" and one["conditions"]["head_deg"] == 90.0
    )
    assert (entry["n"], entry["dropped"]) == (1, 1)
    assert analyse(material_of(worlds.OneBadReading(1e-3))).missing == []
    rig = campaign(NorthRig(SEED, Gyro(noise_V=0.01)), (0.0, 90.0), 1)
    stuck = [k for k, one in enumerate(rig.readings) if one.role == "lock_in_2"][4:8]
    for k in stuck[1:]:
        rig.readings[k] = replace(rig.readings[k], value=rig.readings[stuck[0]].value)
    (sentence,) = analyse(rig.material()).missing
    assert "lock_in_2 handed over the same value three times in a row" in sentence


def test_one_far_sample_is_left_out_and_named_without_a_loss() -> None:
    spiked, right = (analyse(material_of(worlds.Spike(size))) for size in (100.0, 0.0))
    assert any("1 of 3000 samples are unlike all others" in note for note in spiked.notes)
    assert spiked.missing == []
    values = [[one["value"] for one in each.estimates if one["quantity"] == "azimuth"] for each in (spiked, right)]
    np.testing.assert_allclose(*values, atol=0.02)


@pytest.mark.parametrize(
    ("world", "said"),
    [(worlds.Frozen(0.1), "output stands still for 76 samples"), (worlds.Clipped(0.9), "samples are pinned at 1.1 V")],
)
def test_a_waveform_that_stands_still_or_is_pinned_is_left_out(world: worlds.World, said: str) -> None:
    analysis = analyse(material_of(world))
    assert any(said in sentence for sentence in analysis.missing)
    assert not any(one["conditions"].get("source") == "waveform" for one in analysis.estimates)


def test_probabilities_are_those_of_the_tables() -> None:
    assert f_test(2.0 * 2.98, 2, 1.0, 10.0)[1] == pytest.approx(0.0965, abs=2e-3)  # F(2, 10) = 2.98
    assert f_test(3.84, 1, 1.0, np.inf)[1] == pytest.approx(0.05, abs=1e-3)
    assert t_test(-2.228, 1.0, 10.0)[1] == pytest.approx(0.05, abs=1e-3)
    step, gain, where = best_step(np.array([0.0, 0.0, 3.0, 3.0]), np.full(4, 2.0))
    assert (step, where) == (3.0, 2)
    assert gain == pytest.approx(2.0 * 9.0)


def test_assumptions_say_their_sizes_in_this_campaign() -> None:
    site = {"latitude_deg": 37.0, "azimuth_deg": AZIMUTH_DEG, "azimuth_std_deg": 0.02}
    texts = {one.code: one for one in assumptions({"site": site})}
    assert "0.12 deg/h" in texts["magnetic_effect"].unseen  # 1 % of 15.041 cos 37 deg
    assert "0.02 deg" in texts["azimuth_of_mark"].taken_for_granted
    assert "0.0432 deg" in texts["latitude"].effect  # 1 mrad times tan 37 deg
