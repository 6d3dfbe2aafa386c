"""bench report --verify: what was altered in a session or in what was computed from it is named; nothing is written."""

import copy
import json
import shutil
import struct
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rehearsal import ROOT, contents

from bench.commands import verify as command
from bench.commands.certificate import certificate
from bench.commands.fit import fit, report
from bench.commands.recover import recover
from bench.commands.requests import CertificateRequest
from bench.commands.session import replay
from bench.commands.verify import verify
from bench.model.errors import ExitStatus, InputError, SessionDamaged
from bench.record import SHORTER
from bench.report import Report, ReportModel
from bench.session import verification

GOLDEN = ROOT / "tests" / "golden" / "sessions"
SEGMENT = "session.0001.mcap"
CHUNK, FOOTER = 0x06, 0x02  # of the MCAP format


Alter = Callable[[Path], object]


REPORTS: dict[str, Report] = {}  # by the results they show, which name the hash of the recording
ANALYSED: dict[bytes, Any] = {}  # by the bytes of the recording


@pytest.fixture(autouse=True)
def drawn_once(session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same bytes are analysed, and their report is drawn, for the first test that needs it, and compared by all."""
    plain, analysed = verification.report_of, command.analyse_view

    def analyse_view(view: Any) -> Any:
        raw = (session / SEGMENT).read_bytes()
        if raw not in ANALYSED:
            ANALYSED[raw] = analysed(view)
        return copy.deepcopy(ANALYSED[raw])

    def report_of(view: Any, results: Any, analysis: Any, laboratory: Any) -> Report:
        shown = f"{verification.results_json(results)}{laboratory}"
        if shown not in REPORTS:
            REPORTS[shown] = plain(view, results, analysis, laboratory)
        return REPORTS[shown]

    monkeypatch.setattr(verification, "report_of", report_of)
    monkeypatch.setattr(command, "analyse_view", analyse_view)


@pytest.fixture
def drawn(session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The report is taken as drawn: drawing it is slow, and these tests look at something else."""
    page = (session / "report.html").read_text(encoding="utf-8")
    monkeypatch.setattr(verification, "report_of", lambda *_: SimpleNamespace(html=lambda: page))


def verified(folder: Path, capsys: pytest.CaptureFixture[str], status: int) -> dict[str, Any]:
    """What --json says; the exit status is as expected and no file is touched."""
    before = contents(folder)
    capsys.readouterr()
    if status == ExitStatus.PASS:
        assert verify(folder, as_json=True) == status
    else:
        with pytest.raises(SessionDamaged) as caught:
            verify(folder, as_json=True)
        assert (caught.value.code, caught.value.exit_status) == ("B-CLI-012", status)
    assert contents(folder) == before
    document: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert document["identical"] is (status == ExitStatus.PASS)
    return document


def changed(document: dict[str, Any]) -> set[str]:
    return {change["file"] for change in document["changes"]}


def records(content: bytes) -> list[tuple[int, int, int]]:
    """Opcode, first and last byte of every record of a segment."""
    found, at = [], 8
    while at < len(content) - 8:
        opcode, length = struct.unpack_from("<BQ", content, at)
        found.append((opcode, at, at + 9 + length))
        at += 9 + length
    return found


def flip(path: Path, at: int) -> None:
    content = bytearray(path.read_bytes())
    content[at] ^= 1
    path.write_bytes(content)


def rewrite(path: Path, *changes: tuple[str, str]) -> None:
    """Replace texts of a file, each once."""
    text = path.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    path.write_text(text, encoding="utf-8")


def refused(code: str, call: Callable[[], object]) -> InputError:
    with pytest.raises(InputError) as caught:
        call()
    assert caught.value.code == code
    return caught.value


def test_an_untouched_session_is_identical(session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    document = verified(session, capsys, ExitStatus.PASS)
    assert document["compared"][:3] == [SEGMENT, "results.json", "report.html"]
    assert document["records"] == 10
    stored = json.loads((session / "results.json").read_text())
    assert document["session_sha256"] == stored["provenance"]["session_sha256"]
    assert verify(session, as_json=False) == ExitStatus.PASS
    assert capsys.readouterr().out.startswith(f"identical: {session}: {SEGMENT}, results.json, report.html")


PLACES: dict[str, Callable[[list[tuple[int, int, int]], int], int]] = {
    "magic": lambda found, size: 3,
    "middle chunk": lambda found, size: [(at + end) // 2 for op, at, end in found if op == CHUNK][3],
    "chain": lambda found, size: [end - 20 for op, _, end in found if op == CHUNK][-1],
    "footer": lambda found, size: next(end - 1 for op, _, end in found if op == FOOTER),
}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.usefixtures("drawn")
def test_one_altered_byte_of_a_segment_is_named(session: Path, capsys: pytest.CaptureFixture[str], place: str) -> None:
    path = session / SEGMENT
    content = path.read_bytes()
    flip(path, PLACES[place](records(content), len(content)))
    document = verified(session, capsys, ExitStatus.SESSION_DAMAGED)
    assert SEGMENT in changed(document), place
    assert all("byte" in change["what"] for change in document["changes"] if change["file"] == SEGMENT)


@pytest.mark.usefixtures("drawn")
def test_a_copy_in_part_is_told_alike_by_every_command(session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = session / SEGMENT
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 4 // 10])
    document = verified(session, capsys, ExitStatus.SESSION_DAMAGED)
    cut = f"byte {path.stat().st_size}: {SHORTER}"
    assert document["changes"][0] == {"file": SEGMENT, "what": cut}
    assert recover(session, None, as_json=False) == ExitStatus.SESSION_DAMAGED
    said = capsys.readouterr().out
    assert f"damaged: {SEGMENT} {cut}" in said
    assert "missing: its record is lost" in said
    for work in (lambda: replay(session, as_json=False), lambda: fit(session, None, as_json=False)):
        with pytest.raises(SessionDamaged, match=f"^error B-REC-011: {session}: {SEGMENT} {cut}"):
            work()


@pytest.mark.usefixtures("drawn")
def test_one_digit_of_the_results_is_named(session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = session / "results.json"
    now = repr(json.loads(path.read_text())["estimates"][3]["value"])
    digit = now.index(".") - 1
    was = f"{now[:digit]}{(int(now[digit]) + 1) % 10}{now[digit + 1 :]}"
    rewrite(path, (f'"value": {now}', f'"value": {was}'))
    document = verified(session, capsys, ExitStatus.SESSION_DAMAGED)
    assert [change["what"] for change in document["changes"]] == [f"estimates[3].value {was} -> {now}"]
    assert document["notes"] == []


def other_segment(session: Path) -> None:
    """Whole, and its own hash chain agrees: the results do not."""
    shutil.copy(next(GOLDEN.glob(f"*/*/{SEGMENT}")), session / SEGMENT)


def cut_segment(session: Path) -> None:
    path = session / SEGMENT
    path.write_bytes(path.read_bytes()[:-30_000])


def results(old: str, new: str) -> Alter:
    return lambda session: rewrite(session / "results.json", (old, new))


ALTERED: dict[str, tuple[Alter, str, str]] = {  # alteration, file that is named, words of the change or of a note
    "a space": (results('"estimates": [', '"estimates":['), "results.json", "same values"),
    "a name that is there twice": (results("{\n", '{\n "campaign": "x",\n'), "results.json", "same values"),
    "no JSON": (results("{\n", "{{\n"), "results.json", "cannot be read as JSON"),
    "one more": (results(' "notes"', ' "remark": "x",\n "notes"'), "results.json", "remark x -> (absent)"),
    "a verdict": (results('"verdict": "none"', '"verdict": "pass"'), "results.json", "estimates"),
    "where it is from": (
        results('"simulated": true', '"simulated": false'), "results.json", "provenance.simulated false -> true",
    ),
    "another session": (other_segment, "results.json", "provenance.session_sha256"),
    "a cut segment": (cut_segment, "results.json", "has no end"),
}  # fmt: skip


@pytest.mark.parametrize("what", ALTERED)
@pytest.mark.usefixtures("drawn")
def test_whatever_else_is_altered_is_named(session: Path, capsys: pytest.CaptureFixture[str], what: str) -> None:
    alter, file, words = ALTERED[what]
    alter(session)
    document = verified(session, capsys, ExitStatus.SESSION_DAMAGED)
    assert file in changed(document)
    said = [change["what"] for change in document["changes"] if change["file"] == file]
    assert any(words in one for one in (*said, *document["notes"])), said


def test_one_character_of_the_report_is_named_and_another_version_is_no_excuse(
    session: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flip(session / "report.html", 1000)
    document = verified(session, capsys, ExitStatus.SESSION_DAMAGED)
    assert document["changes"] == [{"file": "report.html", "what": "is not what the session gives"}]
    rewrite(session / "results.json", ('"software": "', '"software": "not '))
    document = verified(session, capsys, ExitStatus.SESSION_DAMAGED)
    assert changed(document) == {"report.html"}
    assert "it was written by not inertial-bench" in document["changes"][0]["what"]


def test_another_version_of_the_software_alone_is_no_difference(
    session: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    now = json.loads((session / "results.json").read_text())["provenance"]["software"]
    rewrite(session / "results.json", (now, "inertial-bench 0.0.9"))
    for before in (">software</th><td>", "Sequence golden, "):  # not of the manifest
        rewrite(session / "report.html", (f"{before}{now}", f"{before}inertial-bench 0.0.9"))
    document = verified(session, capsys, ExitStatus.PASS)
    assert f"results.json was written by inertial-bench 0.0.9, this is {now}" in document["notes"]


@pytest.mark.parametrize(("size", "rounded"), [(1e-13, True), (1e-7, False), (1e-6, False)])
@pytest.mark.usefixtures("drawn")
def test_last_digits_are_called_what_they_are(
    session: Path, capsys: pytest.CaptureFixture[str], size: float, rounded: bool
) -> None:
    path = session / "results.json"
    stored = json.loads(path.read_text())
    stored["estimates"][0]["value"] *= 1 + size
    path.write_text(verification.results_json(stored))
    document = verified(session, capsys, ExitStatus.SESSION_DAMAGED)
    assert any(change["what"].startswith("estimates[0].value") for change in document["changes"])
    assert any("largest relative difference" in note for note in document["notes"]) is rounded


@pytest.mark.usefixtures("drawn")
def test_what_is_not_there_is_said(session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A report that is not there is no alteration; damage counts without results too."""
    (session / "report.html").unlink()
    document = verified(session, capsys, ExitStatus.PASS)
    assert document["absent"] == ["report.html"]
    assert "report.html" not in document["compared"]
    (session / "results.json").unlink()
    refused("B-CLI-010", lambda: verify(session, as_json=True))
    flip(session / SEGMENT, 20_000)
    assert changed(verified(session, capsys, ExitStatus.SESSION_DAMAGED)) >= {SEGMENT}
    refused("B-REC-010", lambda: verify(tmp_path, as_json=False))


@pytest.mark.usefixtures("drawn")
@pytest.mark.parametrize("name", ["port_a.001s", "port_b.100s", "trend.json"])
def test_one_altered_byte_of_the_trend_is_named(session: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    """It is no part of the recording, so it makes nothing wrong."""
    assert verified(session, capsys, ExitStatus.PASS)["notes"] == []
    path = session / "trend" / name
    flip(path, path.read_bytes().rindex(b'"npp"') + 1 if name == "trend.json" else 40)
    (note,) = verified(session, capsys, ExitStatus.PASS)["notes"]
    assert note.startswith(f"trend/{name} is not what the session gives; it is no part of the recording")
    path.write_bytes(b"{")
    (note,) = verified(session, capsys, ExitStatus.PASS)["notes"]
    assert note.startswith(f"trend/{name} ")
    shutil.rmtree(session / "trend")
    assert verified(session, capsys, ExitStatus.PASS)["notes"] == []


@pytest.fixture
def certified(session: Path) -> Path:
    """A session with a specimen of its certificate."""
    certificate(CertificateRequest(session, specimen=True))
    return session


@pytest.mark.usefixtures("drawn")
@pytest.mark.parametrize("where", ["a number of its results", "its session", "its end"])
def test_an_altered_certificate_is_named(certified: Path, capsys: pytest.CaptureFixture[str], where: str) -> None:
    assert "certificate.specimen.xml" in verified(certified, capsys, ExitStatus.PASS)["compared"]
    path = certified / "certificate.specimen.xml"
    text = path.read_text(encoding="utf-8")
    stored = json.loads((certified / "results.json").read_text())
    if where == "a number of its results":
        at = text.index(repr(stored["estimates"][0]["value"]).lstrip("-")[:8], text.index("<dcc:results>")) + 2
        text = text[:at] + ("1" if text[at] != "1" else "2") + text[at + 1 :]
    else:
        sha256 = stored["provenance"]["session_sha256"]
        text = text.replace(sha256, "0" * 64) if where == "its session" else text[:-30]
    path.write_text(text, encoding="utf-8")
    assert changed(verified(certified, capsys, ExitStatus.SESSION_DAMAGED)) == {"certificate.specimen.xml"}


def test_a_certificate_of_another_report_is_named(certified: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flip(certified / "report.html", 1000)
    document = verified(certified, capsys, ExitStatus.SESSION_DAMAGED)
    assert changed(document) == {"report.html", "certificate.specimen.xml"}


@pytest.mark.slow
def test_a_report_on_paper(session: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("typst", reason="the extra 'pdf' is not installed")
    assert report(session, pdf=True) == ExitStatus.PASS
    assert "report.pdf" in verified(session, capsys, ExitStatus.PASS)["compared"]
    flip(session / "report.pdf", 5000)
    assert changed(verified(session, capsys, ExitStatus.SESSION_DAMAGED)) == {"report.pdf"}
    monkeypatch.setitem(sys.modules, "typst", None)
    document = verified(session, capsys, ExitStatus.PASS)
    assert any("report.pdf is not compared" in note for note in document["notes"])
    assert "report.pdf" not in document["compared"]


def test_a_report_with_a_laboratory_is_written_again_from_the_session_alone(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The session keeps the file; the same file gives the same bytes, and verification draws the page with it."""
    laboratory = ROOT / "docs" / "laboratory.yaml"
    plain = (session / "report.html").read_bytes()
    assert report(session, laboratory=laboratory) == ExitStatus.PASS
    stated = (session / "report.html").read_bytes()
    assert b"Example Calibration Laboratory" in stated
    assert (session / "laboratory.yaml").read_bytes() == laboratory.read_bytes()
    assert report(session) == ExitStatus.PASS
    assert (session / "report.html").read_bytes() == stated
    assert verify(session, False) == ExitStatus.PASS
    assert "identical" in capsys.readouterr().out
    (session / "laboratory.yaml").unlink()
    assert report(session) == ExitStatus.PASS
    assert (session / "report.html").read_bytes() == plain


def test_days_of_a_laboratory_that_contradict_a_real_session_are_named(
    session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    laboratory = tmp_path / "own.yaml"
    laboratory.write_text((ROOT / "docs" / "laboratory.yaml").read_text() + '\nreceived: "2000-01-02"\n')
    monkeypatch.setattr(ReportModel, "simulated", False)
    error = refused("B-DCC-014", lambda: report(session, laboratory=laboratory))
    assert "received 2000-01-02" in str(error)
    assert not (session / "laboratory.yaml").exists()


def test_an_accreditation_that_does_not_cover_is_told(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    laboratory = tmp_path / "own.yaml"
    scope = "{quantity: dsf_n, range: [-1 %, 1 %], cmc: 1 ppm, method: scale_factor}"
    own = f"\naccreditation: {{body: Example Body, number: EX-0, scope: [{scope}]}}\n"
    laboratory.write_text((ROOT / "docs" / "laboratory.yaml").read_text() + own)
    assert report(session, laboratory=laboratory) == ExitStatus.PASS
    assert "not stated under the accreditation (B-DCC-017): nothing real was measured" in capsys.readouterr().err
