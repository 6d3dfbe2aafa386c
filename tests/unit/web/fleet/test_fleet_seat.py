"""What is claimed of a bench: what it said, as long as it is heard; UNKNOWN from then on, never what it was."""

from __future__ import annotations

import json
from typing import Any

import pytest
from top_sample import SetClock

from bench.web.fleet.fleet_file import FleetBench
from bench.web.fleet.seat import CONNECTING, SILENT, SILENT_S, NotUnderstood, Seat

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
