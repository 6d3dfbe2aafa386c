"""Compensation out: coefficients.json, its schema, the merge of two campaigns, and the header in a real compiler."""

import copy
import dataclasses
import json
import re
import subprocess
from importlib import resources
from pathlib import Path
from typing import Any

import fit_simulation as sim
import jsonschema
import numpy as np
import pytest
from c_program import compile_main
from one_estimate import every

from bench.analysis import Analysis, build_results, results_json
from bench.model.errors import InputError
from bench.session.coefficients import write_coefficients
from bench.systems.af_converter.coefficients import coefficients_of, coefficients_schema, header_text, merged

PROVENANCE = {"simulated": True, "plan_sha256": "a", "frame_sha256": "b", "session_sha256": "c0ffee", "software": "x 1"}
KINDS = {1: "gyro", 3: "accelerometer"}
T_degC = (-10.0, 20.0, 37.3, 50.0)


@pytest.fixture(scope="module")
def campaign() -> sim.SimulatedCampaign:
    return sim.simulate(8, sim.Switches(), KINDS)


@pytest.fixture(scope="module")
def scale_factor(campaign: sim.SimulatedCampaign) -> Analysis:
    return sim.analysed(campaign)


def bias_analysis(**changes: Any) -> Analysis:
    """What a bias campaign hands over, by hand: this is about the form, not about the numbers."""
    entries = [
        {
            "channel": channel,
            "kind": kind,
            "parameter": "bias",
            "unit": "A",
            "reference_temperature_degC": 20.0,
            "coefficients": [4.0e-7 / channel, 2.0123456789012345e-9, -1e-12, 3e-14],
            "valid_degC": [-10.2, 50.1],
        }
        for channel, kind in KINDS.items()
    ]
    clock = {"channel": None, "kind": None, "parameter": "master_clock", "unit": "ppm", "valid_degC": [-10.2, 50.1]}
    entries.append(clock | {"reference_temperature_degC": 20.0, "coefficients": [1.5, -0.01]})
    made = Analysis("bias_ramp", "joint", {"model": "NGU", "serial": "SIM-1"}, [], compensation=entries)
    return dataclasses.replace(made, **changes)


def document(
    analysis: Analysis, campaign: sim.SimulatedCampaign, name: str = "one", **provenance: Any
) -> dict[str, Any]:
    results = build_results(name, analysis, {}, PROVENANCE | provenance)
    return coefficients_of(analysis, results, campaign.campaign)


@pytest.fixture
def both(campaign: sim.SimulatedCampaign, scale_factor: Analysis) -> dict[str, Any]:
    return merged([document(scale_factor, campaign, "sf"), document(bias_analysis(), campaign, "bias")])


def test_scale_factor_campaign_gives_its_coefficients_and_no_bias(
    campaign: sim.SimulatedCampaign, scale_factor: Analysis
) -> None:
    given = {(one["parameter"], one["channel"]): one for one in scale_factor.compensation}
    assert set(given) == {(name, channel) for name in ("dsf_n", "dsf_p") for channel in KINDS}
    assert every(scale_factor, "bias_tc0")
    warmth = [row.context["unit_temperature_degC"] for row in campaign.rows]
    for (name, channel), one in given.items():
        stated = [every(scale_factor, f"{name}_tc{order}", channel=channel)[0] for order in range(3)]
        assert one["coefficients"] == [entry.value for entry in stated]
        assert min(warmth) <= one["valid_degC"][0] < -9.0
        assert 49.0 < one["valid_degC"][1] <= max(warmth)
    wrong = dataclasses.replace(
        scale_factor, compensation=[*scale_factor.compensation, bias_analysis().compensation[0]]
    )
    with pytest.raises(InputError, match=r"B-COEF-004: .*'scale_factor' is diagnostic"):
        document(wrong, campaign)


def test_document_is_valid_by_the_shipped_schema(both: dict[str, Any]) -> None:
    schema = json.loads(resources.files("bench.systems.af_converter").joinpath("coefficients.schema.json").read_text())
    assert schema == coefficients_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(json.loads(results_json(both)), schema)
    assert [one["campaign"] for one in both["sources"]] == ["scale_factor", "bias_ramp"]
    assert [one["session_sha256"] for one in both["sources"]] == ["c0ffee", "c0ffee"]
    names = [one["parameter"] for one in both["parameters"]]
    assert names == ["dsf_n", "dsf_n", "dsf_p", "dsf_p", "bias", "bias", "master_clock"]


def test_sessions_that_do_not_belong_together_are_refused(
    campaign: sim.SimulatedCampaign, scale_factor: Analysis
) -> None:
    ours = document(scale_factor, campaign, "sf")
    stranger = document(bias_analysis(uut={"model": "NGU", "serial": "SIM-2"}), campaign, "bias")
    real = document(bias_analysis(), campaign, "bias", simulated=False)
    other = copy.deepcopy(document(bias_analysis(), campaign, "bias"))
    other["nominal"][0]["k0_C"] *= 2
    clock = [one for one in bias_analysis().compensation if one["channel"] is None]
    clocks = [document(bias_analysis(compensation=clock), campaign, name) for name in ("sf", "b")]
    for first, second, code, says in (
        (ours, stranger, "B-COEF-001", "NGU SIM-1 and NGU SIM-2"),
        (ours, other, "B-COEF-001", "nominal constants"),
        (ours, real, "B-COEF-003", "simulated and measured"),
        (ours, document(scale_factor, campaign, "again"), "B-COEF-002", "dsf_n of channel 1 comes from two sessions"),
        (*clocks, "B-COEF-002", "master_clock of the unit"),
    ):
        with pytest.raises(InputError, match=says) as caught:
            merged([first, second])
        assert caught.value.code == code
        assert "sf" in caught.value.where


def test_campaigns_of_some_channels_only_are_merged(
    tmp_path: Path, campaign: sim.SimulatedCampaign, scale_factor: Analysis
) -> None:
    """A short scale-factor campaign measures some channels, the bias campaign all of them; one alone compiles, too."""
    ours = document(scale_factor, campaign, "sf")
    more = document(bias_analysis(), campaign, "bias")
    more["nominal"].append({"channel": 10, "kind": "accelerometer", "k0_C": 1e-7})
    more["parameters"].append({**more["parameters"][0], "channel": 10, "kind": "accelerometer"})
    both = merged([more, ours])
    assert [one["channel"] for one in both["nominal"]] == [1, 3, 10]
    assert both["nominal"] == merged([ours, more])["nominal"]
    tables = re.findall(r"static const \w+ COMPENSATION_(\w+)\[(\d+)\]", header_text(both))
    assert dict(tables) == {"K0_C": "11", "DSF_N_PPM": "11", "DSF_P_PPM": "11", "BIAS_A": "11"}
    (tmp_path / "coefficients.h").write_text(header_text(merged([ours])))
    (tmp_path / "main.c").write_text('#include "coefficients.h"\nint main(void) { return 0; }\n')
    compile_main(tmp_path, "-fsyntax-only")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"coefficients": [1e-7, float("nan")]}, r"parameters\.1\.coefficients\.1"),
        ({"coefficients": []}, r"parameters\.1\.coefficients"),
        ({"unit": "nA"}, "bias in 'nA', 'A' is due"),
        ({"valid_degC": [50.0, -10.0]}, "valid from 50.0 to -10.0"),
        ({"parameter": "scale"}, r"parameters\.1\.parameter"),
    ],
)
def test_an_entry_that_is_not_in_the_form_is_refused(
    campaign: sim.SimulatedCampaign, change: dict[str, Any], says: str
) -> None:
    entries = bias_analysis().compensation
    entries[1] |= change
    with pytest.raises(InputError, match=says) as caught:
        document(bias_analysis(compensation=entries), campaign)
    assert caught.value.code == "B-COEF-006"


def test_files_of_a_session(tmp_path: Path, campaign: sim.SimulatedCampaign, scale_factor: Analysis) -> None:
    results = build_results("sf", scale_factor, {}, PROVENANCE)
    paths = write_coefficients(tmp_path, scale_factor, results, campaign.campaign)
    assert [path.name for path in paths] == ["coefficients.json", "coefficients.h"]
    assert json.loads(paths[0].read_text())["simulated"] is True
    first = [path.read_bytes() for path in paths]
    write_coefficients(tmp_path, scale_factor, results, campaign.campaign)
    assert [path.read_bytes() for path in paths] == first
    nothing = bias_analysis(compensation=[])
    assert write_coefficients(tmp_path / "none", nothing, results, campaign.campaign) == []
    assert not (tmp_path / "none").exists()


PROGRAM = """
#include <stdio.h>
#include "coefficients.h"
#include "coefficients.h"
int main(void)
{
    const double at[] = { %(temperatures)s };
    size_t k, channel;
    for (k = 0; k < sizeof at / sizeof at[0]; ++k) {
        for (channel = 0; channel < 4; ++channel) {
            double n, p, bias;
            int state = compensation_value(&COMPENSATION_DSF_N_PPM[channel], at[k], &n);
            state += compensation_value(&COMPENSATION_DSF_P_PPM[channel], at[k], &p);
            state += compensation_value(&COMPENSATION_BIAS_A[channel], at[k], &bias);
            printf("%%d %%.17g %%.17g %%.17g %%.17g\\n", state, COMPENSATION_K0_C[channel], n, p, bias);
        }
    }
    {
        double clock;
        int state = compensation_value(&COMPENSATION_MASTER_CLOCK_PPM, 60.0, &clock);
        printf("%%d %%.17g\\n", state, clock);
    }
    return COMPENSATION_SIMULATED;
}
"""


@pytest.mark.validates(
    "coefficients.h compiled as C99 without warnings, its numbers",
    against="numpy's polyval of coefficients.json",
)
def test_header_compiles_and_evaluates_to_the_same_numbers(tmp_path: Path, both: dict[str, Any]) -> None:
    """Every bit of a coefficient is there, no note ends its comment, and what is simulated says so to a program."""
    both["sources"][0]["missing"] = ["channel 3 at 5 degC: no record */ #error"]
    text = header_text(both)
    assert text.isascii()
    assert "#define COMPENSATION_SIMULATED 0" in header_text(both | {"simulated": False})
    for one in both["parameters"]:
        assert ", ".join(repr(value) for value in one["coefficients"]) in text
    (tmp_path / "coefficients.h").write_text(text)
    (tmp_path / "main.c").write_text(PROGRAM % {"temperatures": ", ".join(repr(at) for at in T_degC)})
    compile_main(tmp_path)
    ran = subprocess.run([str(tmp_path / "main")], capture_output=True, text=True, check=False)
    assert ran.returncode == 1
    lines = [line.split() for line in ran.stdout.splitlines()]
    *table, clock = lines
    given = {(one["parameter"], one["channel"]): one for one in both["parameters"]}
    charges = {one["channel"]: one["k0_C"] for one in both["nominal"]}
    for line, (at, channel) in zip(table, [(at, channel) for at in T_degC for channel in range(4)], strict=True):
        numbers = [float(text) for text in line[1:]]
        if channel not in KINDS:
            assert (line[0], numbers) == ("-3", [0.0] * 4)
            continue
        low, high = given["dsf_n", channel]["valid_degC"]
        assert int(line[0]) == (0 if low <= at <= high else 2)
        assert numbers[0] == charges[channel]
        for name, number in zip(("dsf_n", "dsf_p", "bias"), numbers[1:], strict=True):
            expected = np.polynomial.polynomial.polyval(at - 20.0, given[name, channel]["coefficients"])
            assert number == pytest.approx(expected, rel=1e-14)
    assert clock[0] == "1"
    assert float(clock[1]) == pytest.approx(1.5 - 0.01 * 40.0, rel=1e-14)
