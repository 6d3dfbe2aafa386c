"""``bench top``: what is known of a run that is watched, how each state is drawn, and the view as a person meets it."""

import asyncio
import os
import shutil
import sys
from collections.abc import Callable, Coroutine
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from record_sample import write_sample
from rich.cells import cell_len
from textual.pilot import Pilot
from top_sample import ALARM, ESTIMATES, NOW_S, PROMPT, SEEN_AND_OVER, START_S, FakeFeed, Gone, SetClock, document

from bench.commands import top as command
from bench.model.errors import ExitStatus, InputError
from bench.model.texts import Texts
from bench.record.writer import OPEN_MARKER
from bench.run.control.client import FeedGone
from bench.tui import watch
from bench.tui.app import TopApp
from bench.tui.look import ASCII, UNICODE, Glyphs, Look, catalogue
from bench.tui.page import page_of, planned_degC
from bench.tui.watch import OLD_S, Seen, Trend, Watch, ending


class Rig:
    """A watch over a feed that can be silenced, and a session that can be over."""

    def __init__(self, **changes: Any) -> None:
        self.feed, self.clock = FakeFeed(document(**changes)), SetClock()
        self.end: dict[str, Any] | None = None
        self.watch = Watch(Path("/data/sessions/run"), self.feed, self.clock, lambda: self.end, Gone)


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


ACT = '{"what":"act","reason":"silent","text":"no heartbeat for 2.05 s, the limit is 2 s"}\n'


@pytest.mark.parametrize(
    ("diary", "words"),
    [
        (
            '{"what":"ready"}\n' + ACT,
            "The guard is switching the outputs off: no heartbeat for 2.05 s, the limit is 2 s.",
        ),
        (
            ACT + '{"what":"safe","instruments":[]}\n',
            "The guard has switched the outputs off, and confirmed it: no heartbeat for 2.05 s,",
        ),
        (ACT + '{"what":"unsafe","instruments":["supply"]}\n', "could NOT confirm that these are off: supply."),
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
    assert watch.look().document.get("guard") is None


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
    golden = next((Path(__file__).resolve().parents[2] / "golden" / "sessions").glob("*/*_golden_GOLDEN/*.mcap")).parent
    shutil.copytree(golden, tmp_path / "golden")
    found = ending(tmp_path / "golden")
    assert found is not None
    assert (found["outcome"]["error"], found["bench"]["state"], found["bench"]["unconfirmed"]) == (None, "off", {})
    write_sample(tmp_path / "s", seconds=2)
    found = ending(tmp_path / "s")  # closed, but it does not say how
    assert found is not None
    assert (found["outcome"], found["bench"]["state"]) == (None, "unknown")
    (tmp_path / "s" / OPEN_MARKER).touch()
    assert ending(tmp_path / "s") is None
    assert ending(tmp_path / "none") is None


class Runs:
    """Feeds by name of the folder; the others are gone."""

    def __init__(self) -> None:
        self.answering: dict[str, FakeFeed] = {}

    def client(self, folder: Path) -> Any:
        return SimpleNamespace(poll=lambda since, state=True: self._poll(folder, since))

    def _poll(self, folder: Path, since: int) -> Any:
        if folder.name not in self.answering:
            raise FeedGone("B-RUN-100", "no run of this session answers", where=str(folder))
        return self.answering[folder.name].poll(since)


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> Runs:
    found = Runs()
    monkeypatch.setattr(command, "FeedClient", found.client)
    monkeypatch.setattr(command, "WallClock", SetClock)
    return found


def folder(out: Path, name: str, age_s: int, pointer: str = "live.sock") -> Path:
    place = out / name
    place.mkdir()
    (place / pointer).touch()
    os.utime(place, (1_700_000_000 - age_s, 1_700_000_000 - age_s))
    return place


def test_the_newest_run_that_answers_is_shown_in_plain_text(
    runs: Runs, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, age_s in (("old", 300), ("older", 900), ("dead", 10)):
        folder(tmp_path, name, age_s, "live.path" if name == "old" else "live.sock")
    (tmp_path / "a_file").touch()
    runs.answering = {"old": FakeFeed(document(sequence="this_one")), "older": FakeFeed(document(sequence="not_this"))}
    command.top(None, tmp_path)
    said = capsys.readouterr().out
    assert "RUNNING  this_one NGU 17" in said
    assert "48.2 degC, +0.4 degC/min" in said
    assert "switch ERROR" in said
    assert "\x1b" not in said


@pytest.mark.parametrize("named", [True, False])
def test_no_run_answers(runs: Runs, tmp_path: Path, named: bool) -> None:
    place = folder(tmp_path, "dead", 1)
    with pytest.raises(InputError) as caught:
        command.top(place if named else None, tmp_path)
    assert caught.value.code == "B-TUI-001"
    assert caught.value.exit_status == ExitStatus.BAD_INPUT
    assert str(place if named else tmp_path) in str(caught.value)


def test_a_run_that_its_guard_ended_says_so(runs: Runs, tmp_path: Path) -> None:
    (folder(tmp_path, "dead", 1) / "guard.jsonl").write_text(ACT + '{"what":"unsafe","instruments":["supply"]}\n')
    for named in (tmp_path / "dead", None):
        with pytest.raises(InputError, match=r"dead has acted .* NOT confirmed: supply;"):
            command.top(named, tmp_path)


def test_on_a_terminal_it_waits_for_a_run_to_appear(
    runs: Runs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shown: list[str] = []
    slept: list[float] = []

    def sleep(self: object, seconds: float) -> None:
        slept.append(seconds)
        if len(slept) == 3:
            folder(tmp_path, "late", 1)
            runs.answering = {"late": FakeFeed(document(sequence="late"))}

    monkeypatch.setattr(command.WallClock, "sleep", sleep, raising=False)
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    app = SimpleNamespace(run=lambda mouse: None)
    monkeypatch.setattr(command, "TopApp", lambda seen, *_: shown.append(seen.document["sequence"]) or app)
    command.top(None, tmp_path)
    assert (shown, slept) == (["late"], [1.0] * 3)
    assert "waiting for one to begin" in capsys.readouterr().out
    with pytest.raises(InputError, match="B-TUI-001"):
        command.top(tmp_path / "named", tmp_path)


@pytest.mark.parametrize(("term", "app"), [("xterm", True), ("dumb", False)])
def test_a_terminal_gets_the_view(
    runs: Runs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, term: str, app: bool
) -> None:
    shown: list[dict[str, Any]] = []
    monkeypatch.setattr(command, "TopApp", lambda *_: SimpleNamespace(run=lambda **how: shown.append(how)))
    monkeypatch.setattr(command, "_print", lambda *_: None)
    monkeypatch.setenv("TERM", term)
    for name in ("stdin", "stdout"):
        monkeypatch.setattr(sys, name, SimpleNamespace(isatty=lambda: True, encoding="utf-8", write=len, flush=len))
    folder(tmp_path, "one", 5)
    runs.answering = {"one": FakeFeed(document())}
    command.top(None, tmp_path)
    assert shown == ([{"mouse": False}] if app else [])


def test_the_hour_before_comes_from_the_trend(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Reader:
        def __init__(self, folder: Path) -> None:
            assert folder == tmp_path

        def window(self, names: list[str], t0_utc_s: float, t1_utc_s: float, n: int) -> Any:
            assert (names, t0_utc_s, t1_utc_s) == (["bench.unit"], NOW_S - 3600, NOW_S)
            times = np.array([NOW_S - 1800, NOW_S - 900])
            return SimpleNamespace(t_utc_s=times, low=np.array([[20.0], [np.nan]]), high=np.array([[21.0], [np.nan]]))

    monkeypatch.setattr(watch, "TrendReader", Reader)
    seen = Seen(document(), "")
    watch.remember_earlier(seen, tmp_path)
    assert list(seen.trend.buckets.values()) == [(20.0, 21.0)]


SIZES = {"terminal": (80, 24), "phone": (60, 20), "wide": (140, 50)}
Act = Callable[[Pilot[None], "Bench"], Coroutine[Any, Any, None]]


class Bench(Rig):
    """A feed, a clock and the view of them."""

    def __init__(self, **changes: Any) -> None:
        super().__init__(**changes)
        self.app = TopApp(self.watch.seen, Look(catalogue(), UNICODE), self.watch.look, self.fitted)

    async def fitted(self) -> dict[str, Any]:
        return ESTIMATES

    def screen(self) -> list[str]:
        """Every line that is on the screen now."""
        size = self.app.size
        strips = self.app.screen._compositor.render_strips()
        lines = ["".join(segment.text for segment in strip) for strip in strips]
        assert len(lines) <= size.height
        assert all(cell_len(line) <= size.width for line in lines)
        return [line.rstrip() for line in lines]


def show(bench: Bench, act: Act, size: str = "terminal") -> None:
    async def shown() -> None:
        async with bench.app.run_test(size=SIZES[size]) as pilot:
            await pilot.pause()
            await act(pilot, bench)

    asyncio.run(shown())


async def until(pilot: Pilot[None], bench: Bench, word: str) -> list[str]:
    """The screen, as soon as it shows a word; fails after some 20 rounds of half a second."""
    for _ in range(100):
        await pilot.pause(0.1)
        if any(word in line for line in bench.screen()):
            return bench.screen()
    raise AssertionError(f"{word} is not on the screen: {bench.screen()}")


@pytest.mark.parametrize("size", SIZES)
def test_what_goes_on_is_on_the_screen(size: str) -> None:
    async def act(pilot: Pilot[None], bench: Bench) -> None:
        text = "\n".join(bench.screen())
        assert all(word in text for word in ("HOLDING", "door opened", "port_b: adapter", "live")), text
        assert "q leave (the run goes on)" in " ".join(bench.screen()[-2:])

    show(Bench(state="holding", holds={"operator": "door opened"}, alarms=[ALARM]), act, size)


def test_the_end_of_a_run_stays_on_the_screen() -> None:
    async def act(pilot: Pilot[None], bench: Bench) -> None:
        bench.feed.silent, bench.end = True, {"outcome": {"error": "B-RUN-010", "text": "asked to stop"}}
        assert "B-RUN-010: asked to stop" in "\n".join(await until(pilot, bench, "ENDED WITH A FAULT"))
        asked = len(bench.feed.asked)
        await pilot.pause(1.2)
        assert bench.app.is_running
        assert "B-RUN-010: asked to stop" in "\n".join(bench.screen())
        assert bench.watch.seen.document["holds"] == {}
        assert len(bench.feed.asked) == asked

    show(Bench(holds={"kim": "door"}), act)


@pytest.mark.parametrize("key", ["q", "ctrl+c"])
def test_leaving_changes_nothing(key: str) -> None:
    async def act(pilot: Pilot[None], bench: Bench) -> None:
        await pilot.press(key)
        await pilot.pause()

    bench = Bench()
    show(bench, act)
    assert bench.app.return_code == 0
    assert not bench.app.is_running


TEXTS = catalogue()
HOLDS = {"interlock unit hot": "unit 71.2 degC, limit 70 degC"}
ENDED = {"state": "ended", "wait": None, "eta": None}
FAULT = {"error": "B-RUN-031", "text": "error B-RUN-031: chamber: 50 degC not reached. Next: check the chamber"}
OVER = {**ENDED, "outcome": {"error": None, "text": "done"}}
FAILED = {**ENDED, "outcome": FAULT}
STRANGE: dict[str, Any] = {
    "sequence": "Mätning № 5 — 校正 \x1b[31m±", "holds": {"kim": "x" * 300}, "state": "holding", "simulated": True,
    "log": [{"t_utc_s": NOW_S, "kind": "reading", "text": "a\x1b]0;pwned\x07b\tc\nd [bold]e[/bold] …"}],
}  # fmt: skip


def seen(**changes: Any) -> Seen:
    return Watch(Path("/data/s/run"), FakeFeed(document(**changes)), SetClock(), lambda: None, Gone).seen


def lines(
    what: Seen, glyphs: Glyphs = UNICODE, width: int = 80, local: bool = False, texts: Texts = TEXTS
) -> list[str]:
    page = page_of(what, Look(texts, glyphs, width, local))
    return [line.plain for line in (*page.head, *page.body)]


URGENT = {"holds": HOLDS, "prompt": PROMPT, "alarms": [ALARM, SEEN_AND_OVER]}
SAID: list[tuple[dict[str, Any], str]] = [
    ({}, "soak 50 degC  12:40 of 30:00  until 12:24:00Z"),
    ({}, "step 4123 of 9170"),
    ({}, " 38 %  412 of 765 records"),
    ({}, "ends 2026-11-19 11:26:40Z, between 11:10:00Z and 12:00:00Z"),
    ({}, "planned 40.00 degC  air 49.14 degC  unit 48.14 degC"),
    ({}, "38.20 to 48.14 degC"),
    ({}, "port_b lost  frames 99  CRC errors 3  lost 7"),
    ({}, "2 errors, last: -410,Query interrupted"),
    ({}, "412  11:53:20Z  50 degC channel 3 +10 mA"),
    (URGENT, "port_b: adapter pulled"),
    (URGENT, "99 ohm to 101 ohm"),
    (URGENT, "unit 71.2 degC, limit 70 degC"),
    (OVER, "every step was done"),
    (OVER, "/data/s/run"),
    (FAILED, "ENDED WITH A FAULT"),
    (FAILED, "B-RUN-031: chamber: 50 degC not reached"),
    (ENDED, "does not say how"),
    ({"simulated": True}, "SIMULATED"),
]


@pytest.mark.parametrize(("changes", "words"), SAID)
def test_what_is_known_is_said(changes: dict[str, Any], words: str) -> None:
    text = "\n".join(lines(seen(**changes), width=120))
    assert words in text
    assert ("SIMULATED" in text) is ("simulated" in changes)
    assert "long gone" not in text


@pytest.mark.parametrize("active", [True, False])
@pytest.mark.parametrize("by", [None, "kim"])
def test_an_alarm_stays_until_it_is_acknowledged_and_over(active: bool, by: str | None) -> None:
    acknowledged = None if by is None else {"by": by, "t_utc_s": NOW_S}
    text = "\n".join(lines(seen(alarms=[{**ALARM, "active": active, "acknowledged": acknowledged}])))
    assert ("adapter pulled" in text.partition("LINKS")[0]) == (active or by is None)
    assert ("seen by kim" in text) == (active and by is not None)


def test_text_of_a_run_cannot_steer_the_terminal() -> None:
    text = "\n".join(lines(seen(**STRANGE)))
    assert "\x1b" not in text
    assert "\x07" not in text
    assert "[bold]e[/bold] ..." in text
    assert "校正" in text
    assert "校正" not in "\n".join(lines(seen(**STRANGE), ASCII))


def test_planned_temperature_between_the_corners() -> None:
    table = {"t_utc_s": [0.0, 10.0, 10.0, 20.0], "temperature_degC": [20.0, 30.0, 40.0, 40.0]}
    assert [planned_degC(table, at) for at in (-1.0, 0.0, 5.0, 10.0, 15.0, 20.0, 21.0)] == [
        None, 20.0, 25.0, 40.0, 40.0, 40.0, None,
    ]  # fmt: skip
    assert planned_degC({}, 1.0) is None


def test_the_trend_forgets_what_is_older_than_an_hour() -> None:
    trend = Trend()
    for second in range(0, 9000, 10):
        trend.add(START_S + second, float(second), second + 1.0)
    assert trend.span_s == 3600.0
    known = [one for one in trend.ranges(60) if one is not None]
    assert len(known) == 60
    assert known[-1][1] == 8991.0
    assert known[0][0] >= 9000 - 3630
    assert len(trend.buckets) <= 121
