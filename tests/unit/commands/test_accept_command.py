"""``--accept``: the value of a doubtful estimate is released, by name, for that value and those doubts alone."""

import dataclasses
import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rehearsal import Inside, writable_copy

from bench.analysis import Evidence
from bench.session import view as view_module
from bench.session.acceptances import new_acceptances

pytestmark = pytest.mark.usefixtures("without_pictures")

Say = Callable[..., tuple[int, str, str]]
CHANNEL = 1
WHO = ("--by", "A. Meyer", "--reason", "bench drift known")


def doubt(**more: Any) -> Evidence:
    return Evidence("lack_of_fit", "The levels do not lie on a line.", 3.0, 0.0, quantities=("dsf_n",), **more)


class Doubts:
    """What is held against every session that is analysed from now on."""

    def __init__(self) -> None:
        self.evidence = [doubt(conditions={"channel": CHANNEL})]


@pytest.fixture(autouse=True)
def doubts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Doubts:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    held, analyse = Doubts(), view_module.analyse

    def doubted(material: Any, method: str | None = None) -> Any:
        analysis = analyse(material, method)
        return dataclasses.replace(analysis, evidence=[*analysis.evidence, *held.evidence])

    monkeypatch.setattr(view_module, "analyse", doubted)
    return held


@pytest.fixture
def compensating(short: tuple[Path, Any], tmp_path: Path) -> Path:
    """A copy of a session of several temperatures: it gives coefficients."""
    folder = next(path.parent for path in short[0].rglob("results.json"))
    return writable_copy(folder, tmp_path / folder.name)


@pytest.fixture
def say(inside: Inside) -> Say:
    def said(*words: object) -> tuple[int, str, str]:
        done = inside(*map(str, words))
        return done.returncode, done.stdout, done.stderr

    return said


def segments(session: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(session.glob("*.mcap"))}


def of_channel(results: dict[str, Any]) -> list[dict[str, Any]]:
    return [entry for entry in results["estimates"] if entry["quality"] != "sound"]


def fitted(say: Say, session: Path) -> dict[str, Any]:
    return json.loads(say("fit", session, "--json")[1])


def test_an_accepted_value_is_in_coefficients_and_nothing_else_comes_back(say: Say, compensating: Path) -> None:
    before = segments(compensating)
    doubtful = of_channel(fitted(say, compensating))
    status, _, err = say("fit", compensating, "--accept", "dsf_n", *WHO)
    assert status == 1, err  # the value is accepted, and it stays doubtful
    assert segments(compensating) == before
    now = of_channel(fitted(say, compensating))
    accepted = {"by": "A. Meyer", "reason": "bench drift known"}
    assert now == [entry | {"acceptance": accepted} for entry in doubtful]
    assert {entry["verdict"] for entry in now} == {"indeterminate"}
    assert {entry["expanded_uncertainty"] for entry in now} == {None}
    assert of_channel(json.loads((compensating / "results.json").read_text())) == now
    written = json.loads((compensating / "coefficients.json").read_text())
    assert ("dsf_n", CHANNEL) in {(part["parameter"], part["channel"]) for part in written["parameters"]}
    assert ["accepted by A. Meyer" in sentence for sentence in written["sources"][0]["accepted"]] == [True]
    assert "ACCEPTED: channel 1: dsf_n is doubtful" in (compensating / "coefficients.h").read_text()
    assert "accepted" in (compensating / "report.html").read_text()
    status, out, err = say("report", compensating, "--verify")
    assert status == 0, out + err


def test_without_acceptance_coefficients_leave_it_out(say: Say, compensating: Path, tmp_path: Path) -> None:
    say("coefficients", compensating, "--out", tmp_path / "out")
    written = json.loads((tmp_path / "out" / "coefficients.json").read_text())
    assert ("dsf_n", CHANNEL) not in {(part["parameter"], part["channel"]) for part in written["parameters"]}
    assert "accepted" not in written["sources"][0]


def test_a_new_doubt_ends_it(say: Say, session: Path, doubts: Doubts) -> None:
    say("fit", session, "--accept", "dsf_n", *WHO)
    doubts.evidence.append(dataclasses.replace(doubts.evidence[0], code="another_doubt"))
    (session / "unrelated").touch()
    now = json.loads(say("fit", session, "--json", "--fresh")[1])
    assert not any("acceptance" in entry for entry in now["estimates"])
    assert now["notes"][0].startswith("The acceptance of dsf_n by A. Meyer holds no longer")


def test_a_refused_estimate_cannot_be_accepted(say: Say, session: Path, doubts: Doubts) -> None:
    doubts.evidence = [doubt(refuses=True)]
    status, _, err = say("report", session, "--accept", "dsf_n", *WHO)
    assert (status, "B-ACC-002" in err) == (2, True)
    assert not (session / "acceptances.json").exists()


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("--accept", "dsf_p", *WHO), "B-ACC-001"),
        (("--accept", "dsf_n channel=2", *WHO), "B-ACC-001"),
        (("--accept", "nonsense", *WHO), "B-ACC-001"),
        (("--accept", "dsf_n", "--by", "A. Meyer"), "B-ACC-003"),
        (("--by", "A. Meyer"), "B-ACC-003"),
    ],
)
def test_what_cannot_be_accepted(say: Say, session: Path, words: tuple[str, ...], code: str) -> None:
    status, _, err = say("fit", session, *words)
    assert (status, code in err) == (2, True), err
    assert not (session / "acceptances.json").exists()


def test_a_file_of_another_recording_counts_for_nothing(say: Say, session: Path) -> None:
    say("fit", session, "--accept", "dsf_n", *WHO)
    path = session / "acceptances.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"session_sha256": "another"}))
    status, out, err = say("fit", session)
    assert "acceptances.json is of another recording: nothing in it counts." in out + err
    assert status == 1
    assert not any("acceptance" in entry for entry in fitted(say, session)["estimates"])


@pytest.mark.parametrize("text", ["{", "{}", '{"schema": 1, "session_sha256": "a", "acceptances": [{}]}'])
def test_a_file_that_is_not_in_its_form_is_refused(say: Say, session: Path, text: str) -> None:
    (session / "acceptances.json").write_text(text)
    status, _, err = say("fit", session)
    assert (status, "B-ACC-004" in err) == (2, True)


def test_a_run_that_has_not_ended_is_not_accepted() -> None:
    with pytest.raises(Exception, match="has not ended"):
        new_acceptances({"session": "S", "incomplete": True, "estimates": []}, ["dsf_n"], "A", "because", 0)


def test_without_a_sound_estimate_there_is_no_certificate(say: Say, session: Path, doubts: Doubts) -> None:
    doubts.evidence = [dataclasses.replace(doubt(), quantities=())]
    (session / "results.json").write_text(say("fit", session, "--json")[1])
    status, _, err = say("certificate", session, "--specimen", "--out", session / "c.xml")
    assert (status, "B-DCC-015" in err) == (2, True), err
    assert not (session / "c.xml").exists()


def test_the_history_says_what_is_not_sound_and_why(say: Say, session: Path, tmp_path: Path) -> None:
    say("fit", session, "--accept", "dsf_n", *WHO)
    url = f"sqlite:///{tmp_path / 'history.sqlite'}"
    status, _, err = say("history", "import", session, "--history", url)
    assert status == 0, err
    listed = json.loads(say("history", "list", "--history", url, "--json")[1])
    (row,) = next(iter(listed.values()))
    assert (row["doubtful"] > 0, row["refused"], row["verdict"]) == (True, 0, "indeterminate")
    assert f"{row['doubtful']} doubtful" in " ".join(say("history", "list", "--history", url)[1].split())
    shown = say("history", "show", session.name, "--history", url)[1]
    assert f"DOUBTFUL, {row['doubtful']} estimate of dsf_n: The levels do not lie on a line." in " ".join(shown.split())
    assert "accepted" in shown
