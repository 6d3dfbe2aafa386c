"""What a bench tells of its runs: one that begins is given a moment, one that is over says how it ended."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from top_sample import SetClock

from bench.web.fleet.overview import BEGIN_S, MOST_RUNS, Overview, newest_over, over_card
from bench.web.recorded.listing import session_row
from bench.web.telemetry import SeenRun

NAME = "20260301T000000Z_scale_factor_7"
LOST = {"run": NAME, "state": "lost", "attention": "much", "bench": {"state": "unknown"}, "guard": None}


class Lookout:
    """Sees what it is told to see."""

    def __init__(self, *seen: SeenRun) -> None:
        self.seen = seen

    async def runs(self, *, fitted: bool) -> tuple[SeenRun, ...]:
        assert not fitted, "nobody who looks at many benches asks for fits"
        return self.seen


@pytest.fixture
def clock() -> SetClock:
    return SetClock()


@pytest.fixture
def make(tmp_path: Path, clock: SetClock) -> Callable[..., tuple[Overview, Lookout]]:
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


def test_a_run_that_begins_is_no_alarm_for_a_moment(make: Callable[..., Any], clock: SetClock) -> None:
    overview, lookout = make(SeenRun(LOST))
    for at_s, word, attention in ((0.0, "connecting", "none"), (BEGIN_S, "connecting", "none"), (5.1, "lost", "much")):
        clock.s = at_s
        card = look(overview)["runs"][NAME]
        assert (card["state"], card["attention"], card["outputs"]) == (word, attention, "unknown")
    lookout.seen = (SeenRun({**LOST, "state": "running", "attention": "none"}, age_s=0.0),)
    assert look(overview)["runs"][NAME]["state"] == "running"
    lookout.seen = (SeenRun(LOST, age_s=4.0),)  # it has answered before
    assert look(overview)["runs"][NAME]["state"] == "lost"
    lookout.seen = (SeenRun({**LOST, "state": "stopped"}),)  # its process is gone
    assert look(overview)["runs"][NAME]["state"] == "stopped"


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
    over = {"run": NAME, "title": "x", "state": "ended", "session": {"outcome": outcome}}
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
    assert over_card({"run": NAME, "state": "ended"})["outcome"] is None


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
