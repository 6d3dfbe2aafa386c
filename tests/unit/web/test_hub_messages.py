"""What pages are sent: messages of a room, a recording shown like a living run, outcomes of sessions in the list."""

import asyncio
import json
import os
import shutil
import struct
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from record_sample import MANIFEST
from report_sample import unsound
from top_sample import T0, first_state

from bench.model.clock import NS, VirtualClock
from bench.model.events import Resume
from bench.record import SessionWriter
from bench.record.recover import resume_session
from bench.session.recorded_state import RecordedState, Recording, read_recording, scenery_of
from bench.web.now import now_of
from bench.web.points import KEPT, LastPoints, Points, binned, no_points
from bench.web.recorded import replaying
from bench.web.recorded.listing import results_of, session_row
from bench.web.recorded.outcome import SessionOutcome, outcome_of
from bench.web.recorded.past import Past
from bench.web.recorded.replaying import BLOCK, ReplayRun
from bench.web.room import LONGEST_QUEUE, Room, Viewer, merge_patch

UTC_S = 946_684_800
CHANNEL = {"channel": 1, "kind": "gyro"}


def applied(target: Any, patch: Any) -> Any:
    """MergePatch of RFC 7386, section 2, word for word."""
    if isinstance(patch, Mapping):
        target = dict(target) if isinstance(target, Mapping) else {}
        for name, value in patch.items():
            if value is None:
                target.pop(name, None)
            else:
                target[name] = applied(target.get(name), value)
        return target
    return patch


def known(document: Any) -> Any:
    """The document without its nulls, which are the same as nothing."""
    if isinstance(document, Mapping):
        return {key: known(value) for key, value in document.items() if value is not None}
    return document


LEAVES = st.none() | st.integers(-9, 9) | st.text(max_size=2) | st.lists(st.integers(0, 3), max_size=2)
DOCUMENTS = st.recursive(
    st.dictionaries(st.sampled_from("abc"), LEAVES, max_size=3),
    lambda inner: st.dictionaries(st.sampled_from("abc"), LEAVES | inner, max_size=3),
    max_leaves=8,
)


@given(DOCUMENTS, DOCUMENTS)
def test_a_patch_leads_from_any_document_to_any_other(old: dict[str, Any], new: dict[str, Any]) -> None:
    patch = merge_patch(old, new)
    assert known(applied(old, json.loads(json.dumps(patch)))) == known(new)
    assert (patch == {}) == (known(old) == known(new))


def test_a_batch_is_laid_out_as_documented() -> None:
    pairs = np.array([[[1, 2], [3, 4]], [[5, 6], [np.nan, np.nan]]], dtype=np.float32)
    batch = Points(2**32 + 7, np.array([T0, T0 + 0.1]), pairs).batch(1)
    assert struct.unpack_from("<IHH", batch) == (7, 2, 1)  # the number wraps as u32
    assert struct.unpack_from("<2d", batch, 8) == (T0, T0 + 0.1)
    assert struct.unpack_from("<7f", batch, 24)[:6] == (1, 2, 3, 4, 5, 6)
    assert len(batch) == 8 + 2 * 8 + 2 * 2 * 2 * 4


def points(first: int, count: int) -> Points:
    return Points(first, T0 + np.arange(first, first + count) / 10, np.zeros((count, 1, 2), dtype=np.float32) + first)


def test_the_last_minute_is_kept_and_no_more() -> None:
    kept = LastPoints(1)
    for first in range(0, 5000, 3):
        kept.add(points(first, 3))
    shown = kept.all()
    assert (len(shown), shown.stop) == (KEPT, 5001)
    assert np.all(np.diff(shown.t_utc_s) > 0.09)
    kept.add(points(7000, 4))  # points are missing before it
    assert (kept.all().first, len(kept.all())) == (7000, 4)
    assert len(LastPoints(3).all()) == 0
    assert LastPoints(3).all().pairs.shape == (0, 3, 2)


def test_points_of_a_width_hold_the_least_and_greatest_value_of_each_step() -> None:
    seed = 3
    values = np.random.default_rng(seed).normal(size=1000).astype(np.float32)[:, None]
    stamps = T0 + np.arange(1000) / 100 + 0.004
    found = binned(stamps, values, values, 0.1)
    assert np.allclose(found.t_utc_s, T0 + np.arange(1, 101) / 10, atol=1e-6)
    assert np.array_equal(found.pairs[:, 0, 0], values.reshape(100, 10).min(axis=1))
    assert np.array_equal(found.pairs[:, 0, 1], values.reshape(100, 10).max(axis=1))
    values[50:60] = np.nan
    assert np.isnan(binned(stamps, values, values, 0.1).pairs[5]).all()
    assert len(binned(np.zeros(0), values[:0], values[:0], 0.1)) == len(no_points(1)) == 0


def test_a_viewer_that_does_not_read_loses_what_waits_and_gets_a_snapshot() -> None:
    viewer = Viewer("viewer")
    assert viewer.stale
    viewer.put("dropped: the snapshot will hold it")
    assert viewer.take() is None
    viewer.start(["snapshot"])
    assert (viewer.take(), viewer.take()) == ("snapshot", None)
    for number in range(LONGEST_QUEUE):
        viewer.put(str(number))
    assert not viewer.stale
    viewer.put("one too many")
    assert viewer.stale
    assert viewer.take() is None, "all that waited is gone"


def test_everybody_in_a_room_is_told_the_same_and_only_what_changed() -> None:
    room = Room(first_state())
    watcher, boss = Viewer("viewer"), Viewer("operator")
    room.viewers |= {watcher, boss}
    for viewer in (watcher, boss):
        viewer.start(room.snapshot(viewer))
    heads = [json.loads(str(viewer.take())) for viewer in (watcher, boss)]
    assert [head["state"]["role"] for head in heads] == ["viewer", "operator"]
    assert {head["seq"] for head in heads} == {0}
    assert [viewer.take() for viewer in (watcher, boss)] == [bytes(8)] * 2, "no points yet"
    room.change(progress=0.2, wait={"reason": "soak"}, step=None)
    room.change(progress=0.2)
    delta = {"type": "delta", "seq": 1, "patch": {"step": None, "progress": 0.2, "wait": {"reason": "soak"}}}
    assert json.loads(str(watcher.take())) == delta
    assert json.loads(str(boss.take())) == delta
    assert watcher.take() is None, "what did not change is not sent"
    assert json.loads(str(room.snapshot(watcher)[0]))["seq"] == 1


def record(number: int, t_s: float) -> dict[str, Any]:
    times = {"t_start_ns": round((t_s - 100) * NS), "t_end_ns": round(t_s * NS)}
    return {"number": number, "link": "port_a", "first_counter": number * 10_000, "frames": 10_000, "step": -1,
            "conditions": CHANNEL, **times}  # fmt: skip


def write_session(folder: Path, *, ends: bool = True) -> None:
    """1000 s: a reading of the meter each 10 s, a record each 100 s."""
    writer = SessionWriter.create(folder, MANIFEST, {"plan.json": "[]"}, t_mono_ns=5 * NS)
    writer.clock_pair(5 * NS, (UTC_S + 5) * NS)
    for second in range(10, 1001, 10):
        t_ns = second * NS
        writer.command("dmm", "tx", f"READ? {second}", t_ns)
        writer.command("dmm", "rx", f"{second}.0", t_ns + NS // 100)
        if second % 100 == 0:
            writer.event("record", t_ns, record(second // 100, second))
        writer.tick(t_ns)
    if ends:
        writer.event("end", 1000 * NS + 1, {"error": None})
    writer.close("done")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    folder = tmp_path_factory.mktemp("sessions") / "20000101T000000Z_x_1"
    write_session(folder)
    return read_recording(folder)


def test_the_messages_are_on_the_axis_of_utc(recorded: Recording) -> None:
    assert recorded.first_utc_s == UTC_S + 10
    assert recorded.last_utc_s == pytest.approx(UTC_S + 1000.01)
    assert recorded.until(UTC_S + 9.9) == 0
    assert recorded.until(UTC_S + 10) == 1
    assert recorded.until(UTC_S + 10.01) == 2
    assert recorded.until(UTC_S + 2e9) == len(recorded.messages) == 212  # 200 lines, 10 records, end and closed


@pytest.mark.parametrize("ahead_s", [5000, -5000])
def test_the_part_after_a_resume_has_its_own_utc_and_a_clock_that_went_back_its_own_lengths(
    tmp_path: Path, ahead_s: int
) -> None:
    folder = tmp_path / "s"
    write_session(folder, ends=False)
    last_s = read_recording(folder).last_utc_s
    writer = resume_session(folder, Resume(reason="power"), t_mono_ns=3 * NS)
    writer.clock_pair(3 * NS, (UTC_S + ahead_s) * NS)  # another boot: its clock begins anew
    writer.command("dmm", "tx", "READ? again", 13 * NS)
    writer.close("done")
    found = read_recording(folder)
    again = next(index for index, one in enumerate(found.messages) if b"again" in one.payload)
    due_s = UTC_S + ahead_s + 10 if ahead_s > 0 else last_s + 10.0
    assert found.t_utc_s[again] == pytest.approx(due_s, abs=1e-3)
    assert found.t_utc_s == sorted(found.t_utc_s)


def state_of(recorded: Recording) -> RecordedState:
    return RecordedState(recorded, scenery_of(recorded))


def test_the_state_is_that_of_the_moment_forward_and_back(recorded: Recording, tmp_path: Path) -> None:
    state = state_of(recorded)
    ended = state.at(recorded.last_utc_s)
    assert (ended["state"], ended["outcome"]["error"], ended["records"]["done"]) == ("ended", None, 10)
    middle = state.at(UTC_S + 455.0)
    assert middle["outcome"] is None
    assert middle["records"]["done"] == 4
    assert (middle["instruments"]["dmm"]["command"], middle["instruments"]["dmm"]["reply"]) == ("READ? 450", "450.0")
    assert middle["instruments"]["dmm"]["answer_ms"] == pytest.approx(10.0, abs=0.01)
    assert state.at(recorded.last_utc_s) == ended
    assert state_of(recorded).at(UTC_S + 455.0) == middle
    write_session(tmp_path / "s", ends=False)
    state = state_of(read_recording(tmp_path / "s"))
    assert [state.at(UTC_S + later_s)["state"] == "stopped" for later_s in (455.0, 2000.0)] == [False, True]


class Stage:
    """A replay on a clock that a test moves; its points carry the second they belong to."""

    def __init__(self, recorded: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
        self.clock = VirtualClock()
        self.fetched: list[tuple[float, float, float]] = []
        self.replay = ReplayRun(state_of(recorded), self.fetch, self.work, self.clock, lambda: {"operator": None})
        self.viewer = Viewer("viewer")
        self.replay.room.viewers.add(self.viewer)
        self.seen: list[Any] = []
        monkeypatch.setattr(replaying, "pause", self.pause)
        self.ticks = 0
        self.script: dict[int, dict[str, Any]] = {}

    def fetch(self, t0: float, t1: float, width: float) -> Points:
        self.fetched.append((t0, t1, width))
        stamps = np.arange(np.ceil(t0 / width), t1 / width) * width
        return Points(0, stamps, np.zeros((len(stamps), 0, 2), dtype=np.float32))

    async def work(self, task: Callable[..., Any], *arguments: Any) -> Any:
        return task(*arguments)

    async def pause(self, seconds: float) -> None:
        self.clock.sleep(seconds)
        await asyncio.sleep(0)
        if self.viewer.stale and self.replay.room.state:
            self.viewer.start(self.replay.room.snapshot(self.viewer))
        while (message := self.viewer.take()) is not None:
            self.seen.append(json.loads(message) if isinstance(message, str) else message)
        self.ticks += 1
        if self.ticks in self.script:
            await self.replay.move(self.script[self.ticks])

    def play(self, ticks: int, script: dict[int, dict[str, Any]]) -> None:
        self.script = script

        async def follow() -> None:
            task = asyncio.ensure_future(self.replay.follow())
            while self.ticks < ticks and not task.done():
                await asyncio.sleep(0)
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

        asyncio.run(follow())

    def of(self, kind: str) -> list[dict[str, Any]]:
        return [one for one in self.seen if isinstance(one, dict) and one["type"] == kind]

    def stamps(self) -> list[float]:
        batches = [one for one in self.seen if isinstance(one, bytes)]
        return [stamp for one in batches for stamp in np.frombuffer(one, "<f8", (len(one) - 8) // 8, 8)]


@pytest.fixture
def stage(recorded: Recording, monkeypatch: pytest.MonkeyPatch) -> Stage:
    return Stage(recorded, monkeypatch)


def test_it_begins_at_the_end_and_stands(stage: Stage, recorded: Recording) -> None:
    stage.play(30, {})
    assert len(stage.of("snapshot")) == 1
    state = stage.of("snapshot")[0]["state"]
    last = recorded.last_utc_s
    cursor = {"first_utc_s": UTC_S + 10, "last_utc_s": last, "at_utc_s": last, "speed": 1, "playing": False}
    assert state["replay"] == cursor
    assert (state["source"], state["state"]) == ("replay", "ended")
    assert stage.of("delta") == []
    assert len(stage.of("heartbeat")) == 2, "one a second after the snapshot"
    assert len(stage.fetched) == 1


def test_played_from_the_end_it_begins_anew_in_real_time(stage: Stage) -> None:
    stage.play(62, {1: {"playing": True}})
    assert stage.of("snapshot")[-1]["state"]["replay"]["at_utc_s"] == UTC_S + 10
    last = stage.of("delta")[-1]["patch"]["replay"]
    assert UTC_S + 15 < last["at_utc_s"] < UTC_S + 16.1
    fresh = [stamp for stamp in stage.stamps() if UTC_S + 10.05 < stamp < UTC_S + 100]
    assert np.allclose(np.diff(fresh), 0.1), "every point once, in order"
    assert len(stage.fetched) <= 4, "fetched in blocks"


@pytest.mark.parametrize(("speed", "width"), [(10, 0.1), (100, 1.0), (1000, 10.0)])
def test_faster_points_are_wider_and_none_is_left_out(stage: Stage, speed: int, width: float) -> None:
    stage.play(6, {1: {"at_utc_s": UTC_S + 100, "speed": speed, "playing": True}})
    fresh = [stamp for stamp in stage.stamps() if UTC_S + 100 + width / 2 < stamp < UTC_S + 900]
    assert len(fresh) > 10
    assert np.allclose(np.diff(fresh), width)
    sizes = [(len(one) - 8) // 8 for one in stage.seen[-4:] if isinstance(one, bytes)]
    assert max(sizes) <= 11, "no more than a hundred points a second"
    assert all(t1 - t0 <= (600 + BLOCK) * width for t0, t1, _ in stage.fetched)


def test_it_stops_at_the_end(stage: Stage, recorded: Recording) -> None:
    stage.play(30, {1: {"at_utc_s": UTC_S + 900, "speed": 1000, "playing": True}})
    cursor = stage.of("delta")[-1]["patch"]["replay"]
    assert (cursor["at_utc_s"], cursor["playing"]) == (recorded.last_utc_s, False)
    assert stage.of("delta")[-1]["patch"]["state"] == "ended"


@pytest.mark.parametrize(
    "said",
    [{"speed": 7}, {"speed": True}, {"speed": "10"}, {"at_utc_s": float("nan")}, {"at_utc_s": "x"}, {"playing": 1}, {},
     {"speed": [1]}, {"at_utc_s": None}, {"at_utc_s": float("inf")}, {"at_utc_s": True}],
)  # fmt: skip
def test_what_makes_no_sense_is_not_done(stage: Stage, said: dict[str, Any]) -> None:
    stage.play(12, {1: said})
    assert len(stage.of("snapshot")) == 1
    assert stage.of("delta") == []


def test_a_cursor_stays_inside_the_recording(stage: Stage, recorded: Recording) -> None:
    stage.play(8, {1: {"at_utc_s": 0.0}, 4: {"at_utc_s": 10**400}})  # the second is held by no float
    _, begin, end = stage.of("snapshot")
    assert begin["state"]["replay"]["at_utc_s"] == UTC_S + 10
    assert begin["points"]["n"] <= 600
    assert end["state"]["replay"]["at_utc_s"] == recorded.last_utc_s


SAFE = ("safe", {"failures": []})
END = {"steps": 3, "records": 1, "slip_s": 0.0, "overruns": 0, "retaken": 0, "lateness_ms": [0.0, 0.0, 0.0]}


def outcome(folder: Path) -> SessionOutcome:
    return outcome_of(folder, results_of(folder))


def judged(folder: Path, *verdicts: str, quality: str = "sound", limit: float | None = None) -> SessionOutcome:
    """The outcome with other verdicts in the results than they have."""
    results = results_of(folder)
    first = results["estimates"][0] | {"limit": limit}
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
    assert judged(session, "pass", "fail", limit=2.0).why.endswith(" ppm, limit ± 2")
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
    assert (bench["state"], {part["state"] for part in bench["parts"]}) == ("off", {"off"})
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


def test_the_outline_of_a_recording_agrees_with_its_state_and_without_a_trend_there_is_none(
    past: Past, golden: Path, tmp_path: Path
) -> None:
    outline, final = past.outline(golden), past.final(golden)
    assert outline["graphs"] == final["graphs"]
    assert outline["signals"] == final["signals"]
    span = outline["replay"]
    assert abs(span["first_utc_s"] - final["started_utc_s"]) <= 1.0
    assert abs(span["last_utc_s"] - final["t_utc_s"]) <= 1.5  # the trend ends with a whole second
    shutil.copy(golden / "session.0001.mcap", tmp_path)
    assert past.outline(tmp_path) is None


def test_the_end_that_is_known_is_the_end_that_would_be_made(past: Past, golden: Path) -> None:
    known = past.state(golden)
    recording = known.recording
    made = RecordedState(recording, known.scenery)
    last_s, middle_s = recording.last_utc_s, (recording.first_utc_s + recording.last_utc_s) / 2
    for moment_s in (last_s, middle_s, last_s):
        assert known.at(moment_s) == made.at(moment_s)
