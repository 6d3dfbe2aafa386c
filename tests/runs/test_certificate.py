"""``bench certificate`` on recorded sessions, every reason for which none is written; reports on paper."""

import json
from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from subprocess import CompletedProcess
from types import SimpleNamespace
from typing import Any

import pytest
import report_sample
from dcc_checker import problems, xsd
from dcc_sample import EXAMPLE, expected, read_certificate
from imported_logs import RAMP, ramp_rows, write_ramp
from rehearsal import Inside, writable_copy
from report_sample import code_names

from bench.analysis import results_json
from bench.commands import certificate as command
from bench.commands.certificate import certificate
from bench.commands.import_log import import_log
from bench.commands.requests import CertificateRequest
from bench.model.errors import BenchError, ExitStatus
from bench.record import SessionReader
from bench.report.dcc import session_of
from bench.session.service import read_view
from bench.session.view import analyse_view, report_of

Short = tuple[Path, CompletedProcess[str]]
TOKENS = {
    "ppm": r"\one", "A": r"\ampere", "ppm/degC": r"\kelvin\tothe{-1}", "ppm/degC2": r"\kelvin\tothe{-2}",
    "ppm/degC3": r"\kelvin\tothe{-3}", "A/degC": r"\ampere\kelvin\tothe{-1}", "A/degC2": r"\ampere\kelvin\tothe{-2}",
    "A/degC3": r"\ampere\kelvin\tothe{-3}", "degC": r"\kelvin", "min": r"\minute",
    "A*s^0.5": r"\ampere\second\tothe{0.5}", "A/h^0.5": r"\ampere\hour\tothe{-0.5}",
}  # fmt: skip


def request(session: Path, **more: Any) -> CertificateRequest:
    given: dict[str, Any] = {"laboratory": None, "out": None, "schema": None, "specimen": True}
    return CertificateRequest(session, **(given | more))


def refused(asked: CertificateRequest, code: str, status: int = ExitStatus.BAD_INPUT) -> str:
    """Return why there is no certificate."""
    with pytest.raises(BenchError) as caught:
        certificate(asked)
    assert (caught.value.code, caught.value.exit_status) == (code, status)
    assert not list(asked.session.glob("certificate*.xml"))
    return str(caught.value)


def written(asked: CertificateRequest, name: str = "certificate.xml") -> bytes:
    """Return the certificate that is written; nothing is wrong in it."""
    certificate(asked)
    xml = (asked.out or asked.session / name).read_bytes()
    assert problems(xml) == []
    return xml


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
    first = (session / "certificate.specimen.xml").read_bytes()
    xml = written(request(session), "certificate.specimen.xml")
    assert xml == first  # a specimen may be written again, the same bytes
    assert every_estimate_is_in(xml, session) > 20
    for text in (b"SPECIMEN - simulated, not a calibration", b"<dcc:beginPerformanceDate>2000-01-01<",
                 b"<dcc:endPerformanceDate>2000-01-01<"):  # fmt: skip
        assert text in xml
    told = session_of(xml)
    assert told.specimen
    assert told.hashes["session"] == SessionReader(session).sha256


def test_what_gets_no_certificate(session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A simulated session, one that has not ended, without results, damaged, of no UTC; a wrong schema, no place."""
    assert "--specimen" in refused(request(session, specimen=False), "B-DCC-001")
    refused(request(session, schema=tmp_path / "none.xsd"), "B-DCC-008")  # before anything else
    refused(request(session, out=session / "results.json" / "c.xml"), "B-CLI-007")
    refused(request(tmp_path), "B-REC-010")
    with monkeypatch.context() as patch:
        view = command.read_view(session)
        patch.setattr(command, "read_view", lambda *_, **__: view)
        patch.setattr(SessionReader, "select", lambda *_: iter(()))
        refused(request(session), "B-DCC-013")
    results = session / "results.json"
    good = results.read_text()
    results.write_text("{")
    refused(request(session), "B-DCC-004")
    results.unlink()
    refused(request(session), "B-DCC-004")
    (session / "session.open").touch()
    refused(request(session), "B-DCC-003")  # which says more
    (session / "session.open").unlink()
    path = session / "session.0001.mcap"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0x01
    path.write_bytes(content)
    results.write_text(good)
    refused(request(session), "B-REC-011", ExitStatus.SESSION_DAMAGED)


def test_a_number_that_the_recording_does_not_give_is_seen(session: Path) -> None:
    path = session / "results.json"
    document = json.loads(path.read_text())
    document["estimates"][0]["value"] *= 1.0 + 1e-8
    path.write_text(json.dumps(document))
    assert "estimates[0].value" in refused(request(session), "B-DCC-005", ExitStatus.SESSION_DAMAGED)
    document["provenance"]["session_sha256"] = "0" * 64
    path.write_text(json.dumps(document))
    assert "another recording" in refused(request(session), "B-DCC-005", ExitStatus.SESSION_DAMAGED)


def test_a_certificate_that_does_not_hold_its_schema_is_not_written(session: Path, tmp_path: Path) -> None:
    text = xsd("dcc", "SI_Format.xsd")
    (tmp_path / "SI_Format.xsd").write_text(xsd("si"))
    schema = tmp_path / "dcc.xsd"
    schema.write_text(text)
    good = written(request(session, schema=schema, out=tmp_path / "good.xml"))
    schema.write_text(
        text.replace('name="statements" type="dcc:statementListType" minOccurs="0"', 'name="s" type="xs:string"')
    )
    refused(request(session, schema=schema, out=tmp_path / "bad.xml"), "B-DCC-009")
    assert not (tmp_path / "bad.xml").exists()
    assert (tmp_path / "bad.invalid.xml").read_bytes() == good


@pytest.mark.slow
def test_a_real_session_needs_a_laboratory_and_standards(tmp_path: Path) -> None:
    (tmp_path / "m.yaml").write_text(RAMP)
    write_ramp(tmp_path / "log.csv", ramp_rows(3))
    assert import_log(tmp_path / "m.yaml", tmp_path / "log.csv", tmp_path / "out") == 0
    folder = next((tmp_path / "out").iterdir())
    refused(request(folder, specimen=False), "B-DCC-002")
    said = refused(request(folder, specimen=False, laboratory=EXAMPLE), "B-DCC-006")
    assert "2024-10-20 to 2024-10-20: any standard" in said


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


@pytest.fixture
def own(tmp_path: Path) -> Callable[[str], Path]:
    """Write the example of a laboratory with something more."""

    def write(more: str) -> Path:
        path = tmp_path / "laboratory.yaml"
        path.write_text(f"{EXAMPLE.read_text()}\n{more}\n")
        return path

    return write


def test_a_real_session_gets_its_certificate_once(real: Real) -> None:
    asked = real()
    xml = written(asked)
    assert b"SPECIMEN" not in xml
    assert b"<dcc:issueDate>20" in xml
    assert not session_of(xml).specimen
    assert every_estimate_is_in(xml, asked.session) == 10
    (asked.session / "certificate.xml").write_text("handed out")
    with pytest.raises(BenchError, match="B-DCC-012"):
        certificate(asked)
    assert (asked.session / "certificate.xml").read_text() == "handed out"


def test_a_standard_that_is_overdue_is_named(real: Real) -> None:
    said = refused(real(due="1999-12-31"), "B-DCC-006")
    assert "calibrator (5720A, SIM5720): calibrated 1999-11-01, due 1999-12-31" in said


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
    said = refused(asked, "B-DCC-016", ExitStatus.BAD_INPUT)
    assert said.count("\n") == 0
    assert "calibrator: the specification of its range 220 uA, as 4 more ranges, holds 90 days" in said


@pytest.mark.parametrize("day", ["received: 2000-01-02", "issued: 1999-12-31"])
def test_days_that_contradict_the_session_are_named(real: Real, own: Callable[[str], Path], day: str) -> None:
    key, _, value = day.partition(": ")
    laboratory = own(f'{key}: "{value}"')
    said = refused(real(laboratory=laboratory), "B-DCC-014")
    assert all(text in said for text in (str(laboratory), day.replace(":", ""), "on 2000-01-01"))


SCOPE = """
accreditation:
  body: Example Body
  number: EX-0000
  scope:
    - {quantity: dsf_n, range: [-1 %, 1 %], cmc: CMC, method: scale_factor}
    - {quantity: dsf_p, range: [-1 %, 1 %], cmc: 1 ppm, method: scale_factor}
"""


def test_less_than_the_capability_is_not_stated_under_an_accreditation(real: Real, own: Callable[[str], Path]) -> None:
    asked = real(laboratory=own(SCOPE.replace("CMC", "5000 ppm")))
    estimates = json.loads((asked.session / "results.json").read_text())["estimates"]
    expanded = next(one["expanded_uncertainty"] for one in estimates if one["quantity"] == "dsf_n")
    assert f"dsf_n: U = {expanded:.3g} ppm is below the CMC of 5000 ppm" in refused(asked, "B-DCC-017")
    own(SCOPE.replace("CMC", "1 ppm"))
    assert b"by Example Body, EX-0000: dsf_n, dsf_p. Not covered by it: bias" in written(asked)


def test_an_amended_certificate_names_what_it_replaces(real: Real, own: Callable[[str], Path]) -> None:
    more = "number: EX-2\nreplaces: {number: EX-1, reason: A name was wrong.}\n"
    xml = written(real(laboratory=own(f"{more}next_calibration: {{day: '2001-01-01', agreed: true}}")))
    assert session_of(xml).unique_identifier == "EX-2"
    assert b"<dcc:replacedUniqueIdentifier>EX-1<" in xml
    assert b"This certificate replaces EX-1. Reason: A name was wrong." in xml
    assert b"Next calibration, as agreed with the customer: 2001-01-01." in xml


FIGURES = {"scale_factor": 7, "bias_ramp": 8}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["scale_factor", pytest.param("bias_ramp", marks=pytest.mark.sweep)])
def test_page_and_paper_are_legible_and_name_what_counts(
    name: str, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = request.getfixturevalue("short")[0] if name == "scale_factor" else request.getfixturevalue("ramp")
    figures = report_sample.recorded_figures(monkeypatch)
    view = read_view(folder)
    report = report_of(view, *analyse_view(view))
    assert len(figures) == FIGURES[name] == sum(len(section.pictures) for section in report.sections)
    assert [report_sample.flaws(figure) for figure in figures] == [[]] * len(figures)
    assert report.pdf().startswith(b"%PDF-")
    page = report.html()
    assert (folder / "report.html").read_text(encoding="utf-8") == page  # the run and the session say the same
    for text in (
        "days left",
        "answered by",
        "No command of a person is recorded.",
        "air of the laboratory",
        "approved",
    ):
        assert text in page
    assert "2000-01-01 00:00:00 UTC" in page
    assert code_names(page) == set()
