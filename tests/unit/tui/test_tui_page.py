"""The terminal view draws every state of a run: words, shapes, widths, what comes first, no control codes."""

from __future__ import annotations

import re
import string
import unicodedata
from pathlib import Path
from typing import Any

import pytest
from rich.cells import cell_len
from top_sample import ALARM, NOW_S, PROMPT, SEEN_AND_OVER, START_S, FakeFeed, Gone, SetClock, document

from bench.model.texts import Texts
from bench.tui.folding import cut, folded, joined
from bench.tui.look import ASCII, UNICODE, Glyphs, Look, catalogue, duration, glyphs_for
from bench.tui.page import STYLES, page_of
from bench.tui.tables import axis, planned_degC, plot
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


@pytest.mark.parametrize("glyphs", [ASCII, UNICODE], ids=["ascii", "unicode"])
@pytest.mark.parametrize("width", [40, 60, 80, 200])
@pytest.mark.parametrize("state", STATES)
def test_every_line_fits_and_holds_nothing_of_ambiguous_width(state: str, width: int, glyphs: Glyphs) -> None:
    shown = seen(**STATES[state])
    for lost in (False, True):
        shown.lost = lost
        for line in lines(shown, glyphs, width):
            assert cell_len(line) <= width, line
            assert line.isprintable(), line
            assert not [one for one in line if unicodedata.east_asian_width(one) == "A"], line
            assert glyphs.braille or line.isascii(), line


@pytest.mark.parametrize("width", [40, 80])
@pytest.mark.parametrize("state", STATES)
def test_korean_lines_fit_with_letters_of_two_columns(state: str, width: int) -> None:
    for line in (shown := lines(seen(**STATES[state]), UNICODE, width, texts=catalogue("ko"))):
        assert cell_len(line) <= width, line
        assert not [one for one in line if unicodedata.east_asian_width(one) == "A"], line
    assert any("\uac00" <= letter <= "\ud7a3" for letter in "".join(shown))


@pytest.mark.parametrize("state", ["starting", "running", "holding", "ending", "ended", "failed", "stopped"])
def test_a_state_is_a_word_a_shape_and_a_colour(state: str) -> None:
    head = page_of(seen(**STATES[state]), Look(TEXTS, UNICODE)).head[0]
    assert head.plain.startswith(f" {UNICODE.state(state)} {TEXTS(f'state.{state}')} ")
    assert head.spans[0].style == STYLES[state]


def test_words_shapes_and_colours_tell_states_apart() -> None:
    words = [TEXTS(f"state.{state}") for state in STYLES]
    assert len(set(words)) == len(STYLES)
    for glyphs in (ASCII, UNICODE):
        assert set(glyphs.states) == set(STYLES)
        shapes = [shape for state, shape in glyphs.states.items() if state != "stopped"]
        assert len(set(shapes)) == len(shapes)


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


def test_a_wait_is_shown_as_a_wait() -> None:
    text = "\n".join(lines(seen()))
    assert "soak 50 degC  12:40 of 30:00  until 12:24:00Z  last 48.2 degC, +0.4 degC/min" in text
    assert "step 4123 of 9170" in text
    assert " 38 %  412 of 765 records" in text
    assert "ends 2026-11-19 11:26:40Z, between 11:10:00Z and 12:00:00Z" in text


def test_temperatures_planned_air_and_unit_with_their_unit() -> None:
    text = "\n".join(lines(seen()))
    assert "planned 40.00 degC  air 49.14 degC  unit 48.14 degC" in text
    assert "last 1:00:00: 38.20 to 48.14 degC" in text


def test_the_most_important_comes_first_and_old_alarms_go() -> None:
    found = lines(seen(holds=HOLDS, prompt=PROMPT, alarms=[ALARM, SEEN_AND_OVER]))
    order = ["prompt", "holds", "alarms", "temperature", "links", "records", "instruments", "log"]
    at = [found.index(TEXTS(f"section.{name}")) for name in order]
    assert at == sorted(at)
    text = "\n".join(found)
    assert "port_b: adapter pulled" in text
    assert "long gone" not in text
    assert "a value in ohm, 99 ohm to 101 ohm" in text
    assert "unit 71.2 degC, limit 70 degC" in text


@pytest.mark.parametrize("active", [True, False])
@pytest.mark.parametrize("by", [None, "kim"])
def test_an_alarm_stays_until_it_is_acknowledged_and_over(active: bool, by: str | None) -> None:
    acknowledged = None if by is None else {"by": by, "t_utc_s": NOW_S}
    text = "\n".join(lines(seen(alarms=[{**ALARM, "active": active, "acknowledged": acknowledged}])))
    assert ("adapter pulled" in text.partition("LINKS")[0]) == (active or by is None)
    assert ("seen by kim" in text) == (active and by is not None)


def test_links_and_instruments_say_what_is_wrong() -> None:
    found = lines(seen(), width=120)
    assert any("port_b lost  frames 99  CRC errors 3  lost 7  0.0 Hz  last 1:01 ago" in one for one in found)
    assert any("calibrator ok  2.0 s ago  41 ms  > OUT? < 1.0E-02,A" in one for one in found)
    assert any("2 errors, last: -410,Query interrupted" in one for one in found)
    assert any("412  11:53:20Z  50 degC channel 3 +10 mA" in one for one in found)


def test_the_end_of_a_run_and_how() -> None:
    good = "\n".join(lines(seen(**STATES["ended"])))
    assert "every step was done" in good
    assert "/data/s/run" in good
    assert "ends" not in good
    bad = "\n".join(lines(seen(**STATES["failed"])))
    assert "ENDED WITH A FAULT" in bad
    assert "B-RUN-031: chamber: 50 degC not reached" in bad
    assert "does not say how" in "\n".join(lines(seen(**ENDED)))


@pytest.mark.parametrize("simulated", [True, False])
def test_a_simulated_run_has_its_band(simulated: bool) -> None:
    assert ("SIMULATED" in lines(seen(simulated=simulated))[0]) is simulated


def test_text_of_a_run_cannot_steer_the_terminal() -> None:
    text = "\n".join(lines(seen(**STATES["strange"])))
    assert "\x1b" not in text
    assert "\x07" not in text
    assert "[bold]e[/bold] ..." in text
    assert "校正" in text
    assert "校正" not in "\n".join(lines(seen(**STATES["strange"]), ASCII))


def test_local_time_on_demand(monkeypatch: pytest.MonkeyPatch) -> None:
    import time

    monkeypatch.setenv("TZ", "KST-9")
    time.tzset()
    try:
        assert "2026-11-18 21:06:40+09:00" in "\n".join(lines(seen(), local=True))
        assert "2026-11-18 12:06:40Z" in "\n".join(lines(seen()))
    finally:
        monkeypatch.undo()
        time.tzset()


@pytest.mark.parametrize(
    ("environment", "encoding", "unicode"),
    [
        ({"LANG": "en_GB.UTF-8", "TERM": "xterm-256color"}, "utf-8", True),
        ({"LC_ALL": "C.UTF-8", "TERM": "screen"}, "utf-8", True),
        ({"LANG": "ko_KR.utf8", "TERM": "xterm"}, "UTF-8", True),
        ({"LC_ALL": "C", "LANG": "en_GB.UTF-8", "TERM": "xterm"}, "utf-8", False),
        ({"LC_CTYPE": "C.UTF-8", "TERM": "xterm"}, "utf-8", False),  # as Python itself sets it in the locale C
        ({"LANG": "de_DE.ISO-8859-1", "TERM": "xterm"}, "iso-8859-1", False),
        ({"LANG": "en_GB.UTF-8", "TERM": "xterm"}, "ascii", False),
        ({"LANG": "en_GB.UTF-8", "TERM": "linux"}, "utf-8", False),
        ({"LANG": "en_GB.UTF-8"}, "utf-8", False),
        ({}, "", False),
    ],
)
def test_shapes_only_where_the_terminal_knows_them(environment: dict[str, str], encoding: str, unicode: bool) -> None:
    assert (glyphs_for(environment, encoding) is UNICODE) is unicode


def test_folding() -> None:
    assert [one.plain for one in folded("aa bb cc", 5)] == ["aa bb", "  cc"]
    assert [one.plain for one in folded("abcdefgh", 5)] == ["abc", "  def", "  gh"]
    assert [one.plain for one in joined(["a b", "", "c d", "e"], 8)] == ["a b  c d", "  e"]
    assert folded("", 5) == []
    assert cut("abcdef", 4) == "abc~"
    assert cut("校正校正", 5) == "校正~"


def test_durations() -> None:
    given = [0.04, 9.96, 59.4, 60.0, 3599.6, 3600.0, 90_061.0, -3.0, None]
    assert [duration(one) for one in given] == [
        "0.0 s", "10.0 s", "59 s", "1:00", "60:00", "1:00:00", "25:01:01", "0.0 s", "-",
    ]  # fmt: skip


def test_a_plot_is_drawn_between_least_and_greatest() -> None:
    rising = [(float(value), float(value)) for value in range(4)]
    assert plot(rising, 4, braille=False) == ["   *", "  * ", " *  ", "*   "]
    assert plot(rising, 1, braille=True) == ["\u2860\u280a"]
    assert plot([(0.0, 3.0), None], 4, braille=False) == ["* "] * 4
    assert plot([None], 1, braille=True) == [" "]
    assert axis([(20.0, 20.1), None]) == pytest.approx((19.8, 20.3))


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


def test_every_text_is_used_and_every_used_text_exists() -> None:
    folder = Path(__file__).resolve().parents[3] / "bench" / "tui"
    code = "\n".join(path.read_text(encoding="utf-8") for path in folder.glob("*.py"))
    asked = set(re.findall(r"""texts\(f?["']([a-z.A-Z]+)""", code)) | set(
        re.findall(r"""titled\(look, "([a-z.]+)""", code)
    )
    families = {key for key in asked if key.endswith(".")} | {"key.", "link.", "alarm.", "instrument.state.", "guard."}
    known = set(TEXTS.all)
    assert {key for key in asked if not key.endswith(".")} <= known
    assert {key for key in known - asked if not key.startswith(tuple(families))} == set()
    assert all(any(key.startswith(family) for key in known) for family in families)
    for text in TEXTS.all.values():
        assert all(name is None or name.isidentifier() for _, name, _, _ in string.Formatter().parse(text))
