"""``GET /metrics``: read by the parsers of prometheus_client, held against the state document that the page shows."""

import asyncio
import json
import re
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from prometheus_client.openmetrics.parser import text_string_to_metric_families as openmetrics
from prometheus_client.parser import text_string_to_metric_families as plain
from shown_run import ShownRun, first_state
from web_rig import RUN, Page, served

from bench.model.clock import VirtualClock
from bench.record import OPEN_MARKER
from bench.web.recorded.past import Past
from bench.web.security.tokens import MOST_OF_ADDRESS, OPERATOR, VIEWER
from bench.web.telemetry import SeenRun, families, lookout
from bench.web.telemetry.lookout import Lookout

OPENMETRICS = "application/openmetrics-text;version=1.0.0;q=0.8,text/plain;version=0.0.4;q=0.3,*/*;q=0.1"  # Prometheus
LIVE = "20260101T000000Z_shown_7"
Samples = dict[tuple[str, frozenset[tuple[str, str]]], float]


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Page]:
    """A server that is looked at afresh by each request, and fits nothing."""
    monkeypatch.setattr(lookout, "FRESH_S", 0.0)
    monkeypatch.setattr(lookout, "LOST_S", 0.0)
    monkeypatch.setattr(lookout, "READ_S", 60.0)
    with served(tmp_path) as server:
        server.app.state.hub.fit = lambda folder: asyncio.sleep(0)
        yield server


@pytest.fixture
def shown(page: Page) -> Iterator[ShownRun]:
    run = ShownRun(page.serving.out, LIVE)
    yield run
    run.close()


def scraped(page: Page, accept: str = OPENMETRICS) -> tuple[str, str]:
    """Return content type and text of a scrape with the viewer's token."""
    headers = {"Authorization": f"Bearer {page.clear[VIEWER]}", "Accept": accept}
    answer = page.ask("GET", "/metrics", headers)
    assert answer.status == 200, answer.body
    return answer.headers["content-type"], answer.body.decode()


def samples_of(text: str, parser: Any = openmetrics) -> Samples:
    return {
        (sample.name, frozenset(sample.labels.items())): sample.value
        for family in parser(text)
        for sample in family.samples
    }


def samples(page: Page) -> Samples:
    return samples_of(scraped(page)[1])


def value(read: Samples, name: str, run: str = LIVE, **labels: str) -> float:
    return read[name, frozenset({"run": run, **labels}.items())]


def now(read: Samples, name: str, run: str = LIVE, **labels: str) -> list[str]:
    """Return the states of a set that are 1."""
    wanted = {"run": run, **labels}
    return [
        found[name]
        for (what, items), number in read.items()
        if what == name and number == 1.0 and (found := dict(items)).items() >= wanted.items()
    ]


def test_every_figure_is_that_of_the_state_document(page: Page, shown: ShownRun) -> None:
    bench = {"state": "energised", "confirmed_utc_s": shown.state["t_utc_s"] - 30.0}
    shown.state.update(bench=bench, attention="much")
    shown.state["links"]["port_a"]["bad"] = 3
    document = page.ask("GET", f"/api/v1/runs/{LIVE}", page.cookie(VIEWER)).json
    read = samples(page)
    assert now(read, "bench_run_state") == [document["state"]] == ["running"]
    assert now(read, "bench_run_attention") == ["much"]
    assert now(read, "bench_outputs_state") == ["energised"]
    assert value(read, "bench_run_progress_ratio") == document["progress"] == 0.38
    eta_s = document["eta"]["likely_utc_s"] - document["t_utc_s"]
    assert value(read, "bench_run_eta_seconds") == pytest.approx(eta_s, abs=60)
    assert 0 <= value(read, "bench_run_age_seconds") < 10
    assert value(read, "bench_outputs_age_seconds") == pytest.approx(30, abs=60)
    link = document["links"]["port_a"]
    assert value(read, "bench_rate_hertz", link="port_a") == link["rate_Hz"] == 100.0
    assert now(read, "bench_link_state", link="port_a") == ["streaming"]
    counts = {what: value(read, "bench_frames_total", link="port_a", what=what) for what in ("good", "bad", "lost")}
    assert counts == {"good": 360_000, "bad": 3, "lost": 2}
    assert value(read, "bench_counter_jumps_total", link="port_a") == 4.0
    records = {what: value(read, "bench_records", what=what) for what in ("done", "planned", "retaken", "flagged")}
    assert records == {"done": 3, "planned": 9, "retaken": 1, "flagged": 0}
    info = {"title": document["title"], "sequence": "scale_factor", "station": "af_bench", "clock": "wall",
            "model": "NGU", "serial": "7", "simulated": "true"}  # fmt: skip
    assert value(read, "bench_run_info", **info) == 1.0


def test_alarms_temperatures_and_estimates(page: Page, shown: ShownRun) -> None:
    estimate = {"quantity": "dsf_n", "unit": "ppm", "value": 412.31, "expanded_uncertainty": 19.9, "limit": 500.0,
                "conditions": {"channel": 1, "kind": "gyro"}, "quality": "sound"}  # fmt: skip
    one_sided = {**estimate, "quantity": "bias", "limit": None, "limits": {"low": None, "high": 2e-9}}
    expected = {**estimate, "quantity": "dsf_p", "value": None, "expanded_uncertainty": None, "quality": None}
    page.app.state.hub.added = lambda run: {"estimates": {"rows": [estimate, one_sided, expected]}, "operator": None}
    alarm = {"id": "1", "severity": "alarm", "code": None, "t_utc_s": 0.0, "text": "x", "active": True,
             "acknowledged": None, "shelved": None}  # fmt: skip
    shown.state["alarms"] = [
        alarm, {**alarm, "active": False}, {**alarm, "severity": "warning"},
        {**alarm, "severity": "fault", "shelved": {"by": "kim", "reason": "known", "until_utc_s": 9e9}},
    ]  # fmt: skip
    read = samples(page)
    assert {word: value(read, "bench_alarms", severity=word) for word in ("warning", "alarm", "fault")} == {
        "warning": 1, "alarm": 1, "fault": 0,
    }  # fmt: skip
    due = {"bench.air": 54.8, "bench.unit": 54.6, "bench.setpoint": 55.0}
    for place, value_degC in due.items():  # a sine of 0.02 degC on it, and 0.01 between the least and the greatest
        assert value(read, "bench_temperature_celsius", place=place) == pytest.approx(value_degC, abs=0.03)
    labels = {"quantity": "dsf_n", "unit": "ppm", "conditions": "channel=1, kind=gyro", "quality": "sound"}
    assert value(read, "bench_estimate_value", **labels) == 412.31
    assert value(read, "bench_estimate_uncertainty", **labels) == 19.9
    assert value(read, "bench_estimate_limit", side="low", **labels) == -500.0
    assert value(read, "bench_estimate_limit", side="high", **labels) == 500.0
    sides = {
        dict(key[1])["side"] for key in read if ("quantity", "bias") in key[1] and key[0] == "bench_estimate_limit"
    }
    assert sides == {"high"}
    assert not [key for key in read if ("quantity", "dsf_p") in key[1]], "nothing is known of it yet"


def test_both_formats_say_the_same(page: Page, shown: ShownRun) -> None:
    kind, text = scraped(page)
    assert kind == "application/openmetrics-text; version=1.0.0; charset=utf-8"
    assert text.endswith("# EOF\n")
    assert "# UNIT bench_temperature_celsius celsius\n" in text
    assert "# TYPE bench_run_state stateset\n" in text
    assert "# TYPE bench_frames counter\n" in text
    older_kind, older = scraped(page, "text/plain;version=0.0.4")
    assert older_kind == "text/plain; version=0.0.4; charset=utf-8"
    assert set(samples_of(text)) == set(samples_of(older, plain))
    assert scraped(page, "*/*")[0] == scraped(page, "")[0] == kind


HOSTILE = 'a"b\\c\nd{}=,# EOF\n é漢😀\udc80\x00'


def test_hostile_texts_stay_labels(page: Page, shown: ShownRun) -> None:
    link = {"state": HOSTILE, "frames": 1, "rate_Hz": "fast", "age_s": float("inf"), "bad": True, "lost": None}
    shown.state.update(title=HOSTILE, links={HOSTILE: link, "port_b": "nothing"}, state=HOSTILE, bench=None, eta=[])
    row = {"quantity": HOSTILE, "unit": "1", "value": 1.0, "conditions": {HOSTILE: HOSTILE}}
    page.app.state.hub.added = lambda run: {"estimates": {"rows": [row, {**row, "value": 2.0}, {}]}}
    _, text = scraped(page)
    read = samples_of(text)
    kept = HOSTILE.replace("\udc80", "?")
    assert {dict(key[1])["title"] for key in read if key[0] == "bench_run_info"} == {kept}
    assert value(read, "bench_frames_total", link=kept, what="good") == 1.0
    assert not [key for key in read if key[0] in ("bench_rate_hertz", "bench_frame_age_seconds")]
    assert now(read, "bench_run_state") == []
    assert now(read, "bench_outputs_state") == ["unknown"]
    found = [number for key, number in read.items() if key[0] == "bench_estimate_value"]
    assert found == [1.0]  # two samples of the same labels would make a scraper refuse everything
    assert text.count("# EOF\n") == 1


def test_a_run_that_says_what_nobody_understands_is_lost_and_the_others_are_told_of(
    page: Page, shown: ShownRun, caplog: pytest.LogCaptureFixture
) -> None:
    other = ShownRun(page.serving.out, "20260101T000000Z_other_8")
    try:
        other.state["signals"] = [7] * 14
        shown.state.update(alarms=7, records=[1], links=[2], uut="x", session="y")
        read = samples(page)
    finally:
        other.close()
    assert now(read, "bench_run_state") == ["running"]
    assert now(read, "bench_run_state", other.name) == ["lost"]
    assert now(read, "bench_outputs_state", other.name) == ["unknown"]
    assert caplog.text.count(other.name) == 1


def test_a_run_that_does_not_answer_is_unknown_and_keeps_no_figure(page: Page, shown: ShownRun) -> None:
    assert now(samples(page), "bench_run_state") == ["running"]
    shown.close()
    read = samples(page)
    assert now(read, "bench_run_state") == ["stopped"]  # no process has its journal open
    assert now(read, "bench_outputs_state") == ["unknown"]
    assert now(read, "bench_run_attention") == ["much"]
    assert value(read, "bench_run_age_seconds") > 0
    assert [key for key in read if key[0] == "bench_run_info" and ("title", "Scale factor, 5 temperatures") in key[1]]
    kept = {key[0] for key in read if ("run", LIVE) in key[1]}
    assert kept == {
        "bench_run_info", "bench_run_state", "bench_run_attention", "bench_outputs_state", "bench_run_age_seconds",
    }  # fmt: skip


def test_a_run_that_ends_tells_how_and_one_that_is_deleted_is_gone(page: Page, golden: Path) -> None:
    folder = page.serving.out / golden.name
    shutil.copytree(golden, folder)
    assert not [key for key in samples(page) if ("run", golden.name) in key[1]]  # it was over before anybody asked
    (folder / OPEN_MARKER).touch()
    assert now(samples(page), "bench_run_state", golden.name) == ["stopped"]
    (folder / OPEN_MARKER).unlink()
    read = samples(page)
    final = Past().final(folder)
    assert now(read, "bench_run_state", golden.name) == ["ended"]
    assert now(read, "bench_run_outcome", golden.name) == [final["session"]["outcome"]["word"]]
    results = json.loads((golden / "results.json").read_text())["estimates"]
    told = [number for key, number in read.items() if key[0] == "bench_estimate_value"]
    assert sorted(told) == sorted(row["value"] for row in results if row["value"] is not None)
    assert not [key for key in read if key[0] in ("bench_rate_hertz", "bench_temperature_celsius")]
    shutil.rmtree(folder)
    assert not [key for key in samples(page) if ("run", golden.name) in key[1]]


@pytest.mark.parametrize(("unconfirmed", "stays"), [({}, False), ({"calibrator": "silent"}, True)])
def test_an_end_is_told_of_for_ten_minutes_and_one_not_confirmed_off_until_the_next(
    page: Page, monkeypatch: pytest.MonkeyPatch, unconfirmed: dict[str, str], stays: bool
) -> None:
    left = {"bench": {"state": "unknown", "unconfirmed": unconfirmed}, "state": "ended"}
    monkeypatch.setattr(page.app.state.hub.past, "final", lambda folder: left)
    folder = page.serving.out / RUN
    (folder / OPEN_MARKER).touch()
    samples(page)
    (folder / OPEN_MARKER).unlink()
    assert value(samples(page), "bench_outputs_unconfirmed", RUN) == len(unconfirmed)
    monkeypatch.setattr(lookout, "ENDED_S", -1.0)
    samples(page)
    assert any(("run", RUN) in key[1] for key in samples(page)) == stays


def test_only_the_viewers_token_or_a_login_opens_it(page: Page) -> None:
    def asked(**headers: str) -> int:
        return page.ask("GET", "/metrics", headers).status

    assert asked() == 401
    assert asked(**page.cookie(VIEWER)) == 200
    assert asked(Authorization=f"bearer  {page.clear[VIEWER]}") == 200
    assert page.ask("GET", "/api/v1/runs", {"Authorization": f"Bearer {page.clear[VIEWER]}"}).status == 401
    assert page.ask("GET", "/metrics", {"Authorization": "Bearer x", "Host": "elsewhere"}).status == 403
    for wrong in (f"Bearer {page.clear[OPERATOR]}", "Bearer x", "Bearer", f"Basic {page.clear[VIEWER]}", "Bearer \xff"):
        answer = page.ask("GET", "/metrics", {"Authorization": wrong})
        assert (answer.status, answer.json["error"]) == (401, "B-WEB-024")
        assert page.clear[OPERATOR] not in answer.body.decode()
    assert MOST_OF_ADDRESS == 5
    answer = page.ask("GET", "/metrics", {"Authorization": f"Bearer {page.clear[VIEWER]}"})
    assert (answer.status, answer.json["error"]) == (429, "B-WEB-024")  # the right one waits too
    assert 1 <= int(answer.headers["retry-after"]) <= 60
    assert page.login("kim", page.clear[VIEWER]).status == 303  # people are not kept out by a scraper


def test_asked_a_hundred_times_a_second_it_looks_once(tmp_path: Path) -> None:
    looks: list[Path] = []

    async def work(task: Any, *arguments: Any) -> Any:
        looks.append(*arguments)
        return task(*arguments)

    clock = VirtualClock()
    hub = SimpleNamespace(serving=SimpleNamespace(out=tmp_path, clock=clock), work=work)

    async def asked(times: int) -> None:
        lookout = Lookout(hub)  # type: ignore[arg-type]
        for second in range(3):
            await asyncio.gather(*(lookout.runs() for _ in range(times)))
            assert len(looks) == second + 1
            clock.sleep(1.0)

    asyncio.run(asked(100))


def test_the_end_of_a_recording_that_takes_long_to_read_holds_nobody_up(
    page: Page, shown: ShownRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lookout, "READ_S", 0.05)
    read, final = threading.Event(), page.app.state.hub.past.final

    def slow(folder: Path) -> Any:
        assert read.wait(20.0)
        return final(folder)

    monkeypatch.setattr(page.app.state.hub.past, "final", slow)
    assert now(samples(page), "bench_run_state") == ["running"]
    (shown.folder / OPEN_MARKER).unlink()
    shown.close()
    found = samples(page)
    assert now(found, "bench_run_state") == ["ended"]
    assert now(found, "bench_outputs_state") == ["unknown"]
    assert not [name for name, _ in found if name in ("bench_run_progress_ratio", "bench_temperature_celsius")]
    read.set()
    while now(samples(page), "bench_run_state") == ["ended"]:
        pass
    assert now(samples(page), "bench_run_outcome") == ["damaged"]


ROOT = Path(__file__).resolve().parents[4]
PAGE = (ROOT / "docs" / "unattended.md").read_text(encoding="utf-8")
BOARD = (ROOT / "docs" / "grafana" / "bench.json").read_text(encoding="utf-8")
NAME = re.compile(r"\bbench_[a-z_]+\b")


def everything() -> list[SeenRun]:
    """Return runs that together have a sample of every metric."""
    row = {"quantity": "bias", "unit": "A", "value": 1.0, "expanded_uncertainty": 0.1, "limit": 2.0, "conditions": {}}
    more = {
        "attention": "none", "bench": {"state": "off", "confirmed_utc_s": 0.0, "unconfirmed": {}},
        "estimates": {"rows": [row]}, "session": {"outcome": {"word": "pass"}},
    }  # fmt: skip
    return [SeenRun(first_state("r") | more, {"bench.air": 20.0}, 0.0)]


def test_the_page_names_every_metric_and_page_and_dashboard_no_other() -> None:
    found = families(everything())
    assert [family.name for family in found if not family.samples] == []
    exported = {sample.name for family in found for sample in family.samples}
    table = re.findall(r"^\| (`bench_[^|]+) \|", PAGE, re.MULTILINE)
    assert {name for cell in table for name in NAME.findall(cell)} == exported
    asked = re.findall(r'"expr": "([^"\\]*)', BOARD) + re.findall(r"```prometheus\n(.*?)```", PAGE, re.DOTALL)
    assert len(asked) > 10
    assert {name for text in asked for name in NAME.findall(text)} <= exported


@pytest.mark.parametrize(("living", "off"), [("a_bench", []), ("another", [1.0])])
def test_what_was_off_at_the_end_is_not_told_of_a_station_that_another_run_has_in_use(
    living: str, off: list[float]
) -> None:
    ended = {"run": "old", "state": "ended", "station": "a_bench", "bench": {"state": "off"}}
    runs = [
        SeenRun(ended),
        SeenRun({"run": "new", "state": "running", "station": living, "bench": {"state": "unknown"}}),
    ]
    samples = next(one for one in families(runs) if one.name == "bench_outputs_state").samples
    assert [one.value for one in samples if one.labels == {"run": "old", "bench_outputs_state": "off"}] == off
