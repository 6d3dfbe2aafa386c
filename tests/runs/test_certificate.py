"""``bench certificate`` on recorded sessions: what is written, and every reason for which nothing is."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from subprocess import CompletedProcess
from types import SimpleNamespace
from typing import Any

import pytest
from dcc_checker import problems, xsd
from dcc_sample import EXAMPLE, expected, read_certificate
from import_sample import RAMP, ramp_rows, write_ramp
from rehearsal import Inside, bench, writable_copy

from bench.analysis import results_json
from bench.commands import certificate as command
from bench.commands.certificate import certificate
from bench.commands.import_log import import_log
from bench.commands.requests import CertificateRequest
from bench.model.errors import BenchError, ExitStatus
from bench.record import SessionReader
from bench.report.dcc import session_of
from bench.session.view import analyse_view

Short = tuple[Path, CompletedProcess[str]]
TOKENS = {
    "ppm": r"\one", "A": r"\ampere", "ppm/degC": r"\kelvin\tothe{-1}", "ppm/degC2": r"\kelvin\tothe{-2}",
    "ppm/degC3": r"\kelvin\tothe{-3}", "A/degC": r"\ampere\kelvin\tothe{-1}", "A/degC2": r"\ampere\kelvin\tothe{-2}",
    "A/degC3": r"\ampere\kelvin\tothe{-3}", "degC": r"\kelvin", "min": r"\minute",
    "A*s^0.5": r"\ampere\second\tothe{0.5}", "A/h^0.5": r"\ampere\hour\tothe{-0.5}",
}  # fmt: skip


@pytest.fixture
def session(golden: Path, tmp_path: Path) -> Path:
    """A copy of the smallest campaign."""
    return writable_copy(golden, tmp_path / golden.name)


def request(session: Path, **more: Any) -> CertificateRequest:
    given: dict[str, Any] = {"laboratory": None, "out": None, "schema": None, "specimen": True}
    return CertificateRequest(session, **(given | more))


def refused(asked: CertificateRequest) -> BenchError:
    with pytest.raises(BenchError) as caught:
        certificate(asked)
    assert not list(asked.session.glob("certificate*.xml"))
    return caught.value


def every_estimate_is_in(xml: bytes, folder: Path) -> int:
    """All values of results.json, digit by digit, with unit, U, k and conditions; how many they are."""
    estimates = json.loads((folder / "results.json").read_text())["estimates"]
    wanted = [expected(one, TOKENS[one["unit"]]) for one in estimates]
    found = read_certificate(xml)
    assert sorted(found, key=repr) == sorted(wanted, key=repr)
    assert all(one.probability == Decimal("0.95") for one in found)
    return len(found)


def test_a_specimen_of_a_simulated_session(short: Short, tmp_path: Path, inside: Inside) -> None:
    session = writable_copy(short[0], tmp_path / short[0].name)
    done = inside("certificate", str(session), "--specimen")
    assert (done.returncode, done.stderr) == (0, "")
    assert "certificate.specimen.xml" in done.stdout
    xml = (session / "certificate.specimen.xml").read_bytes()
    assert problems(xml) == []
    assert every_estimate_is_in(xml, session) > 20
    assert b"SPECIMEN - simulated, not a calibration" in xml
    told = session_of(xml)
    assert told.specimen
    assert b"<dcc:beginPerformanceDate>2000-01-01<" in xml
    assert b"<dcc:endPerformanceDate>2000-01-01<" in xml
    assert told.hashes["session"] == SessionReader(session).sha256
    assert certificate(request(session)) == ExitStatus.PASS  # a specimen may be written again, the same bytes
    assert (session / "certificate.specimen.xml").read_bytes() == xml


@pytest.mark.sweep
def test_a_specimen_of_the_bias_campaign(tmp_path: Path) -> None:
    done = bench("run", "bias_ramp_short", "--seed", "11", "--out", str(tmp_path))
    assert done.returncode in (0, 1), done.stderr
    folder = next(path for path in tmp_path.iterdir() if path.is_dir())
    assert certificate(request(folder, laboratory=EXAMPLE, out=tmp_path / "c.xml")) == ExitStatus.PASS
    xml = (tmp_path / "c.xml").read_bytes()
    assert problems(xml) == []
    assert every_estimate_is_in(xml, folder) > 20


def test_a_simulated_session_gets_no_certificate(session: Path) -> None:
    error = refused(request(session, specimen=False))
    assert (error.code, error.exit_status) == ("B-DCC-001", ExitStatus.BAD_INPUT)
    assert "--specimen" in str(error)


def test_a_run_that_has_not_ended_gets_none(session: Path) -> None:
    (session / "session.open").touch()
    assert refused(request(session)).code == "B-DCC-003"


def test_a_session_without_results_gets_none(session: Path) -> None:
    (session / "results.json").unlink()
    assert refused(request(session)).code == "B-DCC-004"
    (session / "results.json").write_text("{")
    assert refused(request(session)).code == "B-DCC-004"
    (session / "results.json").unlink()
    (session / "session.open").touch()
    assert refused(request(session)).code == "B-DCC-003"  # which says more


def test_a_number_that_the_recording_does_not_give_is_seen(session: Path) -> None:
    path = session / "results.json"
    document = json.loads(path.read_text())
    document["estimates"][0]["value"] *= 1.0 + 1e-8
    path.write_text(json.dumps(document))
    error = refused(request(session))
    assert (error.code, error.exit_status) == ("B-DCC-005", ExitStatus.SESSION_DAMAGED)
    assert "estimates[0].value" in str(error)
    document["provenance"]["session_sha256"] = "0" * 64
    path.write_text(json.dumps(document))
    error = refused(request(session))
    assert error.code == "B-DCC-005"
    assert "another recording" in str(error)


def test_a_damaged_session_gets_none(session: Path) -> None:
    path = session / "session.0001.mcap"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0x01
    path.write_bytes(content)
    error = refused(request(session))
    assert (error.code, error.exit_status) == ("B-REC-011", ExitStatus.SESSION_DAMAGED)


def test_a_session_that_is_not_there(tmp_path: Path) -> None:
    assert refused(request(tmp_path)).code == "B-REC-010"


def test_a_file_that_cannot_be_written(session: Path) -> None:
    assert refused(request(session, out=session / "results.json" / "c.xml")).code == "B-CLI-007"


def test_a_wrong_schema_is_refused_before_anything_else(session: Path, tmp_path: Path) -> None:
    assert refused(request(session, schema=tmp_path / "none.xsd")).code == "B-DCC-008"


def test_a_certificate_that_does_not_hold_its_schema_is_not_written(session: Path, tmp_path: Path) -> None:
    text = xsd("dcc", "SI_Format.xsd")
    (tmp_path / "SI_Format.xsd").write_text(xsd("si"))
    schema = tmp_path / "dcc.xsd"
    schema.write_text(text)
    assert certificate(request(session, schema=schema, out=tmp_path / "good.xml")) == ExitStatus.PASS
    schema.write_text(
        text.replace('name="statements" type="dcc:statementListType" minOccurs="0"', 'name="s" type="xs:string"')
    )
    with pytest.raises(BenchError) as caught:
        certificate(request(session, schema=schema, out=tmp_path / "bad.xml"))
    assert caught.value.code == "B-DCC-009"
    assert not (tmp_path / "bad.xml").exists()
    assert (tmp_path / "bad.invalid.xml").read_bytes() == (tmp_path / "good.xml").read_bytes()


@pytest.mark.slow
def test_a_real_session_needs_a_laboratory_and_standards(tmp_path: Path) -> None:
    (tmp_path / "m.yaml").write_text(RAMP)
    write_ramp(tmp_path / "log.csv", ramp_rows(3))
    assert import_log(tmp_path / "m.yaml", tmp_path / "log.csv", tmp_path / "out") == 0
    folder = next((tmp_path / "out").iterdir())
    assert refused(request(folder, specimen=False)).code == "B-DCC-002"
    error = refused(request(folder, specimen=False, laboratory=EXAMPLE))
    assert error.code == "B-DCC-006"
    assert "2024-10-20 to 2024-10-20: any standard" in str(error)


Real = Callable[..., CertificateRequest]


@pytest.fixture
def real(session: Path, monkeypatch: pytest.MonkeyPatch) -> Real:
    """The smallest campaign as if a real bench had recorded it; ``due``: of its standards."""
    path = session / "results.json"
    document = json.loads(path.read_text())
    document["provenance"]["simulated"] = False
    path.write_text(json.dumps(document))
    plain = command.read_view

    def ask(due: str = "2000-11-01", calibrated: str = "1999-11-01", **more: Any) -> CertificateRequest:
        def view(folder: Path, strict: bool = False) -> Any:
            found = plain(folder, strict=strict)
            dates = {"due": due, "calibrated": calibrated}
            standards = {role: {**entry, **dates} for role, entry in found.manifest["standards"].items()}
            return replace(found, manifest={**found.manifest, "simulated": False, "standards": standards})

        monkeypatch.setattr(command, "read_view", view)
        clock = SessionReader(session).select
        fake = SimpleNamespace(manifest={"simulated": False}, select=clock)
        monkeypatch.setattr(command, "SessionReader", lambda _: fake)
        return request(session, specimen=False, **({"laboratory": EXAMPLE} | more))

    return ask


def test_a_real_session_gets_its_certificate(real: Real) -> None:
    asked = real()
    assert certificate(asked) == ExitStatus.PASS
    xml = (asked.session / "certificate.xml").read_bytes()
    assert problems(xml) == []
    assert b"SPECIMEN" not in xml
    assert b"<dcc:issueDate>20" in xml
    assert not session_of(xml).specimen
    assert every_estimate_is_in(xml, asked.session) == 10


def test_a_standard_that_is_overdue_is_named(real: Real) -> None:
    error = refused(real(due="1999-12-31"))
    assert error.code == "B-DCC-006"
    assert "calibrator (5720A, SIM5720): calibrated 1999-11-01, due 1999-12-31" in str(error)


def test_a_specification_that_did_not_hold_until_the_end_is_named(real: Real) -> None:
    """Calibrated on 1 October and good for 90 days, until 30 December; the campaign is of 1 January."""
    asked = real(calibrated="1999-10-01")
    view = command.read_view(asked.session, strict=True)
    document = analyse_view(view)[0]
    document["provenance"]["simulated"] = False
    doubted = {entry["quantity"] for entry in document["estimates"] if entry["quality"] == "doubtful"}
    assert {"dsf_n", "dsf_p", "dsf_asymmetry"} <= doubted
    assert not any("bias" in quantity or "clock" in quantity for quantity in doubted)
    (reason,) = next(entry for entry in document["estimates"] if entry["quantity"] == "dsf_n")["reasons"]
    assert reason["code"] == "specification_expired"
    (asked.session / "results.json").write_text(results_json(document))
    error = refused(asked)
    assert error.code == "B-DCC-016"
    assert str(error).count("\n") == 0
    assert "calibrator: the specification of its range 220 uA, as 4 more ranges, holds 90 days" in error.message
    assert not (asked.session / "certificate.xml").exists()


@pytest.mark.parametrize("day", ["received: 2000-01-02", "issued: 1999-12-31"])
def test_days_that_contradict_the_session_are_named(real: Real, tmp_path: Path, day: str) -> None:
    laboratory = tmp_path / "laboratory.yaml"
    key, _, value = day.partition(": ")
    laboratory.write_text(f'{EXAMPLE.read_text()}\n{key}: "{value}"\n')
    error = refused(real(laboratory=laboratory))
    assert error.code == "B-DCC-014"
    assert str(laboratory) in str(error)
    assert day.replace(":", "") in str(error)
    assert "on 2000-01-01" in str(error)


SCOPE = """
accreditation:
  body: Example Body
  number: EX-0000
  scope:
    - {quantity: dsf_n, range: [-1 %, 1 %], cmc: CMC, method: scale_factor}
    - {quantity: dsf_p, range: [-1 %, 1 %], cmc: 1 ppm, method: scale_factor}
"""


def test_less_than_the_capability_is_not_stated_under_an_accreditation(real: Real, tmp_path: Path) -> None:
    laboratory = tmp_path / "laboratory.yaml"
    laboratory.write_text(EXAMPLE.read_text() + SCOPE.replace("CMC", "5000 ppm"))
    asked = real(laboratory=laboratory)
    error = refused(asked)
    assert (error.code, error.exit_status) == ("B-DCC-017", ExitStatus.BAD_INPUT)
    expanded = next(
        one["expanded_uncertainty"]
        for one in json.loads((asked.session / "results.json").read_text())["estimates"]
        if one["quantity"] == "dsf_n"
    )
    assert f"dsf_n: U = {expanded:.3g} ppm is below the CMC of 5000 ppm" in error.message
    laboratory.write_text(EXAMPLE.read_text() + SCOPE.replace("CMC", "1 ppm"))
    assert certificate(asked) == ExitStatus.PASS
    xml = (asked.session / "certificate.xml").read_bytes()
    assert problems(xml) == []
    assert b"by Example Body, EX-0000: dsf_n, dsf_p. Not covered by it: bias" in xml


def test_an_amended_certificate_names_what_it_replaces(real: Real, tmp_path: Path) -> None:
    laboratory = tmp_path / "laboratory.yaml"
    more = "number: EX-2\nreplaces: {number: EX-1, reason: A name was wrong.}\n"
    laboratory.write_text(f"{EXAMPLE.read_text()}\n{more}next_calibration: {{day: '2001-01-01', agreed: true}}\n")
    asked = real(laboratory=laboratory)
    assert certificate(asked) == ExitStatus.PASS
    xml = (asked.session / "certificate.xml").read_bytes()
    assert problems(xml) == []
    assert session_of(xml).unique_identifier == "EX-2"
    assert b"<dcc:replacedUniqueIdentifier>EX-1<" in xml
    assert b"This certificate replaces EX-1. Reason: A name was wrong." in xml
    assert b"Next calibration, as agreed with the customer: 2001-01-01." in xml


def test_a_session_without_utc_has_no_days(session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    view = command.read_view(session)
    monkeypatch.setattr(command, "read_view", lambda *_, **__: view)
    monkeypatch.setattr(SessionReader, "select", lambda *_: iter(()))
    assert refused(request(session)).code == "B-DCC-013"


def test_a_certificate_that_was_written_is_not_changed(real: Real) -> None:
    asked = real()
    path = asked.session / "certificate.xml"
    path.write_text("handed out")
    with pytest.raises(BenchError) as caught:
        certificate(asked)
    assert caught.value.code == "B-DCC-012"
    assert path.read_text() == "handed out"
