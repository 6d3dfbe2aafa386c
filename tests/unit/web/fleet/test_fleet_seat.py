"""What is claimed of a bench: what it said, as long as it is heard; UNKNOWN from then on, never what it was."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from top_sample import SetClock

from bench.web.fleet.fleet_file import FleetBench
from bench.web.fleet.overview import BEGIN_S, MOST_RUNS, Overview, newest_over, over_card
from bench.web.fleet.seat import CONNECTING, SILENT, SILENT_S, NotUnderstood, Seat
from bench.web.recorded.listing import session_row
from bench.web.telemetry import SeenRun

RUN = "20260301T000000Z_scale_factor_7"
CARD = {
    "title": "Scale factor", "uut": {"model": "NGU", "serial": "7"}, "simulated": True, "state": "running",
    "attention": "none", "outputs": "energised", "progress": 0.5, "end_utc_s": 1.0, "alarm_count": 0, "alarms": [],
}  # fmt: skip


class Clock(SetClock):
    def utc_ns(self) -> int:
        return round((self.s + 1000.0) * 1e9)


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def seat(clock: Clock) -> Seat:
    return Seat(FleetBench("bench-1", "room 1", "fleet.yaml:2:5", "https://bench-1.example.org", "t"), clock)  # type: ignore[arg-type]


def said(*cards: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"proto": 1, "runs": {f"{RUN}{number}": card for number, card in enumerate(cards)}, **more}


def test_it_is_unknown_until_it_is_heard_and_when_it_is_not_heard_any_more(seat: Seat, clock: Clock) -> None:
    first = seat.card()
    assert (first["state"], first["attention"], first["why"]) == ("unknown", "much", CONNECTING)
    seat.hear(said(CARD))
    card = seat.card()
    assert (card["state"], card["attention"], card["progress"], card["run"]) == ("running", "none", 0.5, f"{RUN}0")
    clock.s = SILENT_S
    assert seat.card() is card
    seat.beat()
    clock.s += SILENT_S
    assert seat.card() is card
    clock.s += 0.001
    silent = seat.card()
    assert (silent["state"], silent["attention"], silent["why"]) == ("unknown", "much", SILENT)
    assert silent["heard_utc_s"] == 1000.0 + SILENT_S
    assert not {"progress", "outputs", "end_utc_s"} & set(silent)
    assert (silent["run"], silent["uut"]) == (f"{RUN}0", CARD["uut"])
    seat.beat()
    assert seat.card()["state"] == "running"


def test_a_line_that_breaks_makes_it_unknown_at_once(seat: Seat) -> None:
    seat.hear(said(CARD))
    seat.lose("unreached")
    assert (seat.card()["state"], seat.card()["why"], seat.card()["heard_utc_s"]) == ("unknown", "unreached", 1000.0)


def test_the_run_that_needs_somebody_most_stands_for_the_bench(seat: Seat) -> None:
    alarm = {"severity": "alarm", "code": None, "text": "door is open"}
    held = {**CARD, "state": "holding", "attention": "much", "alarm_count": 1, "alarms": [alarm]}
    seat.hear(said(CARD, held, {**CARD, "attention": "some"}))
    card = seat.card()
    assert (card["run"], card["state"], card["more"], card["alarms"]) == (f"{RUN}1", "holding", 2, [alarm])


@pytest.mark.parametrize(
    ("outputs", "worst"),
    [
        (("off", "energised"), "energised"), (("moving", "energised", "unknown"), "energised"),
        (("off", "moving", "unknown"), "moving"), (("unknown", "off"), "unknown"), (("off", "off"), "off"),
        (("off", None), "off"), (("off", "new_word"), "unknown"),
    ],
)  # fmt: skip
def test_the_worst_of_what_is_on_is_the_state_of_the_bench(
    seat: Seat, outputs: tuple[str | None, ...], worst: str
) -> None:
    for cards in (outputs, outputs[::-1]):
        needs = [{"attention": "much"}, {"attention": "none"}, {"attention": "some"}]
        seat.hear(said(*({**CARD, "outputs": word, **need} for word, need in zip(cards, needs, strict=False))))
        assert seat.card()["outputs"] == worst


def test_a_run_that_goes_on_stands_before_one_that_its_guard_has_put_away(seat: Seat) -> None:
    gone = {**CARD, "state": "stopped", "attention": "much", "outputs": "off", "guard": "too hot"}
    seat.hear(said(gone, CARD))
    card = seat.card()
    assert (card["run"], card["attention"], card["outputs"], card["more"]) == (f"{RUN}1", "none", "energised", 1)
    seat.hear(
        said({**gone, "outputs": "unknown", "unconfirmed": "calibrator (unreachable)"}, {**CARD, "outputs": "off"})
    )
    card = seat.card()
    assert (card["run"], card["attention"], card["outputs"]) == (f"{RUN}0", "much", "unknown")
    assert card["unconfirmed"] == "calibrator (unreachable)"


def test_a_session_that_ended_unconfirmed_behind_those_that_are_open_is_told(seat: Seat) -> None:
    gone = {**CARD, "state": "stopped", "attention": "much", "outputs": "off"}
    last = {"outcome": "fault", "off": False, "outputs": "unknown", "attention": "much"}
    seat.hear(said(gone, last={"run": f"{RUN}9", **last}))
    assert (seat.card()["run"], seat.card()["state"], seat.card()["outputs"]) == (f"{RUN}9", "idle", "unknown")
    for older in ({"run": "20200101T000000Z_x", **last}, {"run": f"{RUN}9", **last, "off": True, "outputs": None}):
        seat.hear(said(gone, last=older))
        assert (seat.card()["run"], seat.card()["outputs"], seat.card()["more"]) == (f"{RUN}0", "off", 0)


def test_without_a_run_nothing_is_claimed_of_its_outputs(seat: Seat) -> None:
    seat.hear(said())
    assert (seat.card()["state"], seat.card()["attention"]) == ("idle", "none")
    seat.hear(said(last={"run": RUN, "title": "x", "outcome": "fault", "off": False, "attention": "much"}))
    card = seat.card()
    assert (card["state"], card["attention"], card["outcome"], card["off"]) == ("idle", "much", "fault", False)
    assert card["outputs"] is None


@pytest.mark.parametrize("document", [None, [], "x", {}, {"proto": 2, "runs": {}}])
def test_another_protocol_is_not_understood(seat: Seat, document: object) -> None:
    with pytest.raises(NotUnderstood):
        seat.hear(document)
    assert seat.card()["state"] == "unknown"


@pytest.mark.parametrize(
    "runs",
    [
        {RUN: {**CARD, "progress": float("nan"), "end_utc_s": "soon", "alarm_count": True, "title": "\ud800" * 999}},
        {RUN: {"attention": "fine", "alarms": [1, {"text": ["x"]}], "uut": "NGU", "simulated": "no"}},
        {RUN: "running", "../x": CARD, 7: CARD},
        "running",
    ],
)
def test_whatever_a_bench_says_the_page_of_the_others_goes_on(seat: Seat, runs: object) -> None:
    seat.hear({"proto": 1, "runs": runs, "last": {"run": "..", "attention": 1}})
    text = json.dumps(seat.card(), allow_nan=False, ensure_ascii=False)
    assert len(text.encode()) < 4000
    assert seat.card()["attention"] in ("much", "none")
    assert ".." not in text


# --- what a bench tells of its runs ------------------------------------------------------------------------------

LOST = {"run": RUN, "state": "lost", "attention": "much", "bench": {"state": "unknown"}, "guard": None}


class Lookout:
    """Sees what it is told to see."""

    def __init__(self, *seen: SeenRun) -> None:
        self.seen = seen

    async def runs(self, *, fitted: bool) -> tuple[SeenRun, ...]:
        assert not fitted, "nobody who looks at many benches asks for fits"
        return self.seen


@pytest.fixture
def make(tmp_path: Path, clock: Clock) -> Callable[..., tuple[Overview, Lookout]]:
    async def work(task: Any, *arguments: Any) -> Any:
        return task(*arguments)

    def made(*seen: SeenRun, out: Path = tmp_path) -> tuple[Overview, Lookout]:
        hub = SimpleNamespace(serving=SimpleNamespace(out=out, clock=clock), work=work)
        lookout = Lookout(*seen)
        return Overview(hub, lookout), lookout  # type: ignore[arg-type]

    return made


def look(overview: Overview) -> dict[str, Any]:
    found = asyncio.run(overview.look())
    assert found is not None
    return found


def test_a_run_that_begins_is_no_alarm_for_a_moment(make: Callable[..., Any], clock: Clock) -> None:
    overview, lookout = make(SeenRun(LOST))
    for at_s, word, attention in ((0.0, "connecting", "none"), (BEGIN_S, "connecting", "none"), (5.1, "lost", "much")):
        clock.s = at_s
        card = look(overview)["runs"][RUN]
        assert (card["state"], card["attention"], card["outputs"]) == (word, attention, "unknown")
    lookout.seen = (SeenRun({**LOST, "state": "running", "attention": "none"}, age_s=0.0),)
    assert look(overview)["runs"][RUN]["state"] == "running"
    lookout.seen = (SeenRun(LOST, age_s=4.0),)  # it has answered before
    assert look(overview)["runs"][RUN]["state"] == "lost"
    lookout.seen = (SeenRun({**LOST, "state": "stopped"}),)  # its process is gone
    assert look(overview)["runs"][RUN]["state"] == "stopped"


def test_of_many_runs_those_that_need_somebody_are_told(make: Callable[..., Any]) -> None:
    seen = [
        SeenRun({**LOST, "run": f"r{number:03}", "state": "running", "attention": "none"}, age_s=0.0)
        for number in range(99)
    ]
    seen[0] = SeenRun({**LOST, "run": "r000", "state": "stopped"})
    assert list(look(make(*seen)[0])["runs"]) == [
        "r000",
        *(f"r{number:03}" for number in range(98, 98 - MOST_RUNS + 1, -1)),
    ]


def test_time_that_goes_on_is_no_news(make: Callable[..., Any]) -> None:
    told = []
    for t_utc_s in (1000.0, 1001.0):
        state = {**LOST, "state": "running", "t_utc_s": t_utc_s, "progress": 0.1 + 1e-6 * t_utc_s}
        state["eta"] = {"likely_utc_s": 7200.0 + t_utc_s}
        told.append(look(make(SeenRun(state, age_s=0.0))[0]))
    assert told[0] == told[1]


@pytest.mark.parametrize(
    ("outcome", "attention"),
    [
        ({"word": "pass", "off": True}, "none"),
        ({"word": "fail", "off": True}, "none"),
        ({"word": "pass", "off": None}, "none"),
        ({"word": "fault", "off": True}, "some"),
        ({"word": "damaged", "off": None}, "some"),
        ({"word": "pass", "off": False}, "much"),
    ],
)
def test_a_session_that_is_over_needs_somebody_if_it_did_not_end_well(
    make: Callable[..., Any], outcome: dict[str, Any], attention: str
) -> None:
    over = {"run": RUN, "title": "x", "state": "ended", "session": {"outcome": outcome}}
    overview, lookout = make(SeenRun(over))
    last = look(overview)["last"]
    assert (last["outcome"], last["off"], last["attention"]) == (outcome["word"], outcome["off"], attention)
    lookout.seen = ()  # ten minutes later
    assert look(overview) == {"proto": 1, "runs": {}, "last": last}


def test_after_a_start_the_newest_session_of_the_folder_is_told(make: Callable[..., Any], golden: Path) -> None:
    row = session_row(golden)
    last = look(make(out=golden.parent)[0])["last"]
    assert (last["run"], last["title"], last["uut"]) == (golden.name, row["title"], row["uut"])
    assert (last["outcome"], last["off"]) == (row["outcome"]["word"], row["outcome"]["off"])


def test_a_session_that_is_left_open_is_not_the_newest_that_is_over(tmp_path: Path) -> None:
    for name, is_open in (("20260101T000000Z_old_1", False), ("20260102T000000Z_open_1", True)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "session.0001.mcap").touch()
        if is_open:
            (tmp_path / name / "session.open").touch()
    last = newest_over(tmp_path)
    assert last is not None
    assert (last["run"], last["outcome"], last["attention"]) == ("20260101T000000Z_old_1", "damaged", "some")
    assert newest_over(tmp_path / "20260101T000000Z_old_1") is None
    assert over_card({"run": RUN, "state": "ended"})["outcome"] is None


def test_a_folder_that_is_gone_is_not_known_and_said_once(
    make: Callable[..., Any], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    overview, _ = make()
    look(overview)
    tmp_path.rmdir()
    with caplog.at_level(logging.ERROR):
        assert asyncio.run(overview.look()) is None
        assert asyncio.run(overview.look()) is None
    assert len(caplog.records) == 1
    tmp_path.mkdir()
    look(overview)
