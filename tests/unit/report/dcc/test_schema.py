"""What a certificate is held against: the schema, the file of the laboratory, units in D-SI."""

import os
import re
import socket
import sys
from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path
from typing import Any, NoReturn

import pytest
from dcc_checker import xsd
from dcc_facts import DSI_PREFIXES, DSI_UNITS, PATTERNS
from dcc_sample import EXAMPLE, calibration
from hypothesis import given
from hypothesis import strategies as st

from bench.model.errors import InputError
from bench.report.dcc import CertificateSchema, certificate_text, not_valid
from bench.report.dcc.dsi import condition_unit, estimate_unit, si_number, si_unit
from bench.report.laboratory import load_laboratory

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


def test_a_certificate_holds_the_schema_of_the_facts(schema: Path) -> None:
    for more in ({}, {"specimen": True, "simulated": True, "issued": None}):
        assert CertificateSchema(schema).violations(certificate_text(calibration(**more))) == []


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


def test_a_missing_import_is_named(schema: Path) -> None:
    (schema.parent / "SI_Format.xsd").unlink()
    with pytest.raises(InputError, match=r"SI_Format\.xsd") as caught:
        CertificateSchema(schema)
    assert caught.value.code == "B-DCC-008"
    assert "put SI_Format.xsd beside it" in str(caught.value)


@pytest.mark.parametrize(
    "text", ["", "no xml", "<html/>", '<xs:schema xmlns:xs="http://www.w3.org/2001/XMLSchema" version="3.3.0"/>']
)
def test_what_is_no_schema_of_this_version_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "dcc.xsd").write_text(text)
    for name in ("dcc.xsd", "none.xsd"):
        with pytest.raises(InputError, match="B-DCC-008: "):
            CertificateSchema(tmp_path / name)


def test_a_schema_that_is_broken_inside_is_refused(schema: Path) -> None:
    schema.write_text(schema.read_text().replace('type="dcc:coreDataType"', 'type="dcc:nowhereType"'))
    with pytest.raises(InputError, match=r"B-DCC-008: .*not a usable schema"):
        CertificateSchema(schema)


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


def load(tmp_path: Path, old: str, new: str) -> str:
    text = EXAMPLE.read_text()
    assert old in text
    path = tmp_path / "laboratory.yaml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        load_laboratory(path)
    return str(caught.value)


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
    message = load(tmp_path, old, new)
    assert told in message
    assert "laboratory.yaml:" in message
    assert "B-YAML-" in message


@pytest.mark.parametrize("unit", WRITTEN_OUT)
def test_units_as_they_are_written_out_by_hand(unit: str) -> None:
    found = si_unit(unit)
    assert (found.token, found.power) == WRITTEN_OUT[unit]


@pytest.mark.parametrize("unit", WRITTEN_OUT)
def test_every_identifier_is_one_of_dsi(unit: str) -> None:
    words = re.sub(r"\\tothe\{-?\d+(\.\d+)?\}", "", si_unit(unit).token).split("\\")[1:]
    assert words
    assert set(words) <= DSI_UNITS | DSI_PREFIXES
    assert words[-1] in DSI_UNITS


@pytest.mark.parametrize("unit", ["", "kg", "g^0.5", "A/g", "furlong", "A//s", "/A", "A s", "ppb^0.5", "mmin", "A*"])
def test_a_unit_that_dsi_lacks_is_refused(unit: str) -> None:
    with pytest.raises(InputError, match="D-SI") as caught:
        si_unit(unit)
    assert caught.value.code == "B-DCC-007"
    assert repr(unit) in str(caught.value)


def test_a_temperature_is_in_celsius_and_a_difference_in_kelvin() -> None:
    assert estimate_unit("unit_temperature", "degC").token == r"\degreecelsius"
    assert estimate_unit("play_half_width", "degC").token == r"\kelvin"
    assert condition_unit("reference_temperature_degC").token == r"\degreecelsius"  # type: ignore[union-attr]
    assert condition_unit("width_degC").token == r"\kelvin"  # type: ignore[union-attr]


def test_conditions_carry_their_unit_in_their_name_or_none() -> None:
    assert condition_unit("channel").token == r"\one"  # type: ignore[union-attr]
    assert condition_unit("averaging_h").token == r"\hour"  # type: ignore[union-attr]
    assert condition_unit("hours").token == r"\hour"  # type: ignore[union-attr]
    assert condition_unit("level_A").token == r"\ampere"  # type: ignore[union-attr]
    assert condition_unit("kind") is None
    assert condition_unit("some_thing") is None


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
