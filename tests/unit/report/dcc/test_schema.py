"""Validation with a schema of the user, offline: here one made of the facts, and the published one if there is one."""

from __future__ import annotations

import importlib
import os
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

import pytest
from dcc_checker import xsd
from dcc_sample import calibration

from bench.model.errors import InputError
from bench.report.dcc import CertificateSchema, certificate_text, not_valid

PUBLISHED = os.environ.get("BENCH_DCC_XSD")
SIGNATURES = (
    '<xs:import namespace="http://www.w3.org/2000/09/xmldsig#" '
    'schemaLocation="https://www.ptb.de/dcc/d-sig/xmldsig-core-schema.xsd"/>'
)


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


def test_a_long_list_of_mistakes_is_cut_and_says_so(schema: Path) -> None:
    broken = certificate_text(calibration()).replace("\\one</si:unitXMLList>", "\\one</si:unit>")
    broken = broken.replace("<si:unitXMLList>\\one", "<si:unit>\\one")
    found = CertificateSchema(schema).violations(broken)
    assert len(found) > 20
    assert f"and {len(found) - 20} more" in str(not_valid(found, Path("x"), schema))


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
    with pytest.raises(InputError) as caught:
        CertificateSchema(tmp_path / "dcc.xsd")
    assert caught.value.code == "B-DCC-008"


def test_a_schema_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        CertificateSchema(tmp_path / "none.xsd")
    assert caught.value.code == "B-DCC-008"


def test_a_schema_that_is_broken_inside_is_refused(schema: Path) -> None:
    schema.write_text(schema.read_text().replace('type="dcc:coreDataType"', 'type="dcc:nowhereType"'))
    with pytest.raises(InputError, match="not a usable schema") as caught:
        CertificateSchema(schema)
    assert caught.value.code == "B-DCC-008"


def test_without_the_package_it_says_what_to_install(schema: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = importlib.import_module

    def absent(name: str, package: str | None = None) -> Any:
        if name == "xmlschema":
            raise ModuleNotFoundError(name)
        return plain(name, package)

    monkeypatch.setattr(importlib, "import_module", absent)
    with pytest.raises(InputError, match=r"inertial-bench\[certificate\]") as caught:
        CertificateSchema(schema)
    assert caught.value.code == "B-DCC-010"


@pytest.mark.skipif(
    PUBLISHED is None, reason="needs the published dcc.xsd 3.2.1 ($BENCH_DCC_XSD), SI_Format.xsd beside it"
)
@pytest.mark.parametrize("more", [{}, {"specimen": True}, {"specimen": True, "simulated": True, "issued": None}])
def test_a_certificate_holds_the_published_schema(more: dict[str, object]) -> None:
    found = CertificateSchema(Path(str(PUBLISHED))).violations(certificate_text(calibration(**more)))
    assert [str(one) for one in found] == []
