"""Lists of runs and calibrations, history requests, partial fits; and no view says OUTPUTS OFF while that is not so."""

import asyncio
import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from record_sample import write_sample
from top_sample import MANIFEST, NOW_S, document, small_plan
from web_rig import RUN, Page, served

from bench.commands.progress import doing
from bench.model.clock import VirtualClock
from bench.model.events import event_of
from bench.record import OPEN_MARKER, SessionWriter
from bench.run.feed.bench_state import bench_in_words
from bench.run.feed.run_state import RunState
from bench.run.guard.diary import DIARY
from bench.run.guard.last_words import guard_lines
from bench.session import partial_fits
from bench.session.partial_fits import KEPT_IN_ALL, KEPT_PER_ROW, PartialFits, joined
from bench.tui.look import Look, catalogue
from bench.tui.page import page_of
from bench.tui.watch import Seen
from bench.web.now import now_of, silent_row
from bench.web.recorded.listing import READ_AT_ONCE, RunList, session_row
from bench.web.recorded.past import MOST_POINTS, HistoryQuery, Past, history_query
from bench.web.security.refusal import Refusal
from bench.web.telemetry import SeenRun, families

SAMPLE = "20260102T030405Z_sample_7"
GOOD = {"signals": "a.b,a.c,a.b", "t0": "1.5", "t1": "2.5", "n": "10"}


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with served(tmp_path_factory.mktemp("lists")) as found:
        write_sample(found.serving.out / SAMPLE, seconds=3)
        yield found


@pytest.mark.parametrize(
    "wrong",
    [{"signals": ""}, {"signals": ",".join(f"a.b[{index}]" for index in range(41))}, {"t0": "nan"}, {"t1": "inf"},
     {"t0": "x"}, {"t0": ""}, {"t1": "1.5"}, {"t1": "-3"}, {"n": "0"}, {"n": "-1"}, {"n": "1.5"}, {"n": "1e3"},
     {"n": "9" * 5000}, {"n": "٣"}],
)  # fmt: skip
def test_a_history_request_that_makes_no_sense_is_refused(wrong: dict[str, str]) -> None:
    query = history_query(GOOD)
    assert (query.signals, query.t0_utc_s, query.t1_utc_s, query.n) == (("a.b", "a.c"), 1.5, 2.5, 10)
    assert history_query({**GOOD, "n": "999999"}).n == MOST_POINTS
    with pytest.raises(Refusal) as refused:
        history_query({**GOOD, **wrong})
    assert (refused.value.code, refused.value.status) == ("B-WEB-020", 400)


def test_history_over_http_says_what_is_wrong(page: Page) -> None:
    for asked, code in (
        (f"{RUN}/history?signals=a.b&t0=2&t1=1", "B-WEB-020"),
        (f"{SAMPLE}/history?signals=port_a.nothing&t0=1&t1=2", "B-FRAME-024"),
    ):
        answer = page.ask("GET", f"/api/v1/runs/{asked}", page.cookie("viewer"))
        assert (answer.status, answer.json["error"]) == (400, code)


def test_a_session_without_a_report_says_so_and_one_that_leads_elsewhere_is_not_read(page: Page) -> None:
    answer = page.ask("GET", f"/api/v1/runs/{RUN}/report", page.cookie("viewer"))
    assert (answer.status, answer.json["error"]) == (404, "B-WEB-021")
    (page.serving.out / RUN / "report.html").write_text("<p>report")
    answer = page.ask("GET", f"/api/v1/runs/{RUN}/report", page.cookie("viewer"))
    assert (answer.status, answer.body) == (200, b"<p>report")
    assert "sandbox" in answer.headers["content-security-policy"]
    secret = page.serving.out.parent / "secret"
    secret.write_text("secret")
    (page.serving.out / SAMPLE / "report.html").symlink_to(secret)
    assert page.ask("GET", f"/api/v1/runs/{SAMPLE}/report", page.cookie("viewer")).status == 404


def test_a_pipe_or_a_link_in_a_session_holds_nobody_up(tmp_path: Path) -> None:
    with served(tmp_path) as page:
        out = page.serving.out
        os.mkfifo(out / RUN / "report.html")
        os.mkfifo(out / RUN / "results.json")
        for name, make in (
            ("pipe", os.mkfifo),
            ("link", lambda path: path.symlink_to(out / RUN / "session.0001.mcap")),
        ):
            (out / name).mkdir()
            (out / name / "session.0001.mcap").touch()
            make(out / name / "session.0002.mcap")
        listed = page.ask("GET", "/api/v1/runs", page.cookie("viewer")).json["runs"]
        assert [row["run"] for row in listed] == [RUN]
        for path in (f"{RUN}/report", "pipe", "link"):
            assert page.ask("GET", f"/api/v1/runs/{path}", page.cookie("viewer")).status == 404


def test_runs_are_listed_newest_first_and_one_that_cannot_be_read_says_so(page: Page) -> None:
    rows = page.ask("GET", "/api/v1/runs", page.cookie("viewer")).json["runs"]
    assert [row["run"] for row in rows] == [SAMPLE, RUN]
    assert rows[0]["started_utc_s"] == 1_767_323_045
    assert (rows[0]["state"], rows[0]["verdict"], rows[0].get("live")) == ("ended", None, None)
    assert rows[1]["title"] is None, "its segment is empty"
    state = page.ask("GET", f"/api/v1/runs/{RUN}", page.cookie("viewer")).json
    assert (state["state"], state["outcome"]["error"]) == ("stopped", "B-REC-012")


def test_a_session_is_read_once_until_its_folder_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from bench.web.recorded import listing

    for number in range(READ_AT_ONCE + 6):
        write_sample(tmp_path / f"20260101T0000{number:02d}Z_x_1", seconds=1)
    read: list[str] = []
    plain = listing.session_row
    monkeypatch.setattr(listing, "session_row", lambda folder: (read.append(folder.name), plain(folder))[1])
    runs = RunList(tmp_path)
    rows, unread = runs.rows()
    assert (len(rows), unread, len(read)) == (READ_AT_ONCE + 6, 6, READ_AT_ONCE)
    assert [row["simulated"] for row in rows[-2:]] == [None, None], "the oldest are read last"
    assert runs.rows()[1] == 0
    assert runs.rows()[1] == 0
    assert len(read) == READ_AT_ONCE + 6
    results = {"uut": {"model": "NGU", "serial": "9"}, "quality": {"records": 5}, "estimates": [{"verdict": "fail"}]}
    newest = tmp_path / rows[0]["run"]
    (newest / "results.json").write_text(json.dumps(results))
    (newest / OPEN_MARKER).touch()
    row = runs.rows()[0][0]
    assert (row["verdict"], row["uut"]["serial"], row["records"]["done"], row["state"]) == ("fail", "9", 5, "stopped")
    assert read[-1] == newest.name


def row(value: float, channel: int = 1) -> dict[str, Any]:
    conditions = {"channel": channel, "temperature_degC": 20.0}
    return {"quantity": "dsf_n", "unit": "ppm", "conditions": conditions, "value": value, "std_uncertainty": 1.0,
            "expanded_uncertainty": 2.0}  # fmt: skip


def test_partial_fits_are_put_behind_each_other() -> None:
    found = None
    for records in (1, 2, 2, 3):
        found = joined(found, {"records": records, "rows": [row(10.0 + records)]}, 5.0)
    assert found["rows"][0]["history"] == [[1, 11.0, 1.0, 2.0], [2, 12.0, 1.0, 2.0], [3, 13.0, 1.0, 2.0]]
    assert found["rows"][0]["value"] == 13.0
    for records in range(4, 500):
        found = joined(found, {"records": records, "rows": [row(0.0)]}, 5.0)
    assert len(found["rows"][0]["history"]) == KEPT_PER_ROW
    many = {"records": 501, "rows": [row(0.0, channel) for channel in range(300)]}
    expected = {**row(0.0), "value": None, "std_uncertainty": None, "expanded_uncertainty": None}
    later = joined(found, {"records": 502, "rows": [expected]}, 5.0)["rows"][0]
    assert later["history"] == found["rows"][0]["history"], "what is not determined has no past"
    assert max(len(one["history"]) for one in joined(found, many, 5.0)["rows"]) == KEPT_IN_ALL // 300


@pytest.mark.parametrize(
    ("program", "fits"),
    [("print('{\"records\": 4, \"rows\": []}')", 0), ("raise SystemExit(1)", 0), ("print('[]')", 0),
     ("print('{')", 0),
     (f"import json; print(json.dumps({{'records': 4, 'rows': {[row(1.0)]!r}}}))", 1)],
)  # fmt: skip
def test_a_fit_runs_in_a_process_and_not_again_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str, fits: int
) -> None:
    clock = VirtualClock()
    log = tmp_path / "log"
    fitting = PartialFits(clock, (sys.executable, "-c", f"open({str(log)!r}, 'a').write('x'); {program}"))
    looks = 0

    async def pause(seconds: float) -> None:
        nonlocal looks
        looks += 1
        clock.sleep(seconds)
        await asyncio.sleep(0)
        if looks == 100:
            raise asyncio.CancelledError

    monkeypatch.setattr(partial_fits, "pause", pause)
    with pytest.raises(asyncio.CancelledError):
        asyncio.run(fitting.keep(tmp_path))
    assert log.read_text() == "xx", "at 0 s and at 60 s of 100 s"
    found = fitting.of(tmp_path.name)
    assert (0 if found is None else len(found["rows"])) == fits


def test_a_trend_that_cannot_be_made_is_told(tmp_path: Path) -> None:
    past = Past(tmp_path / "cache")
    (tmp_path / "s").mkdir()
    (tmp_path / "s" / "session.0001.mcap").write_bytes(b"nothing")
    with pytest.raises(Exception, match="cannot be made") as told:
        past.history(tmp_path / "s", HistoryQuery(("port_a.npp[1]",), 0.0, 1e6, 10))
    assert getattr(told.value, "code", "") == "B-WEB-022"


NAME = "20260301T000000Z_scale_factor_7"
PLACES = {"calibrator": ("fluke_5720a", "GPIB0::4::INSTR"), "supply": ("hp_6632b", "GPIB0::5::INSTR")}
MUTE = "error B-RUN-060: calibrator: not confirmed safe (no answer). Next: switch it off"
END = {"steps": 3, "records": 1, "slip_s": 0.0, "overruns": 0, "retaken": 0, "lateness_ms": [0.0, 0.0, 0.0]}
UTC = "2026-03-01T01:00:00.000+00:00"


@dataclass(frozen=True)
class Met:
    """A run as views meet it: its state document, and its guard where it does not answer."""

    state: Mapping[str, Any]
    folder: Path
    guard: Mapping[str, Any] | None = None


def answered(run: RunState, t_utc_s: float) -> None:
    """Both instruments say that they are off."""
    for role, question in (("calibrator", "ISR?"), ("supply", "OUTP?")):
        run.on_traffic(role, "tx", question, t_utc_s)
        run.on_traffic(role, "rx", "0", t_utc_s)


def living() -> RunState:
    run = RunState(small_plan(), MANIFEST, run=NAME, places=PLACES)
    run.on_event(event_of("phase", {"name": "campaign", "t_start_ns": 0}), NOW_S - 60.0)
    run.on_step(0, NOW_S - 60.0)
    answered(run, NOW_S - 30.0)
    return run


def held(folder: Path, confirmed: bool) -> Met:
    """Its calibrator was off a moment ago, and does not answer any more when it is told to go off."""
    run = living()
    run.on_event(event_of("hold", {"step": 3, "by": "operator", "reason": "door (kim)"}), NOW_S - 20.0)
    unsafe = {"what": "stimulus", "step": 3, "role": "calibrator", "code": "B-INST-001", "text": "mute"}
    run.on_event(event_of("alarm", unsafe), NOW_S - 18.0)
    if confirmed:
        answered(run, NOW_S - 10.0)
    return Met(run.document(NOW_S), folder)


def ended(folder: Path, confirmed: bool) -> Met:
    """Everything answered that it is off just before its end, at which the calibrator was not confirmed safe."""
    run = living()
    with_seal = SessionWriter.create(folder / NAME, {"session": NAME}, {}, t_mono_ns=0)
    for kind, fields in (("safe", {"failures": [] if confirmed else [MUTE]}), ("end", {**END, "error": None})):
        run.on_event(event_of(kind, fields), NOW_S - 5.0)
        with_seal.event(kind, 1, fields)
    with_seal.close("done")
    final = Past().final(folder / NAME)
    return Met({**run.document(NOW_S), "run": NAME, "session": final["session"]}, folder / NAME)


def killed(*entries: Mapping[str, Any]) -> Callable[[Path, bool], Met]:
    """Its guard has acted and has this in its diary, or that everything is confirmed."""

    def met(folder: Path, confirmed: bool) -> Met:
        SessionWriter.create(folder / NAME, {"session": NAME}, {}, t_mono_ns=0).close("done")
        (folder / NAME / OPEN_MARKER).touch()
        diary = [{"what": "act", "text": "no heartbeat for 2 s"}, *([{"what": "safe"}] if confirmed else entries)]
        lines = [json.dumps({"utc": UTC, **entry}) + "\n" for entry in diary]
        (folder / NAME / DIARY).write_text("".join(lines))
        row = silent_row(folder / NAME)
        state = {
            "run": NAME,
            "state": row["state"],
            **{key: row["now"][key] for key in ("bench", "attention", "guard")},
        }
        return Met(state, folder / NAME, row["now"]["guard"])

    return met


SITUATIONS = {
    "in a hold": held,
    "ended": ended,
    "its guard is trying": killed({"what": "unsafe", "instruments": {"calibrator": "unreachable"}}),
    "its guard names roles only": killed({"what": "unsafe", "instruments": ["calibrator"]}),
    "its guard says nothing yet": killed(),
    "its guard has named some": killed(
        {"what": "instrument", "role": "calibrator", "safe": False, "state": "commanded"}
    ),
    "taken over": killed({"what": "safe"}, {"what": "taken over", "by": "bench run 4711"}),
}


def on_card(met: Met) -> str:
    """The bench of a card, and of the page of a run; the words are those of the catalogue for these keys."""
    bench = met.state["bench"]
    word = "OUTPUTS OFF" if bench["state"] == "off" else "on, or not known"
    return word + ("; NOT confirmed" if bench["unconfirmed"] else "")


def in_list(met: Met) -> str:
    """How it stands in the list of sessions; a run that goes on stands there as a card only."""
    if "session" not in met.state and met.guard is None:
        return on_card(met)
    off = session_row(met.folder)["outcome"]["off"]
    return {True: "OUTPUTS OFF", False: "NOT confirmed"}.get(off, "nothing")


def in_top(met: Met) -> str:
    seen = Seen(document(**met.state), str(met.folder), lost=met.guard is not None)
    return " ".join(line.plain for line in page_of(seen, Look(catalogue(), width=400)).head)


def in_metrics(met: Met) -> str:
    samples = [sample for family in families([SeenRun(met.state)]) for sample in family.samples]
    off = [one.value for one in samples if one.labels.get("bench_outputs_state") == "off"]
    left = [one.value for one in samples if one.name == "bench_outputs_unconfirmed"]
    return f"{'OUTPUTS OFF' if off == [1] else ''} {'NOT confirmed' if left != [0] else ''}"


def for_who_looks_next(met: Met) -> str:
    """``bench resume``, ``bench top`` and the terminal of a run that its guard ended."""
    (line,) = guard_lines(met.folder)
    return line.replace("Confirmed: every instrument is off, or on hold", "OUTPUTS OFF")


VIEWS = {"card": on_card, "list": in_list, "top": in_top, "metrics": in_metrics}
MORE_VIEWS = {
    **{(situation, "message"): lambda met: bench_in_words(met.state["bench"]) for situation in ("in a hold", "ended")},
    **{(situation, "next"): for_who_looks_next for situation in list(SITUATIONS)[2:]},
    ("in a hold", "progress"): lambda met: (
        doing(met.state) + ("" if met.state["bench"]["unconfirmed"] else " OUTPUTS OFF")
    ),
}
CASES = {(situation, name): view for situation in SITUATIONS for name, view in VIEWS.items()} | MORE_VIEWS


@pytest.mark.parametrize(("situation", "view"), CASES, ids=[" - ".join(case) for case in CASES])
def test_it_is_not_confirmed_until_it_is(tmp_path: Path, situation: str, view: str) -> None:
    said = CASES[situation, view](SITUATIONS[situation](tmp_path / "a", False))
    assert "NOT confirm" in said
    assert "OUTPUTS OFF" not in said
    said = CASES[situation, view](SITUATIONS[situation](tmp_path / "b", True))
    assert "NOT confirm" not in said
    assert "OUTPUTS OFF" in said


def test_the_fault_of_an_instrument_lasts_until_its_reply_confirms_it(tmp_path: Path) -> None:
    for confirmed in (False, True):
        state = held(tmp_path, confirmed).state
        faults = [alarm for alarm in state["alarms"] if alarm["severity"] == "fault"]
        assert [alarm["active"] for alarm in faults] == [not confirmed]
        assert state["bench"]["unconfirmed"] == ({} if confirmed else {"calibrator": "B-INST-001"})
        assert now_of(state)["attention"] == ("some" if confirmed else "much")
