"""What the analysis of a north finder refuses, each with one clear error."""

from __future__ import annotations

from dataclasses import replace

import pytest
from fog_material import AZIMUTH_DEG, NorthRig, campaign

from bench.model.errors import FitError
from bench.systems.north.analysis import analyse
from bench.systems.north.declaration import DECLARATION
from bench.systems.north.limits import AZIMUTH_ERROR

SEED = 703


@pytest.fixture
def rig() -> NorthRig:
    return campaign(NorthRig(SEED), (0.0,), 1)


def refused(code: str, rig: NorthRig, method: str = "least_squares", **more: object) -> FitError:
    with pytest.raises(FitError) as caught:
        analyse(rig.material(**more), method)
    assert caught.value.code == code
    assert caught.value.next_step
    return caught.value


def test_an_unknown_method(rig: NorthRig) -> None:
    refused("B-FIT-004", rig, "guess")


@pytest.mark.parametrize(
    "limits",
    [
        {"roll_error": {"value": 1.0, "unit": "deg"}},
        {"azimuth_error": {"value": 1.0, "unit": "m"}},
        {"azimuth_error": {}},
        {"azimuth_error": {"value": 0.0, "unit": "deg"}},
    ],
)
def test_a_limit_that_is_none_of_a_north_finder(rig: NorthRig, limits: dict[str, object]) -> None:
    assert next(iter(limits)) in refused("B-FOG-001", rig, limits=limits).message


def test_the_limits_are_those_the_check_of_a_sequence_knows() -> None:
    (declared,) = DECLARATION.analyses
    assert {name: limit.dimension for name, limit in declared.limits.items()} == {AZIMUTH_ERROR: "deg"}


def test_no_reading_of_a_lock_in(rig: NorthRig) -> None:
    rig.readings = [one for one in rig.readings if one.role == "level"]
    refused("B-FOG-002", rig)


def test_readings_that_belong_to_no_item() -> None:
    rig = NorthRig(SEED)
    rig.set("warm_up", AZIMUTH_DEG)
    refused("B-FOG-002", rig)


@pytest.mark.parametrize("site", [{}, {"latitude_deg": 37.0}, {"azimuth_deg": 20.0}])
def test_a_site_that_is_not_stated(rig: NorthRig, site: dict[str, float]) -> None:
    refused("B-FOG-003", rig, site=site)


def test_no_set_that_can_be_used() -> None:
    rig = NorthRig(SEED)
    rig.set("test", AZIMUTH_DEG, overload=True)
    rig.rows = [replace(row, samples=None) for row in rig.rows]
    assert "overload" in refused("B-FOG-004", rig).message


def test_a_rate_that_nobody_states() -> None:
    rig = NorthRig(SEED)
    rig.set("test", AZIMUTH_DEG)
    for row in rig.rows:
        del row.window.conditions["rate_deg_s"]
    assert "which sense" in refused("B-FOG-005", rig).message


def test_likelihood_without_samples(rig: NorthRig) -> None:
    rig.rows = [replace(row, samples=None) for row in rig.rows]
    analysis = analyse(rig.material())
    assert any("No raw samples" in note for note in analysis.notes)
    assert [one["value"] for one in analysis.estimates if one["quantity"] == "azimuth_error"] == [
        pytest.approx(0.0, abs=1e-3)
    ]
    assert not {"Earth signal", "Residual of the waveform", "Errors over time"} <= {
        one.title for one in analysis.figures
    }
    assert "no samples" in refused("B-FOG-005", rig, "likelihood").message


def test_samples_without_lock_ins_are_north_by_likelihood_alone(rig: NorthRig) -> None:
    for one in rig.readings:
        if one.role == "lock_in_1":
            one.value["overload"] = True
    assert "overload" in refused("B-FOG-005", rig).message
    assert analyse(rig.material(), "likelihood").missing
