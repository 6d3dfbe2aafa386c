"""The certificate: by the facts of the schema, every estimate to the last digit, a specimen marked; laboratory."""

import os
import re
import socket
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from datetime import date
from decimal import Decimal
from pathlib import Path
from typing import Any, NoReturn
from xml.etree import ElementTree as ET

import pytest
from dcc_checker import problems, xsd
from dcc_facts import DSI_PREFIXES, DSI_UNITS, PATTERNS
from dcc_sample import EXAMPLE, NS, calibration, estimate, expected, judged, many_estimates, read_certificate, standard
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from bench.model.errors import InputError
from bench.report.dcc import Calibration, CertificateSchema, certificate_text, nobody, not_valid, overdue, session_of
from bench.report.dcc.dsi import condition_unit, estimate_unit, si_number, si_unit
from bench.report.laboratory import load_laboratory

TOKENS = {
    "ppm": r"\one", "A": r"\ampere", "ppm/degC": r"\kelvin\tothe{-1}", "A/degC2": r"\ampere\kelvin\tothe{-2}",
    "degC": r"\kelvin", "min": r"\minute", "A*s^0.5": r"\ampere\second\tothe{0.5}",
    "A/h^0.5": r"\ampere\hour\tothe{-0.5}",
}  # fmt: skip


def xml_of(made: Calibration) -> bytes:
    return certificate_text(made).encode()


def texts_of(xml: bytes, path: str) -> list[str]:
    return [one.text or "" for one in ET.fromstring(xml).iterfind(path, NS)]


@pytest.mark.parametrize("more", [{}, {"specimen": True}, {"specimen": True, "simulated": True, "issued": None}])
def test_it_holds_the_facts_of_the_schema(more: dict[str, object]) -> None:
    assert problems(xml_of(calibration(**more))) == []


def test_it_holds_them_with_next_to_nothing_known() -> None:
    bare = calibration(
        specimen=True, simulated=True, laboratory=nobody(), chamber=None, unit=None, issued=None,
        hashes={"session": "5" * 64, "results": "a" * 64}, estimates=[estimate("any", "A", 1.0, 2.0, conditions={})],
    )  # fmt: skip
    bare = replace(bare, manifest={}, results={**bare.results, "campaign": "any", "notes": [], "decision_rule": None})
    assert problems(xml_of(bare)) == []


def test_every_estimate_is_read_back_to_the_last_digit() -> None:
    wanted = Counter(expected(one, TOKENS[one["unit"]]) for one in many_estimates())
    assert len(wanted) > 30
    assert Counter(read_certificate(xml_of(calibration()))) == wanted


def test_a_small_sample_says_its_distribution_and_dof_and_a_value_with_a_law_of_its_own_no_other_one() -> None:
    k = float(stats.t.ppf(0.975, 3.7))
    xml = xml_of(calibration(estimates=[estimate("few", "A", 1e-9, 2e-9, dof=3.7, coverage_factor=k)]))
    assert texts_of(xml, ".//si:distributionXMLList") == ["student-t"]
    assert texts_of(xml, ".//dcc:quantity[@refType='bench_dof']//si:valueXMLList") == ["3.7"]
    xml = xml_of(calibration(estimates=[estimate("time", "s", 14.0, 4.9, dof=20.0, coverage_factor=2.66)]))
    assert texts_of(xml, ".//si:distributionXMLList") == []
    assert texts_of(xml, ".//si:coverageFactorXMLList") == ["2.66"]


def test_what_cannot_be_given_is_left_out_and_named() -> None:
    rows = [estimate("kept", "A", 1.0, 2.0), estimate("small_k", "A", 1.0, 2.0, coverage_factor=0.5)]
    xml = xml_of(calibration(estimates=rows))
    assert [one.quantity for one in read_certificate(xml)] == ["kept"]
    (statement,) = texts_of(xml, ".//dcc:statement[@refType='bench_leftOut']/dcc:declaration/dcc:content")
    assert "1 small_k" in statement
    assert problems(xml) == []


def test_what_is_not_sound_is_counted_with_its_reason_and_the_whole_is_not_judged_without_it() -> None:
    reason = {"code": "lack_of_fit", "sentence": "The levels do not lie on a line.", "figure": 3.0}
    doubtful = judged(2.0, "indeterminate") | {
        **dict.fromkeys(("std_uncertainty", "coverage_factor", "expanded_uncertainty", "conformance_probability")),
        "quality": "doubtful", "reasons": [reason],
        "acceptance": {"by": "A. Meyer", "reason": "known"},
    }  # fmt: skip
    xml = xml_of(calibration(estimates=[judged(1.0, "pass"), doubtful, doubtful]))
    (statement,) = texts_of(xml, ".//dcc:statement[@refType='bench_notSound']/dcc:declaration/dcc:content")
    assert "2 doubtful" in statement
    assert "The levels do not lie on a line." in statement
    assert texts_of(xml, ".//dcc:statement[@refType='bench_leftOut']/dcc:declaration/dcc:content") == []
    said = texts_of(xml, ".//dcc:statement[@refType='basic_conformity']/dcc:declaration/dcc:content")
    assert "does not hold for the item as a whole" in said[0]
    assert texts_of(xml, ".//dcc:conformityXMLList") == ["pass"]
    assert problems(xml) == []


def test_verdicts_have_their_rule_their_limits_and_the_worst_one_for_the_whole() -> None:
    xml = xml_of(calibration(estimates=[judged(1.0, "pass"), judged(99.0, "conditional_pass")]))
    assert texts_of(xml, ".//dcc:statement[@refType='basic_conformity']/dcc:conformity") == ["conditionalPass"]
    assert texts_of(xml, ".//dcc:conformityXMLList") == ["pass conditionalPass"]
    (rule,) = texts_of(xml, ".//dcc:statement[@refType='bench_decisionRule']/dcc:declaration/dcc:content")
    assert "non-binary" in rule


def test_a_specimen_is_marked_everywhere_and_called_simulated_only_if_it_is() -> None:
    xml = xml_of(calibration(specimen=True, simulated=True))
    mark = "SPECIMEN - simulated, not a calibration"
    assert texts_of(xml, ".//dcc:uniqueIdentifier")[0].startswith("SPECIMEN-EX-")
    names = texts_of(xml, ".//dcc:result/dcc:name/dcc:content")
    names += texts_of(xml, ".//dcc:measurementResult/dcc:name/dcc:content") + texts_of(
        xml, ".//dcc:item/dcc:name/dcc:content")  # fmt: skip
    assert len(names) > 10
    assert all(name.startswith(mark) for name in names)
    first = texts_of(xml, ".//dcc:statement/dcc:declaration/dcc:content")[0]
    assert "Nothing was measured" in first
    assert set(texts_of(xml, ".//dcc:certificate/dcc:traceable")) == {"false"}
    xml = xml_of(calibration(specimen=True))
    assert b"SPECIMEN - not a calibration certificate" in xml
    assert b"simulated" not in xml


def test_the_session_it_belongs_to_is_told() -> None:
    made = calibration(specimen=True)
    found = session_of(xml_of(made))
    assert found.hashes == {"session": "5" * 64, "results": "a" * 64, "report": "b" * 64}
    assert (found.session, found.specimen) == (made.results["session"], True)
    assert found.unique_identifier == "SPECIMEN-EX-20260101T180000Z_scale_factor_38h_17"
    plain = session_of(xml_of(calibration(hashes={"session": "1", "results": "2"})))
    assert (plain.hashes, plain.specimen) == ({"session": "1", "results": "2"}, False)


@pytest.mark.parametrize("xml", [b"", b"no xml", b"<html/>", b"<!DOCTYPE a [<!ENTITY b 'c'>]><a>&b;</a>"])
def test_another_document_is_no_certificate(xml: bytes) -> None:
    with pytest.raises(InputError, match="B-DCC-011: "):
        session_of(xml)


def test_the_standards_with_their_certificates_and_dates() -> None:
    xml = xml_of(calibration())
    one = ".//dcc:measuringEquipment[@id='equipment_calibrator']"
    assert texts_of(xml, f"{one}/dcc:model") == ["5720A"]
    assert texts_of(xml, f"{one}//dcc:identification/dcc:value") == ["12"]
    assert texts_of(xml, f"{one}/dcc:certificate/dcc:referralID") == ["C-1"]
    assert texts_of(xml, f"{one}/dcc:certificate/dcc:inValidityRange") == ["true"]
    assert texts_of(xml, f"{one}/dcc:description/dcc:content") == ["calibrated 2025-11-01, due 2026-11-01"]
    assert texts_of(xml, f"{one}/dcc:manufacturer/dcc:name/dcc:content") == ["FLUKE"]


@pytest.mark.parametrize(
    ("began", "ended", "late"),
    [
        (date(2025, 11, 1), date(2026, 11, 1), False),
        (date(2025, 10, 31), date(2026, 1, 1), True),
        (date(2026, 10, 31), date(2026, 11, 2), True),
    ],
)
def test_a_standard_must_be_valid_from_the_first_day_to_the_last(began: date, ended: date, late: bool) -> None:
    found = overdue({"calibrator": standard()}, began, ended)
    assert bool(found) is late
    assert not late or "calibrator (5720A, 12): calibrated 2025-11-01, due 2026-11-01" in found


def test_a_register_that_says_little_is_never_valid() -> None:
    made = calibration(specimen=True)
    made = replace(made, manifest={"standards": {"meter": {"model": "M"}}})
    assert overdue(made.manifest["standards"], made.began, made.ended) == [
        "meter (M, unknown): calibrated unknown, due unknown"
    ]
    assert problems(xml_of(made)) == []


def test_a_specimen_names_the_standards_that_were_not_valid() -> None:
    xml = xml_of(calibration(specimen=True, ended=date(2027, 1, 1)))
    (text,) = texts_of(xml, ".//dcc:statement[@refType='bench_overdue']/dcc:declaration/dcc:content")
    assert "calibrator (5720A, 12)" in text
    assert set(texts_of(xml, ".//dcc:inValidityRange")) == {"false"}


def test_surroundings_in_their_units() -> None:
    xml = xml_of(calibration())
    for ref_type, values, unit in (
        ("basic_temperature", ["22.0", "24.0"], "\\degreecelsius"),
        ("basic_humidityRelative", ["0.3", "0.6"], "\\one"),
        ("bench_chamberTemperature", ["-40.1", "60.2"], "\\degreecelsius"),
        ("bench_unitTemperature", ["-39.0", "63.5"], "\\degreecelsius"),
    ):
        one = f".//dcc:influenceCondition[@refType='{ref_type}']"
        assert texts_of(xml, f"{one}//si:value") == values
        assert set(texts_of(xml, f"{one}//si:unit")) == {unit}


def test_text_that_xml_cannot_hold_does_no_harm() -> None:
    made = calibration()
    odd = {**made.manifest, "title": " <a & b> \x07 \n 'c' \ud800 ", "identities": {"dmm": {"manufacturer": " A & B "}}}
    xml = xml_of(replace(made, manifest=odd))
    assert problems(xml) == []
    assert texts_of(xml, ".//dcc:measurementResult/dcc:name/dcc:content") == ["<a & b> 'c'"]


PUBLISHED = os.environ.get("BENCH_DCC_XSD")
SIGNATURES = (
    '<xs:import namespace="http://www.w3.org/2000/09/xmldsig#" '
    'schemaLocation="https://www.ptb.de/dcc/d-sig/xmldsig-core-schema.xsd"/>'
)
WRITTEN_OUT = {
    "A": (r"\ampere", 0),
    "nA": (r"\nano\ampere", 0),
    "ppm": (r"\one", -6),
    "ppb": (r"\one", -9),
    "%": (r"\one", -2),
    "1": (r"\one", 0),
    "m": (r"\metre", 0),
    "ppm/degC": (r"\kelvin\tothe{-1}", -6),
    "ppm/degC3": (r"\kelvin\tothe{-3}", -6),
    "A/degC2": (r"\ampere\kelvin\tothe{-2}", 0),
    "A*s^0.5": (r"\ampere\second\tothe{0.5}", 0),
    "A/h^0.5": (r"\ampere\hour\tothe{-0.5}", 0),
    "ppm^0.5": (r"\one", -3),
    "A/%": (r"\ampere", 2),
    "min": (r"\minute", 0),
    "mV": (r"\milli\volt", 0),
    "degC": (r"\kelvin", 0),
    "deg/s": (r"\degree\second\tothe{-1}", 0),
    "arcsec": (r"\arcsecond", 0),
    "arcmin": (r"\arcminute", 0),
    "deg/h^0.5": (r"\degree\hour\tothe{-0.5}", 0),
    "V/Hz": (r"\volt\hertz\tothe{-1}", 0),
    "gauss": (r"\tesla", -4),
    "mgauss": (r"\tesla", -7),
    "ug": (r"\metre\second\tothe{-2}", -6),
    "g": (r"\metre\second\tothe{-2}", 0),
    "g/sqrt(Hz)": (r"\metre\second\tothe{-2}\hertz\tothe{-0.5}", 0),
}


@pytest.fixture(autouse=True)
def _no_network(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    def refused(*_: Any, **__: Any) -> NoReturn:
        raise AssertionError("went to the network")

    monkeypatch.setattr(socket.socket, "connect", refused)
    monkeypatch.setattr(socket, "getaddrinfo", refused)
    return


@pytest.fixture
def schema(tmp_path: Path) -> Path:
    """A schema whose import is an address of the network, as that of the published one is."""
    text = xsd("dcc", "https://ptb.de/si/v2.1.0/SI_Format.xsd").replace("<xs:element", SIGNATURES + "<xs:element", 1)
    (tmp_path / "dcc.xsd").write_text(text)
    (tmp_path / "SI_Format.xsd").write_text(xsd("si"))
    return tmp_path / "dcc.xsd"


def test_what_does_not_hold_has_its_line_and_its_path(schema: Path) -> None:
    text = certificate_text(calibration())
    broken = text.replace("<dcc:issuer>manufacturer</dcc:issuer>", "<dcc:issuer>maker</dcc:issuer>", 1)
    broken = broken.replace("<si:coverageProbabilityXMLList>0.95", "<si:coverageProbabilityXMLList>95", 1)
    first, second = CertificateSchema(schema).violations(broken)
    lines = broken.splitlines()
    assert "<dcc:issuer>maker</dcc:issuer>" in lines[first.line - 1]
    assert first.path.endswith("dcc:identification[1]/dcc:issuer")
    assert "calibrationLaboratory" in first.reason
    assert "coverageProbabilityXMLList>95" in lines[second.line - 1]
    error = not_valid([first, second], Path("certificate.invalid.xml"), schema)
    assert error.code == "B-DCC-009"
    assert f"line {first.line}: {first.path}" in str(error)
    assert f"line {second.line}: " in str(error)


def test_a_schema_that_is_broken_inside_is_refused_and_a_missing_import_is_named(schema: Path) -> None:
    schema.write_text(schema.read_text().replace('type="dcc:coreDataType"', 'type="dcc:nowhereType"'))
    with pytest.raises(InputError, match=r"B-DCC-008: .*not a usable schema"):
        CertificateSchema(schema)
    (schema.parent / "SI_Format.xsd").unlink()
    with pytest.raises(InputError, match=r"B-DCC-008: .*put SI_Format\.xsd beside it"):
        CertificateSchema(schema)


@pytest.mark.parametrize(
    "text", ["", "no xml", "<html/>", '<xs:schema xmlns:xs="http://www.w3.org/2001/XMLSchema" version="3.3.0"/>']
)
def test_what_is_no_schema_of_this_version_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "dcc.xsd").write_text(text)
    for name in ("dcc.xsd", "none.xsd"):
        with pytest.raises(InputError, match="B-DCC-008: "):
            CertificateSchema(tmp_path / name)


def test_without_the_package_it_says_what_to_install(schema: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xmlschema", None)
    with pytest.raises(InputError, match=r"B-DCC-010: .*inertial-bench\[certificate\]"):
        CertificateSchema(schema)


@pytest.mark.skipif(
    PUBLISHED is None, reason="needs the published dcc.xsd 3.2.1 ($BENCH_DCC_XSD), SI_Format.xsd beside it"
)
@pytest.mark.parametrize("more", [{}, {"specimen": True}, {"specimen": True, "simulated": True, "issued": None}])
def test_a_certificate_holds_the_published_schema(more: dict[str, object]) -> None:
    found = CertificateSchema(Path(str(PUBLISHED))).violations(certificate_text(calibration(**more)))
    assert [str(one) for one in found] == []


def test_the_example_is_good() -> None:
    found = load_laboratory(EXAMPLE)
    assert found.laboratory.country == "DE"
    assert found.surroundings.temperature == (22.0, 24.0)
    assert found.surroundings.humidity == (0.3, 0.6)
    assert [one.signs for one in found.responsible] == [True, False]


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("prefix: EX", "prefix: E X", "prefix"),
        ("country: DE", "country: Germany", "country"),
        ("signs: true", "signs: false", "nobody signs"),
        ("[22 degC, 24 degC]", "[24 degC, 22 degC]", "lower value first"),
        ("[22 degC, 24 degC]", "[22, 24]", "unit"),
        ("[30 %, 60 %]", "[30 %, 160 %]", "above the limit"),
        ("location: laboratory", "location: garden", "location"),
        ('# issued: "2026-11-21"', 'issued: "21.11.2026"', "YYYY-MM-DD"),
        ("prefix: EX", "prefix: EX\nfax: 1", "unknown key 'fax'"),
        ("  city: Exampletown\n", "", "'city' is missing"),
        ("order: EX-2026-001", "order: ''", "order"),
    ],
)
def test_a_mistake_is_told_with_its_place(tmp_path: Path, old: str, new: str, told: str) -> None:
    text, path = EXAMPLE.read_text(), tmp_path / "laboratory.yaml"
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        load_laboratory(path)
    assert all(word in str(caught.value) for word in (told, "laboratory.yaml:", "B-YAML-"))


@pytest.mark.parametrize("unit", WRITTEN_OUT)
def test_units_as_they_are_written_out_by_hand(unit: str) -> None:
    found = si_unit(unit)
    assert (found.token, found.power) == WRITTEN_OUT[unit]
    words = re.sub(r"\\tothe\{-?\d+(\.\d+)?\}", "", found.token).split("\\")[1:]
    assert set(words) <= DSI_UNITS | DSI_PREFIXES
    assert words[-1] in DSI_UNITS


@pytest.mark.parametrize("unit", ["", "kg", "g^0.5", "A/g", "furlong", "A//s", "/A", "A s", "ppb^0.5", "mmin", "A*"])
def test_a_unit_that_dsi_lacks_is_refused(unit: str) -> None:
    with pytest.raises(InputError, match="D-SI") as caught:
        si_unit(unit)
    assert caught.value.code == "B-DCC-007"
    assert repr(unit) in str(caught.value)


def test_conditions_carry_their_unit_in_their_name_and_a_difference_is_in_kelvin() -> None:
    assert estimate_unit("unit_temperature", "degC").token == r"\degreecelsius"
    assert estimate_unit("play_half_width", "degC").token == r"\kelvin"
    for name, token in (("reference_temperature_degC", "degreecelsius"), ("width_degC", "kelvin"), ("channel", "one"),
                        ("averaging_h", "hour"), ("hours", "hour"), ("level_A", "ampere")):  # fmt: skip
        assert condition_unit(name).token == "\\" + token  # type: ignore[union-attr]
    assert condition_unit("kind") is condition_unit("some_thing") is None


@given(st.floats(allow_nan=False, allow_infinity=False), st.sampled_from(["ppb", "ppm", "%", "1", "A/%", "g"]))
def test_a_number_is_moved_exactly_and_fits_the_pattern_of_dsi(value: float, unit: str) -> None:
    text = si_number(value, si_unit(unit))
    due = {"ppb": "1e-9", "ppm": "1e-6", "%": "1e-2", "1": "1", "A/%": "1e2", "g": "9.80665"}[unit]
    assert Decimal(text) == Decimal(repr(value)) * Decimal(due)
    assert re.fullmatch(PATTERNS["decimal"], text)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
def test_what_is_not_finite_is_no_number(value: float) -> None:
    with pytest.raises(ValueError, match="not a number"):
        si_number(value)
