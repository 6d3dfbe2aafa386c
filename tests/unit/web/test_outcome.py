"""The outcome of a session in the list: its seal, its last events and its results, and which of them counts."""

import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
from report_sample import unsound

from bench.record import OPEN_MARKER, SessionWriter
from bench.session.recorded_state import RecordedState
from bench.web.now import now_of, silent_row
from bench.web.recorded.listing import results_of, session_row
from bench.web.recorded.outcome import SessionOutcome, outcome_of
from bench.web.recorded.past import Past

SAFE = ("safe", {"failures": []})
END = {"steps": 3, "records": 1, "slip_s": 0.0, "overruns": 0, "retaken": 0, "lateness_ms": [0.0, 0.0, 0.0]}


def outcome(folder: Path) -> SessionOutcome:
    return outcome_of(folder, results_of(folder))


def judged(folder: Path, *verdicts: str, quality: str = "sound") -> SessionOutcome:
    """The outcome with other verdicts in the results than they have."""
    results = results_of(folder)
    first = results["estimates"][0]
    results["estimates"] = [
        {**(first if quality == "sound" else unsound(first, quality)), "verdict": verdict} for verdict in verdicts
    ]
    return outcome_of(folder, results)


def written(folder: Path, *events: tuple[str, Mapping[str, Any]]) -> Path:
    """A session with these last events."""
    with_seal = SessionWriter.create(folder, {"session": folder.name}, {}, t_mono_ns=0)
    for kind, fields in events:
        with_seal.event(kind, 1, fields)
    with_seal.close("done")
    return folder


def test_the_recording_that_was_not_touched(session: Path) -> None:
    found = outcome(session)
    assert (found.word, found.off) == ("not_judged", True)
    assert found.verdicts == {"none": len(results_of(session)["estimates"])}
    assert session_row(session)["outcome"] == asdict(found)


def test_the_worst_verdict_counts_and_a_pass_with_doubt_is_doubtful(session: Path) -> None:
    assert judged(session, "pass", "none").word == "pass"
    assert judged(session, "pass", "conditional_pass").word == "conditional_pass"
    assert judged(session, "pass", "fail").word == "fail"
    assert judged(session, "conditional_fail", "pass").word == "conditional_fail"
    assert judged(session, "indeterminate", "conditional_fail").word == "doubtful"
    for verdict in ("pass", "conditional_pass", "none"):
        assert judged(session, verdict, quality="doubtful").word == "doubtful"
    assert judged(session, "fail", quality="doubtful").word == "fail"


def test_a_recording_that_is_not_whole_is_damaged_and_says_why(session: Path) -> None:
    results, last = results_of(session), sorted(session.glob("session.*.mcap"))[-1]
    other = {**results, "provenance": {**results["provenance"], "session_sha256": "0" * 64}}
    (session / "results.json").write_text(json.dumps(other))
    assert (outcome(session).word, "another recording" in outcome(session).why) == ("damaged", True)
    (session / "results.json").unlink()
    assert outcome(session).word == "no_results"
    last.rename(last.with_name("session.0009.mcap"))
    assert (outcome(session).word, f"{last.name} is missing" in outcome(session).why) == ("damaged", True)
    last.with_name("session.0009.mcap").rename(last)
    os.truncate(last, last.stat().st_size // 2)
    assert outcome(session).word == "damaged"
    assert Past().final(session)["session"]["outcome"]["word"] == "damaged"


@pytest.mark.parametrize(("code", "word"), [("B-RUN-010", "stopped"), ("B-RUN-031", "fault")])
def test_what_ended_a_run_counts_before_its_results(tmp_path: Path, code: str, word: str) -> None:
    said = ("error", {"code": code, "text": f"error {code}: why"})
    folder = written(tmp_path / "x", said, SAFE, ("end", {**END, "error": code}))
    assert outcome_of(folder, {"estimates": [{"verdict": "pass"}]}) == SessionOutcome(
        word, f"error {code}: why", off=True
    )


def test_a_run_that_is_gone_is_stopped_or_ended_by_its_guard(session: Path) -> None:
    (session / OPEN_MARKER).touch()
    assert (outcome(session).word, outcome(session).off) == ("stopped", None)
    assert silent_row(session)["state"] == "stopped"
    assert silent_row(session)["now"]["bench"]["state"] == "unknown"
    lines = ['{"what":"act","text":"no heartbeat for 2 s","utc":"2026-01-01T00:00:00+00:00"}']
    lines += ['{"what":"safe","instruments":[],"utc":"2026-01-01T00:00:02+00:00"}']
    (session / "guard.jsonl").write_text("\n".join(lines) + "\n")
    assert outcome(session) == SessionOutcome("fault", "no heartbeat for 2 s", off=True)
    bench = silent_row(session)["now"]["bench"]
    assert (bench["state"], bench["confirmed_utc_s"]) == ("off", 1767225602.0)


def test_a_guard_that_acted_behind_the_end_has_the_last_word(tmp_path: Path) -> None:
    """The recording was closed with everything confirmed; then the controller hung, and its guard is not through."""
    folder = written(tmp_path / "x", SAFE, ("end", {**END, "error": None}))
    assert outcome_of(folder, {}).off is True
    past = Past()
    before = past.final(folder)
    assert "guard" not in before
    diary = folder / "guard.jsonl"
    diary.write_text('{"what":"act","text":"no heartbeat for 2 s","utc":"2026-01-01T00:00:00+00:00"}\n')
    final = past.final(folder)  # read again, because its guard has written
    assert (outcome_of(folder, {}).off, final["bench"]["state"]) == (False, "unknown")
    assert (final["guard"]["safe"], final["session"]["outcome"]["off"]) == (None, False)
    diary.write_text(diary.read_text() + '{"what":"safe","instruments":[],"utc":"2026-01-01T00:00:02+00:00"}\n')
    os.utime(diary, ns=(0, 1))
    assert (past.final(folder)["bench"]["state"], outcome_of(folder, {}).off) == ("off", True)


def test_the_last_look_of_a_run_finds_everything_off(short: tuple[Path, Any]) -> None:
    bench = Past().final(short[0])["bench"]
    assert bench["state"] == "off"
    assert {part["state"] for part in bench["parts"]} == {"off"}
    assert bench["ended_utc_s"] - bench["confirmed_utc_s"] < 5.0


def test_a_card_shows_alarms_that_last_or_that_nobody_has_seen() -> None:
    alarm = {"id": "1", "severity": "alarm", "code": None, "text": "hot", "active": True, "acknowledged": None}
    over = {**alarm, "active": False, "acknowledged": {"by": "kim"}}
    card = now_of({"alarms": [alarm, over], "attention": "much", "prompt": {"text": "door?"}, "step": {"what": "soak"}})
    assert (card["alarm_count"], card["attention"], card["prompt"], card["what"]) == (1, "much", "door?", "soak")
    assert card["bench"]["state"] == "unknown"  # a run of another version says nothing of it


@pytest.fixture(scope="module")
def past(tmp_path_factory: pytest.TempPathFactory) -> Past:
    return Past(tmp_path_factory.mktemp("cache"))


def test_the_outline_of_a_recording_agrees_with_its_state(past: Past, golden: Path) -> None:
    outline, final = past.outline(golden), past.final(golden)
    assert outline["graphs"] == final["graphs"]
    assert outline["signals"] == final["signals"]
    span = outline["replay"]
    assert abs(span["first_utc_s"] - final["started_utc_s"]) <= 1.0
    assert abs(span["last_utc_s"] - final["t_utc_s"]) <= 1.5  # the trend ends with a whole second


def test_a_recording_without_a_trend_has_none(past: Past, golden: Path, tmp_path: Path) -> None:
    shutil.copy(golden / "session.0001.mcap", tmp_path)
    assert past.outline(tmp_path) is None


def test_the_end_that_is_known_is_the_end_that_would_be_made(past: Past, golden: Path) -> None:
    known = past.state(golden)
    recording = known.recording
    made = RecordedState(recording, known.scenery)
    assert known.at(recording.last_utc_s) == made.at(recording.last_utc_s)
    middle_s = (recording.first_utc_s + recording.last_utc_s) / 2
    assert known.at(middle_s) == made.at(middle_s)
    assert known.at(recording.last_utc_s) == made.at(recording.last_utc_s)
