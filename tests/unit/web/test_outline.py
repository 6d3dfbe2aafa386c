"""What a page draws of a recording before it has its state is what the state says later."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from bench.web.recorded.past import Past
from bench.web.recorded.recording import RecordedState


@pytest.fixture(scope="module")
def past(tmp_path_factory: pytest.TempPathFactory) -> Past:
    return Past(tmp_path_factory.mktemp("cache"))


def test_the_outline_of_a_recording_agrees_with_its_state(past: Past, golden: Path) -> None:
    outline, final = past.outline(golden), past.final(golden)
    assert outline is not None
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
