"""The terminal view draws every state of a run: words, shapes, widths, what comes first, no control codes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from top_sample import ALARM, NOW_S, PROMPT, SEEN_AND_OVER, START_S, FakeFeed, Gone, SetClock, document

from bench.model.texts import Texts
from bench.tui.look import ASCII, UNICODE, Glyphs, Look, catalogue
from bench.tui.page import page_of
from bench.tui.tables import planned_degC
from bench.tui.watch import Seen, Trend, Watch

TEXTS = catalogue()
HOLDS = {"interlock unit hot": "unit 71.2 degC, limit 70 degC"}
ENDED = {"state": "ended", "wait": None, "eta": None}
FAULT = {"error": "B-RUN-031", "text": "error B-RUN-031: chamber: 50 degC not reached. Next: check the chamber"}
STATES: dict[str, dict[str, Any]] = {
    "starting": {"state": "starting", "step": None, "wait": None, "eta": None, "timetable": None},
    "running": {},
    "holding": {"state": "holding", "holds": HOLDS, "alarms": [ALARM]},
    "ending": {"state": "ending", "wait": None},
    "ended": {**ENDED, "outcome": {"error": None, "text": "done"}},
    "failed": {**ENDED, "outcome": FAULT},
    "stopped": {"state": "stopped"},
    "prompt": {"prompt": PROMPT},
    "strange": {
        "sequence": "Mätning № 5 — 校正 \x1b[31m±", "holds": {"kim": "x" * 300}, "state": "holding", "simulated": True,
        "log": [{"t_utc_s": NOW_S, "kind": "reading", "text": "a\x1b]0;pwned\x07b\tc\nd [bold]e[/bold] …"}],
    },
    "bare": {"step": None, "wait": None, "eta": None, "links": None, "records": None, "instruments": None, "log": None,
             "timetable": None, "uut": None, "alarms": None, "holds": None, "signals": None, "t_utc_s": None,
             "progress": None},
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
    (STATES["ended"], "every step was done"),
    (STATES["ended"], "/data/s/run"),
    (STATES["failed"], "ENDED WITH A FAULT"),
    (STATES["failed"], "B-RUN-031: chamber: 50 degC not reached"),
    (ENDED, "does not say how"),
    ({"simulated": True}, "SIMULATED"),
]


@pytest.mark.parametrize(("changes", "words"), SAID)
def test_what_is_known_is_said(changes: dict[str, Any], words: str) -> None:
    text = "\n".join(lines(seen(**changes), width=120))
    assert words in text
    assert ("SIMULATED" in text) is ("simulated" in changes)
    assert "long gone" not in text


def test_lost_is_said_loudly_with_the_age_and_never_running() -> None:
    shown = seen()
    shown.lost, shown.age_s = True, 75.0
    page = page_of(shown, Look(TEXTS, UNICODE))
    head = " ".join(line.plain for line in page.head)
    assert "LOST" in head
    assert "NO ANSWER for 1:15" in head
    assert "RUNNING" not in head
    assert "live" not in head
    assert all("reverse" in str(line.style) for line in page.head[1:])


@pytest.mark.parametrize("active", [True, False])
@pytest.mark.parametrize("by", [None, "kim"])
def test_an_alarm_stays_until_it_is_acknowledged_and_over(active: bool, by: str | None) -> None:
    acknowledged = None if by is None else {"by": by, "t_utc_s": NOW_S}
    text = "\n".join(lines(seen(alarms=[{**ALARM, "active": active, "acknowledged": acknowledged}])))
    assert ("adapter pulled" in text.partition("LINKS")[0]) == (active or by is None)
    assert ("seen by kim" in text) == (active and by is not None)


def test_text_of_a_run_cannot_steer_the_terminal() -> None:
    text = "\n".join(lines(seen(**STATES["strange"])))
    assert "\x1b" not in text
    assert "\x07" not in text
    assert "[bold]e[/bold] ..." in text
    assert "校正" in text
    assert "校正" not in "\n".join(lines(seen(**STATES["strange"]), ASCII))


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
