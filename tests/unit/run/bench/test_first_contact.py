"""The first contact with an instrument: what is tried in which order, what a record proves, and what it does not."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from bench.model.errors import InstrumentError
from bench.model.manual import Manual
from bench.model.ports import Identity
from bench.run.bench.first_contact import Tried, record_of, unproved, walk, write_record

WHO = Identity("MAKER", "M1", "7", "2.0")
MANUAL = Manual.model_validate(
    {
        "instrument": "A source",
        "sources": {"guide": "its guide"},
        "commands": {
            "OUTP ON": {"source": "guide", "touch": "energises", "try": "OUTP ON"},
            "FORM ASC": {"source": "guide", "touch": "sets", "try": "FORM ASC"},
            "VOLT?": {"source": "guide", "reply": "NUMBER", "try": "VOLT?"},
            "MODE? {n}": {"source": "guide", "state": "unconfirmed", "reply": "A|B", "try": "MODE? 1"},
            "ERR?": {"source": "guide", "state": "unconfirmed", "reply": "0", "try": "ERR?"},
            "READ?": {"source": "guide", "reply": "NUMBER"},
        },
    }
)


class Fake:
    """An instrument whose numbers are binary until it is told otherwise; ``said`` what it was sent."""

    def __init__(self, **replies: str) -> None:
        self.replies = {"VOLT?": "#14....", "MODE? 1": "A", "ERR?": "0", **replies}
        self.said: list[str] = []
        self.problems: list[str] = []

    def raw(self, command: str) -> str | None:
        self.said.append(command)
        if command == "FORM ASC":
            self.replies["VOLT?"] = "1.25E+00"
        if "?" in command and self.replies[command] == "mute":
            raise InstrumentError("B-INST-001", "no answer")
        return self.replies.get(command)

    def drain_errors(self) -> list[str]:
        found, self.problems = self.problems, []
        return found

    def make_safe(self) -> None:
        self.said.append("safe")


def outcomes(tried: list[Tried]) -> dict[str, str]:
    return {one.form: one.outcome for one in tried}


@pytest.mark.parametrize("answer", [True, False])
def test_harmless_commands_come_first_and_somebody_is_asked_before_the_output_is_on(answer: bool) -> None:
    fake, asked = Fake(), []

    def ask(text: str) -> bool:
        asked.append(text)
        return answer

    tried = walk(fake, MANUAL, ask, lambda one: None)
    dangerous = ["OUTP ON", "safe"] if answer else []
    assert fake.said == ["VOLT?", "MODE? 1", "ERR?", "FORM ASC", *dangerous, "VOLT?"]
    assert len(asked) == 1
    assert "OUTP ON" in asked[0]
    assert outcomes(tried) == {
        "VOLT?": "as documented", "MODE? {n}": "as documented", "ERR?": "as documented", "READ?": "not tried",
        "FORM ASC": "as documented", "OUTP ON": "as documented" if answer else "not tried",
    }  # fmt: skip


def test_what_differs_is_silent_or_refused_is_told() -> None:
    fake = Fake(**{"MODE? 1": "C", "ERR?": "mute"})
    seen: list[Tried] = []
    tried = walk(fake, MANUAL, lambda text: False, seen.append)
    assert outcomes(tried)["MODE? {n}"] == "differs"
    assert outcomes(tried)["ERR?"] == "no answer"
    fake.problems = ["-113 Undefined header"] * 3
    refused = walk(fake, MANUAL, lambda text: False, seen.append)[0]
    assert (refused.outcome, refused.said) == ("refused", "1.25E+00; -113 Undefined header (3 times)")
    assert len(seen) > len(tried)


def test_a_command_whose_answer_was_lost_is_tried_once_more() -> None:
    fake = Fake(**{"ERR?": "mute"})
    seen: list[Tried] = []

    def tell(one: Tried) -> None:
        seen.append(one)
        if one.form == "FORM ASC":
            fake.replies["ERR?"] = "0"

    tried = walk(fake, MANUAL, lambda text: False, tell)
    assert [one.outcome for one in seen if one.form == "ERR?"] == ["no answer", "as documented"]
    assert outcomes(tried)["ERR?"] == "as documented"
    assert fake.said.count("ERR?") == 2


@pytest.mark.parametrize(
    ("change", "left"),
    [
        ({}, []),
        ({"driver": "another"}, ["MODE? {n}", "ERR?"]),
        (
            {"identity": {"manufacturer": "MAKER", "model": "M1", "serial": "7", "firmware": "2.1"}},
            ["MODE? {n}", "ERR?"],
        ),
        ({"identity": {"manufacturer": "MAKER", "model": "M1", "serial": "8", "firmware": "2.0"}}, []),
    ],
)
def test_a_record_counts_for_its_driver_model_and_firmware(tmp_path: Path, change: dict[str, Any], left: Any) -> None:
    tried = walk(Fake(), MANUAL, lambda text: False, lambda one: None)
    record = record_of("source", "m1", WHO, "somebody", "2026-01-02T03:04:05Z", tried) | change
    written = record_of(
        "source", record["driver"], Identity(**record["identity"]), "somebody", "2026-01-02T03:04:05Z", tried
    )
    path = write_record(tmp_path / "station.yaml", written)
    assert unproved(tmp_path / "station.yaml", "m1", MANUAL, WHO) == left
    assert path.name == "source_20260102T030405Z.json"
    assert "| `MODE? {n}` | `MODE? 1` | `A` | `A\\|B` | as documented |" in path.with_suffix(".md").read_text()


def test_a_record_that_somebody_changed_proves_nothing(tmp_path: Path) -> None:
    tried = walk(Fake(**{"MODE? 1": "C"}), MANUAL, lambda text: False, lambda one: None)
    path = write_record(tmp_path / "station.yaml", record_of("source", "m1", WHO, "somebody", "2026-01-02Z", tried))
    assert unproved(tmp_path / "station.yaml", "m1", MANUAL, WHO) == ["MODE? {n}"]
    record = json.loads(path.read_text())
    for one in record["commands"]:
        one["outcome"] = "as documented"
    path.write_text(json.dumps(record))
    assert unproved(tmp_path / "station.yaml", "m1", MANUAL, WHO) == ["MODE? {n}", "ERR?"]
    path.write_text("[]")
    assert unproved(tmp_path / "station.yaml", "m1", MANUAL, WHO) == ["MODE? {n}", "ERR?"]
