"""results.json: form and schema; doubt, assumptions, check standards, predictions beside what was reached."""

import copy
import json
import math
from importlib import resources
from pathlib import Path
from typing import Any

import fit_simulation as sim
import jsonschema
import numpy as np
import plan_sample
import pytest
from scipy import stats

from bench.analysis import (
    NOTED,
    ORDINARY,
    Analysis,
    Common,
    Estimate,
    Evidence,
    EvidenceInterval,
    Material,
    agreements,
    analyse,
    build_results,
    by_foreseen_name,
    compensation_of_unit,
    doubt_lines,
    estimate,
    estimates_of,
    expected_at_end,
    is_sound,
    of_check_standard,
    results_json,
    results_schema,
    sound_compensation,
    stated_value,
    validate_results,
    without_check_standard,
)
from bench.analysis.doubt import FALSE_DOUBT, LEAST_MOVE, base_quantity, stated, weigh
from bench.analysis.estimates import Reason
from bench.model.errors import FitError, InputError
from bench.model.installed import named
from bench.model.systems import analysis_declaration, assumptions_of
from bench.store.contents import contents_of

PROVENANCE = {"simulated": True, "plan_sha256": "a", "frame_sha256": "b", "session_sha256": "c", "software": "1"}

SHIPPED = resources.files("bench.analysis").joinpath("results.schema.json").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    campaign = sim.simulate(30, sim.Switches(), repeat_channel=1)
    analysis = analyse(Material(campaign.rows, campaign.campaign, campaign.standards))
    return build_results("session", analysis, {"records": 165, "frames": 1_650_000, "flagged": 2}, PROVENANCE)


def test_shipped_schema_is_the_one_of_the_declarations_and_accepts_the_document(document: dict[str, Any]) -> None:
    schema = json.loads(SHIPPED)
    assert schema == results_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(json.loads(results_json(document)), schema)


def test_the_independent_validator_refuses_what_ours_refuses(document: dict[str, Any]) -> None:
    schema = json.loads(SHIPPED)
    for place, value in (
        (("estimates", 0, "verdict"), "good"),
        (("estimates", 0, "std_uncertainty"), -1.0),
        (("estimates", 0, "n"), -1),
        (("estimates", 0, "conditions", "channel"), [1]),
        (("schema",), 3),
        (("quality", "records"), "many"),
        (("uut",), {"model": "NGU"}),
    ):
        wrong = copy.deepcopy(document)
        target: Any = wrong
        for key in place[:-1]:
            target = target[key]
        target[place[-1]] = value
        with pytest.raises(InputError) as caught:
            validate_results(wrong)
        assert caught.value.code == "B-FIT-010"
        assert str(place[0]) in caught.value.message
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(wrong, schema)


def test_unknown_key_and_infinite_number_are_refused(document: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="B-FIT-010"):
        validate_results(document | {"extra": 1})
    wrong = copy.deepcopy(document)
    wrong["estimates"][3]["value"] = float("nan")
    with pytest.raises(InputError, match=r"B-FIT-010: .*estimates\.3\.value"):
        validate_results(wrong)


def test_text_is_canonical_and_keeps_every_bit(document: dict[str, Any]) -> None:
    text = results_json(document)
    assert json.loads(text) == document
    assert results_json(dict(reversed(list(document.items())))) == text
    assert text.endswith("}\n")


def test_analysis_by_name() -> None:
    assert named(analysis_declaration("scale_factor").module).METHODS == ("gls", "paper", "ols")
    with pytest.raises(FitError, match=r"B-FIT-011: .*unknown analysis 'scale_facto'.*Next: .*scale_factor"):
        analyse(Material([], {"analysis": "scale_facto"}, {}))


def test_equations_without_a_solution_are_an_error_of_the_records(monkeypatch: pytest.MonkeyPatch) -> None:
    def singular(material: Material, method: str) -> Any:
        return np.linalg.inv(np.zeros((2, 2)))

    monkeypatch.setattr(named(analysis_declaration("scale_factor").module), "analyse", singular)
    with pytest.raises(FitError, match=r"B-FIT-143: scale_factor: .*no solution.*Next: ") as caught:
        analyse(Material([], {"analysis": "scale_factor"}, {}))
    assert caught.value.exit_status == 2


PROVENANCE_D = {"simulated": True, "plan_sha256": "", "frame_sha256": "", "session_sha256": "", "software": "test"}
PLACE = {"channel": 1, "temperature_degC": 20.0}


def seen(probability: float, move: float = 1.0, **more: Any) -> Evidence:
    return Evidence("lack_of_fit", "The levels do not lie on a line.", 3.0, probability, move, **more)


def doubted(quantity: str = "dsf_n", **conditions: Any) -> Any:
    return estimate(quantity, "ppm", 400.0, 10.0, PLACE | conditions, n=14, limit=500.0, dof=12.0)


def test_the_level_is_shared_by_all_checks_and_what_moves_no_number_is_a_note() -> None:
    just_beyond = FALSE_DOUBT / 10 * 0.999
    few = [seen(just_beyond), *(seen(0.5) for _ in range(9))]
    assert [one.probability for one in weigh(few).against] == [just_beyond]
    assert weigh([*few, seen(0.5)]).against == []
    certain = seen(0.0, move=float("inf"))
    assert weigh([*few, certain]).against == [few[0], certain]  # what is not by chance takes no share
    weighed = weigh([seen(0.0, move=LEAST_MOVE), seen(0.0, move=LEAST_MOVE * 1.01)])
    assert [one.move for one in weighed.noted] == [LEAST_MOVE]
    assert [one.move for one in weighed.against] == [LEAST_MOVE * 1.01]


@pytest.mark.parametrize(
    ("quantities", "conditions", "borne"),
    [
        ((), {}, True),
        (("dsf_n",), PLACE, True),
        (("dsf_p",), PLACE, False),
        (("dsf_n",), {"channel": 2}, False),
        (("dsf_n",), {"repeat": 1}, True),  # the estimate says nothing of a repeat
    ],
)
def test_what_evidence_bears_on(quantities: tuple[str, ...], conditions: dict[str, Any], borne: bool) -> None:
    assert seen(0.0, quantities=quantities, conditions=conditions).bears_on(doubted()) is borne


@pytest.mark.parametrize("name", ["dsf_n", "dsf_n_tc0", "dsf_n_tc2", "dsf_n_residual", "dsf_n_change", "dsf_n_drift"])
def test_a_coefficient_belongs_to_its_quantity(name: str) -> None:
    assert base_quantity(name) == "dsf_n"
    assert seen(0.0, quantities=("dsf_n",)).bears_on(doubted(name))


def test_a_doubtful_estimate_keeps_its_value_and_claims_nothing() -> None:
    interval = EvidenceInterval(low=390.0, high=420.0, basis="leaving out one level")
    entry = stated(doubted(), [seen(0.0, interval=interval)])
    document = entry.document
    assert document["value"] == 400.0
    for name in ("std_uncertainty", "coverage_factor", "expanded_uncertainty", "dof", "conformance_probability"):
        assert document[name] is None
    assert (document["verdict"], document["quality"]) == ("indeterminate", "doubtful")
    assert document["reasons"] == [{"code": "lack_of_fit", "sentence": seen(0.0).sentence, "figure": 3.0}]
    assert document["evidence_interval"] == {"low": 390.0, "high": 420.0, "basis": "leaving out one level"}
    assert stated_value(entry) == "400 (doubtful)"
    assert not is_sound(entry)


def test_a_refused_estimate_has_no_value() -> None:
    document = stated(doubted(), [seen(0.0), seen(0.0, refuses=True)])
    assert (document.value, document.quality, len(document.reasons)) == (None, "refused", 2)
    assert stated_value(document) == "refused"


def results(*evidence: Evidence, incomplete: bool = False) -> dict[str, Any]:
    entries = [doubted(), doubted(channel=2), doubted("dsf_n_tc1")]
    unit = {"model": "NGU", "serial": "1"}
    parameters = [{"channel": channel, "kind": "gyro", "parameter": "dsf_n"} for channel in (1, 2)]
    analysis = Analysis("scale_factor", "gls", unit, entries, evidence=list(evidence), compensation=parameters)
    document = build_results("session", analysis, {}, PROVENANCE_D, incomplete=incomplete)
    document["kept"] = [part["channel"] for part in sound_compensation(analysis, document).compensation]
    document["missing"] = sound_compensation(analysis, document).missing
    return document


def test_results_state_what_the_evidence_leaves() -> None:
    document = results(seen(0.0, quantities=("dsf_n",), conditions=PLACE), seen(0.4))
    assert document["schema"] == 2
    assert [one["quality"] for one in document["estimates"]] == ["doubtful", "sound", "doubtful"]
    assert [one["verdict"] for one in document["estimates"]] == ["indeterminate", "pass", "indeterminate"]
    assert document["kept"] == [2]
    assert document["missing"] == ["channel 1: no coefficients of dsf_n, doubtful: The levels do not lie on a line."]
    assert doubt_lines(estimates_of(document)) == [
        "DOUBTFUL, 2 estimates of dsf_n: The levels do not lie on a line. [lack_of_fit]"
    ]


@pytest.mark.parametrize(
    ("codes", "lines"),
    [("departs departs", ["1 estimate of dsf_n: a [departs]", "1 estimate of dsf_n: b [departs]"]),
     ("departs departs depart_together", [
         "1 estimate of dsf_n: a 1 more thing departs in the same rows. [departs]",
         "1 estimate of dsf_n: c [depart_together]"])],
)  # fmt: skip
def test_what_rests_on_the_same_rows_is_one_line(codes: str, lines: list[str]) -> None:
    told = zip(codes.split(), "abc", strict=False)
    reasons = [Reason(code=code, sentence=text, figure=1.0) for code, text in told]
    entry = doubted().model_copy(update={"quality": "doubtful", "reasons": reasons})
    assert doubt_lines([entry]) == [f"DOUBTFUL, {line}" for line in lines]


def test_what_is_only_noted_stands_in_the_notes() -> None:
    document = results(seen(0.0, move=0.1))
    assert all(is_sound(one) for one in estimates_of(document))
    assert document["notes"] == [seen(0.0).sentence]
    assert document["kept"] == [1, 2]
    assert doubt_lines(estimates_of(document)) == []


@pytest.mark.parametrize(
    ("quality", "change"),
    [
        ("sound", {"expanded_uncertainty": None}),
        ("sound", {"reasons": [{"code": "a", "sentence": "b", "figure": None}]}),
        ("doubtful", {"reasons": []}),
        ("doubtful", {"expanded_uncertainty": 1.0}),
        ("refused", {"value": 1.0}),
        ("doubtful", {"value": None}),
    ],
)
def test_a_document_that_claims_what_its_quality_denies_is_refused(quality: str, change: dict[str, Any]) -> None:
    document = results(*([] if quality == "sound" else [seen(0.0, refuses=quality == "refused")]))
    document = {name: value for name, value in document.items() if name not in ("kept", "missing")}
    validate_results(document)
    document["estimates"][0] |= change
    with pytest.raises(InputError, match=quality):
        validate_results(document)


def test_a_campaign_that_only_records_takes_nothing_for_granted() -> None:
    assert assumptions_of({}) == assumptions_of({"analysis": "none"}) == []


CAMPAIGN = {"analysis": "scale_factor", "check_standard": {"model": "CS-1", "serial": "0042", "channel": 8}}
ROOT = Path(__file__).resolve().parents[3]


def check_entry(channel: int) -> dict[str, Any]:
    return {
        "quantity": "dsf_n", "unit": "ppm", "conditions": {"channel": channel}, "value": 1.0 * channel,
        "std_uncertainty": 0.1, "coverage_factor": 2.0, "expanded_uncertainty": 0.2, "n": 3, "dropped": 0,
        "limit": None, "verdict": "none", "quality": "sound", "reasons": [],
    }  # fmt: skip


def checked() -> dict[str, Any]:
    provenance = {
        "simulated": True, "plan_sha256": "p", "frame_sha256": "f", "session_sha256": "5ea1", "software": "s",
    }  # fmt: skip
    return {
        "session": "20260401T080000Z_short_SIM-1", "campaign": "scale_factor", "method": "gls", "notes": [],
        "uut": {"model": "NGU", "serial": "SIM-1"}, "estimates": [check_entry(channel) for channel in (1, 8, 2)],
        "quality": {}, "provenance": provenance,
    }  # fmt: skip


def test_the_history_keeps_it_as_a_unit_of_its_own() -> None:
    unit, check = contents_of(checked(), {"campaign": CAMPAIGN}, None)
    named = [(one.calibration["uut_model"], one.calibration["uut_serial"]) for one in (unit, check)]
    assert named == [("NGU", "SIM-1"), ("CS-1", "0042")]
    assert [len(one.estimates) for one in (unit, check)] == [2, 1]
    assert check.estimates[0]["value"] == 8.0
    assert check.calibration["session"] == "20260401T080000Z_short_SIM-1:0042"
    assert check.calibration["session_sha256"] != unit.calibration["session_sha256"]


def test_a_check_standard_is_in_nothing_that_is_said_of_the_unit() -> None:
    parts = [{"channel": 1}, {"channel": 8}, {"channel": None}]
    analysis = Analysis("scale_factor", "gls", {}, [], compensation=parts)
    of_unit, campaign = compensation_of_unit(analysis, {**CAMPAIGN, "channels": [{"number": 1}, {"number": 8}]})
    assert of_unit.compensation == [{"channel": 1}, {"channel": None}]
    assert campaign["channels"] == [{"number": 1}]
    kept = without_check_standard(checked(), CAMPAIGN)["estimates"]
    assert [one["conditions"]["channel"] for one in kept] == [1, 2]
    plain = checked()
    analysis = Analysis("scale_factor", "gls", {}, [], compensation=[{"channel": 8}])
    assert compensation_of_unit(analysis, {})[0] is analysis
    assert without_check_standard(plain, {}) is plain
    assert of_check_standard(plain, {}) is None


@pytest.mark.parametrize(("channel", "found"), [(2, []), (9, ["B-PLAN-099"])])
def test_it_stands_on_a_channel_that_is_measured_b_plan_099(tmp_path: Path, channel: int, found: list[str]) -> None:
    text = (ROOT / "sequences" / "scale_factor_short.yaml").read_text()
    path = tmp_path / "scale_factor_short.yaml"
    path.write_text(f"check_standard: {{model: CS-1, serial: '0042', channel: {channel}}}\n{text}")
    assert [one.code for one in plan_sample.mistakes(path)] == found


def foreseen(
    U: float | None, *, grown: dict[str, float] | None = None, quantity: str = "dsf_n", **conditions: Any
) -> Estimate:
    entry = estimate(quantity, "ppm", 0.0, 1.0 if U is None else U / 2.0, conditions, n=1, factor=2.0)
    more = {} if grown is None else {"common": Common(standards={"gain": 3.0}, campaign=grown)}
    return entry.model_copy(update=more if U is not None else {"std_uncertainty": None, "expanded_uncertainty": None})


def test_estimates_are_held_against_their_own_predictions() -> None:
    planned = foreseen(1.0, channel=1, temperature_degC=50.0, unit_temperature_degC=50.0, hours=38.0)
    measured = foreseen(1.0, channel=1, temperature_degC=50.0, unit_temperature_degC=49.61, hours=38.002)
    others = [foreseen(1.0, channel=2, temperature_degC=50.0), planned.model_copy(update={"quantity": "dsf_p"})]
    assert list(by_foreseen_name([planned])) == list(by_foreseen_name([measured]))
    assert len(by_foreseen_name([planned, *others])) == 3
    before = [foreseen(1.0, channel=7, hours=8.0), foreseen(2.0, channel=7, hours=22.0)]
    after = [foreseen(3.0, channel=7, hours=7.99), foreseen(2.0, channel=7, hours=22.1)]
    assert [pair.ratio for pair in agreements(before, after)] == [3.0, 1.0]


def test_the_ratio_and_the_error_that_has_grown() -> None:
    before = [foreseen(2.0, grown={"drift": 0.5}, channel=channel) for channel in (1, 2, 3)]
    sensor = foreseen(2.0 * math.sqrt(1.0 + 0.9**2), grown={"drift": 0.5, "sensor": -0.9}, channel=1)
    many = foreseen(4.0, grown={"drift": 0.5, "sensor": 1.0}, channel=2)  # the variance grew by 3, the sensor brings 1
    found = agreements(before, [foreseen(2.0, grown={"drift": 0.5}, channel=3), many, sensor])
    assert [pair.ratio for pair in found] == pytest.approx([math.sqrt(1.81), 2.0, 1.0])
    assert [pair.grown for pair in found] == ["sensor", "", ""]
    assert [pair.is_noted for pair in found] == [True, True, False]


def test_what_is_not_known_on_both_sides_is_left_out() -> None:
    before = [foreseen(2.0, channel=1), foreseen(2.0, channel=2), foreseen(0.0, channel=3), foreseen(2.0, channel=4)]
    after = [foreseen(None, channel=1), foreseen(1.0, channel=3), foreseen(1.0, channel=4), foreseen(1.0, channel=5)]
    (pair,) = agreements(before, after)
    assert pair.predicted.conditions == {"channel": 4}
    assert pair.is_noted, "less than the least is as odd as more"
    assert agreements([foreseen(1.0)], [foreseen(1.0 + 0.99 * NOTED)])[0].is_noted is False


@pytest.mark.parametrize("dof", [5.0, 30.0, 1e5, math.inf])
def test_the_bounds_are_those_of_chi_square_and_never_nearer_than_ten_per_cent(dof: float) -> None:
    both = [(1.0 - ORDINARY) / 2.0, (1.0 + ORDINARY) / 2.0]
    low, high = np.sqrt(stats.chi2.ppf(both, dof) / dof) if dof < 1e5 else (1.0 - NOTED, 1.0 + NOTED)
    stated = {} if math.isinf(dof) else {"dof": dof}
    for ratio, noted in ((low - 1e-6, True), (low + 1e-6, False), (high - 1e-6, False), (high + 1e-6, True)):
        assert agreements([foreseen(1.0)], [foreseen(ratio).model_copy(update=stated)])[0].is_noted is noted


@pytest.mark.parametrize("factor", [0.5, 1.0, 3.0])
def test_noise_that_is_not_the_declared_one_stays_so(factor: float) -> None:
    """The mean of 4 records of 16: so far s / 2, at the end s / 4."""
    s = 8.0
    assert expected_at_end(factor * s / 2, s / 2, s / 4) == pytest.approx(factor * s / 4)


def test_variances_add_up_to_what_a_run_will_come_to() -> None:
    random, unit, drift = 3.0, 4.0, 12.0
    at_end = expected_at_end(math.hypot(random, unit), random, math.hypot(random, drift))
    assert at_end == pytest.approx(13.0)  # 3, 4, 12: their squares add up to that of 13
    for so_far in (0.9, 1.0, 7.0):
        assert expected_at_end(so_far, 1.0, 1.0) == pytest.approx(so_far)
