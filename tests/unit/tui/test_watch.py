"""What is remembered of a run that is watched: age, silence, a process that answers anew, and how it ended."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
from record_sample import write_sample
from top_sample import NOW_S, FakeFeed, Gone, SetClock, document

from bench.record.writer import OPEN_MARKER
from bench.tui.ending import ending
from bench.tui.look import Look, catalogue
from bench.tui.page import page_of
from bench.tui.watch import OLD_S, Watch

GOOD = {"outcome": {"error": None, "text": ""}}


class Rig:
    """A watch over a feed that can be silenced, and a session that can be over."""

    def __init__(self, **changes: Any) -> None:
        self.feed, self.clock = FakeFeed(document(**changes)), SetClock()
        self.end: dict[str, Any] | None = None
        self.watch = Watch(Path("/s"), self.feed, self.clock, lambda: self.end, Gone)


def test_points_are_asked_for_once() -> None:
    rig = Rig()
    rig.watch.look()
    assert rig.feed.asked == [0, 360]
    assert rig.watch.seen.last["bench.unit"] == pytest.approx(48.144, abs=1e-3)
    assert rig.watch.seen.trend.span_s == 3600.0


def test_a_short_silence_is_none_a_long_one_is_lost_and_an_answer_ends_it() -> None:
    rig = Rig()
    rig.feed.silent = True
    rig.clock.s = OLD_S - 0.1
    assert not rig.watch.look().lost
    rig.clock.s = OLD_S + 0.1
    assert rig.watch.look().lost
    assert rig.watch.seen.age_s == pytest.approx(OLD_S + 0.1)
    assert rig.watch.seen.document["state"] == "running"  # the last that was said; the page says LOST
    rig.feed.silent = False
    assert not rig.watch.look().lost
    assert rig.watch.seen.age_s == 0.0


def test_nobody_answers_the_first_time() -> None:
    feed = FakeFeed(document(), silent=True)
    with pytest.raises(Gone):
        Watch(Path("/s"), feed, SetClock(), lambda: None, Gone)


ACT = '{"what":"act","reason":"silent","text":"no heartbeat for 2.05 s, the limit is 2 s"}\n'


@pytest.mark.parametrize(
    ("diary", "words"),
    [
        ('{"what":"ready"}\n' + ACT, "The guard is making the bench safe: no heartbeat for 2.05 s, the limit is 2 s."),
        (ACT + '{"what":"safe","instruments":[]}\n', "The guard has made the bench safe: no heartbeat for 2.05 s,"),
        (ACT + '{"what":"unsafe","instruments":["supply"]}\n', "could NOT confirm that all is safe: supply."),
        (ACT + '{"what":"safe"}\n{"what":"ready"}\n', ""),  # of the part before the run was gone on with
        ("", ""),
    ],
)
def test_what_the_guard_of_a_lost_run_did(tmp_path: Path, diary: str, words: str) -> None:
    (tmp_path / "guard.jsonl").write_text(diary)
    feed, clock = FakeFeed(document()), SetClock()
    watch = Watch(tmp_path, feed, clock, lambda: None, Gone)
    feed.silent, clock.s = True, 60.0
    head = " ".join(" ".join(line.plain for line in page_of(watch.look(), Look(catalogue())).head).split())
    assert words in head
    assert ("guard" in head) == bool(words)
    feed.silent = False
    assert watch.look().guard is None


def test_another_process_answers() -> None:
    rig = Rig()
    rig.feed.document = document(boot_id="ffff", t_utc_s=NOW_S + 60.0)
    assert rig.watch.look().document["t_utc_s"] == NOW_S + 60.0
    assert rig.watch.look().document["boot_id"] == "ffff"


def test_a_session_that_is_closed_has_ended_and_is_not_asked_again() -> None:
    rig = Rig(holds={"kim": "door"})
    rig.feed.silent, rig.end, rig.clock.s = True, GOOD, 100.0
    found = rig.watch.look()
    assert (found.document["state"], found.lost) == ("ended", False)
    assert found.document["outcome"] == GOOD["outcome"]
    assert found.document["holds"] == {}
    asked = len(rig.feed.asked)
    assert rig.watch.look().document["state"] == "ended"
    assert len(rig.feed.asked) == asked


def test_what_is_drawn_does_not_change_under_the_drawing() -> None:
    rig = Rig()
    before = rig.watch.look()
    kept = dict(before.trend.buckets)
    rig.watch.look().trend.add(NOW_S + 30.0, 1.0, 2.0)
    rig.clock.s = 9.0
    rig.feed.silent = True
    assert rig.watch.look().lost
    assert before.trend.buckets == kept
    assert not before.lost


def test_how_a_session_ended(tmp_path: Path) -> None:
    write_sample(tmp_path / "s", seconds=2)
    assert ending(tmp_path / "s") == {"outcome": None}  # closed, but it does not say how
    (tmp_path / "s" / OPEN_MARKER).touch()
    assert ending(tmp_path / "s") is None
    assert ending(tmp_path / "none") is None


def test_a_golden_session_ended_well(tmp_path: Path) -> None:
    golden = Path(__file__).resolve().parents[2] / "golden" / "sessions"
    folder = next(golden.glob("*/*/session.0001.mcap")).parent
    shutil.copytree(folder, tmp_path / "s")
    assert ending(tmp_path / "s") == GOOD
