"""What is claimed of a bench, as long as it is heard; what ``fleet.yaml`` says and what stands below the benches."""

from __future__ import annotations

import asyncio
import json
import logging
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import store_sample
from top_sample import SetClock
from web_rig import Page, served

from bench.commands.history import show
from bench.commands.requests import Place, ServeRequest
from bench.commands.serve import serve
from bench.model.errors import BenchError, InputError
from bench.store import Filters, record_calibration
from bench.web.fleet.app import create_fleet_app
from bench.web.fleet.calibrated import LONGEST_DAYS
from bench.web.fleet.fleet_file import FleetBench, load_fleet
from bench.web.fleet.overview import BEGIN_S, MOST_RUNS, Overview, newest_over, over_card
from bench.web.fleet.seat import CONNECTING, SILENT, SILENT_S, NotUnderstood, Seat
from bench.web.recorded.listing import session_row
from bench.web.security.tokens import VIEWER
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


TOKEN = "a" * 32
REMOTE = "  - {name: one, url: 'https://one.example.org', token_env: TOKEN_ONE}\n"
ENVIRONMENT = {"TOKEN_ONE": TOKEN, "EMPTY": "", "WORDS": "not a token"}


def written(folder: Path, text: str) -> Path:
    path = folder / "fleet.yaml"
    path.write_text(text)
    return path


def test_the_example_of_the_page_is_taken(tmp_path: Path) -> None:
    page = (Path(__file__).parents[4] / "docs" / "fleet.md").read_text(encoding="utf-8")
    kept(tmp_path).rename(tmp_path / "bench-1.token")
    (tmp_path / "sessions").mkdir()
    path = written(tmp_path, page.split("```yaml\n")[1].split("```")[0])
    benches = load_fleet(path, {"BENCH_2_TOKEN": TOKEN})
    assert [bench.name for bench in benches] == ["bench-1", "bench-2", "this machine"]


def refused(folder: Path, lines: str) -> str:
    path = written(folder, f"benches:\n{lines}")
    with pytest.raises(InputError) as raised:
        load_fleet(path, ENVIRONMENT)
    assert raised.value.exit_status == 2
    return str(raised.value).replace(str(path), "fleet.yaml")


def kept(folder: Path, text: str = TOKEN, mode: int = 0o600) -> Path:
    path = folder / "one.token"
    path.write_text(text)
    path.chmod(mode)
    return path


def test_what_it_says(tmp_path: Path) -> None:
    kept(tmp_path, f"{TOKEN}\n")
    (tmp_path / "sessions").mkdir()
    lines = (
        "benches:\n"
        f"{REMOTE}"
        "  - {name: Bench 2, place: room 2.14, url: 'http://127.0.0.1:8321/', token_file: one.token}\n"
        "  - {name: 벤치, folder: sessions}\n"
    )
    one, two, three = load_fleet(written(tmp_path, lines), ENVIRONMENT)
    assert (one.name, one.url, one.token, one.folder) == ("one", "https://one.example.org", TOKEN, None)
    assert (two.place, two.url, two.token) == ("room 2.14", "http://127.0.0.1:8321", TOKEN)
    assert (three.name, three.url, three.folder) == ("벤치", "", tmp_path / "sessions")
    assert two.where == f"{tmp_path / 'fleet.yaml'}:3:6"
    assert TOKEN not in repr(one)


NOT_TAKEN = """http://one.example.org http://192.0.2.7:8321 ftp://one.example.org one.example.org
    https://kim:secret@one.example.org https://one.example.org/runs/x https://one.example.org?token=x
    https://one.example.org:99999"""
TOKENS = {
    "token_env: MISSING": "the variable MISSING is empty",
    "token_env: EMPTY": "the variable EMPTY is empty",
    "token_env: WORDS": "the variable WORDS holds no token",
    "token_file: no.token": "cannot be read: No such file",
    "token_file: .": "cannot be read: ",
}
NO_BENCH = """name: one
    name: one, url: 'https://one.example.org'
    name: one, url: 'https://one.example.org', token_env: A, token_file: b
    name: one, folder: a, token_env: A
    name: one, folder: a, url: 'https://one.example.org', token_env: A
    name: '', folder: a
    name: one, folder: a, token: secret"""
WRONG = [
    ("name: one, folder: nowhere", "B-FLEET-004: fleet.yaml:2:17: ", ""),
    *((f"name: one, url: '{url}', token_env: A", "B-FLEET-001: fleet.yaml:2:17: ", "") for url in NOT_TAKEN.split()),
    *((f"name: a, url: 'https://a.org', {key}", "B-FLEET-003: fleet.yaml:2:37: ", TOKENS[key]) for key in TOKENS),
    *((line.strip(), "B-YAML-01", ": fleet.yaml:2:") for line in NO_BENCH.splitlines()),
]


@pytest.mark.parametrize(("line", "begins", "words"), WRONG)
def test_a_line_that_is_not_taken_has_its_code_and_its_place(
    tmp_path: Path, line: str, begins: str, words: str
) -> None:
    said = refused(tmp_path, f"  - {{{line}}}\n")
    assert said.startswith(f"error {begins}")
    assert words in said
    assert "kim:secret" not in said


def test_a_bench_that_stands_there_twice_b_fleet_002(tmp_path: Path) -> None:
    first, second = refused(tmp_path, f"{REMOTE}{REMOTE.replace('org', 'org/')}").splitlines()
    assert first.startswith("error B-FLEET-002: fleet.yaml:3:6: name 'one' stands there twice, first at fleet.yaml:2:6")
    assert second.startswith("error B-FLEET-002: fleet.yaml:3:17: url 'https://one.example.org/'")
    (tmp_path / "a").mkdir()
    folders = "  - {name: one, folder: a}\n  - {name: two, folder: a}\n"
    assert "fleet.yaml:3:17: folder 'a' stands there twice" in refused(tmp_path, folders)


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="files have no owners here")
@pytest.mark.parametrize(("text", "mode", "words"), [(TOKEN, 0o640, "has mode 0640"), ("", 0o600, "is empty")])
def test_the_file_of_a_token_is_for_its_owner_b_fleet_003(tmp_path: Path, text: str, mode: int, words: str) -> None:
    kept(tmp_path, text, mode)
    said = refused(tmp_path, "  - {name: one, url: 'https://one.example.org', token_file: one.token}\n")
    assert "B-FLEET-003" in said
    assert words in said
    assert TOKEN not in said


def test_all_mistakes_are_said_at_once_in_order(tmp_path: Path) -> None:
    lines = "  - {name: a, folder: nowhere}\n  - {name: a, url: 'http://x.example.org', token_env: A}\n"
    said = refused(tmp_path, lines).splitlines()
    assert [line.split(": ")[0] for line in said] == ["error B-FLEET-004", "error B-FLEET-002", "error B-FLEET-001"]


@pytest.mark.parametrize("option", [{"out": Path("sessions")}, {"mqtt": "mqtt://127.0.0.1"}])
def test_what_belongs_to_one_bench_b_fleet_005(tmp_path: Path, option: dict[str, object]) -> None:
    with pytest.raises(InputError) as raised:
        serve(ServeRequest(fleet=written(tmp_path, f"benches:\n{REMOTE}"), **option))  # type: ignore[arg-type]
    assert raised.value.code == "B-FLEET-005"
    assert next(iter(option)) in raised.value.where


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> str:
    url = f"sqlite:///{tmp_path_factory.mktemp('history') / 'history.sqlite'}"
    for number, (document, manifest) in enumerate(store_sample.calibrations(4, 200.0, 17)):
        other = {**document, "uut": {"model": "NGU", "serial": "B2"}} if number == 3 else document
        record_calibration(url, other, manifest, None)
    return url


@pytest.fixture(scope="module")
def page(url: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    top = tmp_path_factory.mktemp("fleet")
    with served(top, make=lambda serving: create_fleet_app(serving, ()), history=url) as server:
        yield server


def test_who_is_due_is_what_the_command_says(page: Page, url: str, capsys: pytest.CaptureFixture[str]) -> None:
    answer = page.ask("GET", "/api/v1/due", page.cookie(VIEWER)).json
    assert show.due(Place(url, None), Filters(), LONGEST_DAYS, True) == 1
    said = json.loads(capsys.readouterr().out)["due"]
    assert len(said) == 2
    assert answer["due"] == sorted(said, key=lambda due: due["due_utc"])
    assert answer["named"] is True


def test_sessions_over_all_are_the_history_newest_first(
    page: Page, url: str, capsys: pytest.CaptureFixture[str]
) -> None:
    answer = page.ask("GET", "/api/v1/calibrations", page.cookie(VIEWER)).json
    show.list_all(Place(url, None), Filters(), True)
    assert answer["calibrations"] == json.loads(capsys.readouterr().out)["calibrations"][::-1]
    assert [row["uut_serial"] for row in answer["calibrations"]] == ["B2", "A1", "A1", "A1"]


@pytest.mark.parametrize(("file", "status"), [("nothing.sqlite", 200), ("text.sqlite", 400)])
def test_a_history_that_is_not_there_is_empty_and_one_that_cannot_be_read_says_why(
    tmp_path: Path, file: str, status: int
) -> None:
    (tmp_path / "text.sqlite").write_text("no database " * 100)
    url = f"sqlite:///{tmp_path / file}"
    with served(tmp_path, make=lambda serving: create_fleet_app(serving, ()), history=url) as page:
        answer = page.ask("GET", "/api/v1/due", page.cookie(VIEWER))
        assert answer.status == status
        assert answer.json.get("due", []) == []
        assert answer.json.get("error", "").startswith("B-STORE") is (status == 400)


def test_an_address_that_can_never_be_opened_is_refused_before_anything_is_served(tmp_path: Path) -> None:
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text(f"benches:\n  - {{name: here, folder: '{tmp_path}'}}\n")
    with pytest.raises(BenchError, match="B-STORE-001: "):
        serve(ServeRequest(fleet=fleet, history="nonsense"))
