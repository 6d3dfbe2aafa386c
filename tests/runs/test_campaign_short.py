"""The short campaign end to end: same seed same bytes, replay, copies, schema, truth; and watched, the same bytes."""

import json
import socket
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess
from types import SimpleNamespace
from typing import Any

import jsonschema
import pytest
from rehearsal import NAME, SEED, Inside, contents, record_golden, rehearsed, tiny_plan, writable_copy

from bench.analysis import results_schema
from bench.plan import Plan
from bench.record import SessionReader
from bench.run.besides import besides
from bench.run.feed.client import FeedClient, FeedGone
from bench.run.session import Beside, Conducted
from bench.tables import watch

Short = tuple[Path, CompletedProcess[str]]
LIMIT_ppm = {"gyro": 8.0, "accelerometer": 5.0}


def results_of(folder: Path) -> dict[str, object]:
    return json.loads((folder / "results.json").read_text())


def test_a_campaign_ends_with_its_files_and_exit_status_0(short: Short) -> None:
    folder, done = short
    assert done.returncode == 0, done.stderr
    assert sorted(contents(folder)) == [
        "bench.001s", "bench.010s", "bench.100s", "coefficients.h", "coefficients.json", "port_a.001s", "port_a.010s",
        "port_a.100s", "port_b.001s", "port_b.010s", "port_b.100s", "report.html", "results.json", "session.0001.mcap",
        "session.0002.mcap", "session.0003.mcap", "trend.json",
    ]  # fmt: skip
    assert (folder.parent / "history.sqlite").is_file()
    assert "SIMULATED" in done.stdout
    assert str(folder / "report.html") in done.stdout
    assert "Traceback" not in done.stdout + done.stderr


def test_a_folder_of_that_name_gives_a_suffix_which_is_in_no_file(golden: Path, tmp_path: Path) -> None:
    """Else the same seed gives the same bytes; the whole short campaign is held against another in test_page_killed."""
    taken = tmp_path / golden.name
    taken.mkdir()
    record_golden(tmp_path)
    first, second = contents(golden), contents(taken.with_name(f"{golden.name}-2"))
    assert {name for name in first if first[name] != second[name]} == set()
    assert first.keys() == second.keys()
    assert not list(taken.iterdir())


def test_results_match_their_schema(short: Short) -> None:
    jsonschema.validate(results_of(short[0]), results_schema())


def test_scale_factors_agree_with_the_simulated_truth(short: Short) -> None:
    folder, _ = short
    true = json.loads(folder.with_name(NAME + ".truth.json").read_text())["estimates"]
    keys = ("channel", "temperature_degC")
    expected = {
        (one["quantity"], *(one["conditions"].get(key) for key in keys)): one["value"]
        for one in true
        if one["quantity"] in ("dsf_n", "dsf_p")
    }
    worst = {"gyro": 0.0, "accelerometer": 0.0}
    judged = 0
    for one in results_of(folder)["estimates"]:  # type: ignore[attr-defined]
        conditions = one["conditions"]
        where = (one["quantity"], *(conditions.get(key) for key in keys))
        if where in expected:
            judged += 1
            worst[conditions["kind"]] = max(worst[conditions["kind"]], abs(one["value"] - expected[where]))
    print(f"seed {SEED}: worst errors {worst} ppm over {judged} estimates")
    assert judged >= 2 * 3 * 2
    for kind, limit_ppm in LIMIT_ppm.items():
        assert worst[kind] < limit_ppm


@pytest.mark.validates(
    "replay of a session from its raw bytes",
    against="every number the run itself wrote, in a copy without the simulated truth",
)
def test_a_copy_elsewhere_replays_fits_and_reports_without_the_truth(
    short: Short, tmp_path: Path, inside: Inside
) -> None:
    folder, _ = short
    copy = writable_copy(folder, tmp_path / "somewhere" / "else")
    (copy / "report.html").unlink()
    replayed = inside("replay", str(copy), cwd=tmp_path)
    assert replayed.returncode == 0, replayed.stderr
    assert "every number is identical" in replayed.stdout
    fitted = inside("fit", str(copy), "--json", cwd=tmp_path)
    assert fitted.returncode == 0
    assert json.loads(fitted.stdout) == results_of(folder)
    reported = inside("report", str(copy), cwd=tmp_path)
    assert reported.returncode == 0
    assert (copy / "report.html").read_bytes() == (folder / "report.html").read_bytes()


UTC_S = 946_684_800.0


class Crowd:
    """Watchers of a run: one polls as fast as it can and keeps what it sees, one never reads, one is a notebook."""

    def __init__(self, out: Path) -> None:
        self.seen: list[dict[str, Any]] = []
        self.points = 0
        self.pictures: list[bytes] = []
        self.looked = threading.Event()  # the notebook, whose libraries take their time, has its first picture
        self._out, self._ended = out, threading.Event()
        self._threads = [threading.Thread(target=one) for one in (self._poll, self._ask_and_never_read, self._watch)]

    def __enter__(self) -> "Crowd":
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        for thread in self._threads:
            thread.join(20.0)

    def _folder(self) -> Path | None:
        while not self._ended.wait(0.01):
            if found := next(iter(self._out.glob("*/live.*")), None):
                return found.parent
        return None

    def _poll(self) -> None:
        if (folder := self._folder()) is None:
            return
        client, since = FeedClient(folder), 0
        while not self._ended.is_set():
            try:
                reply = client.poll(since)
            except FeedGone:
                continue
            since = int(reply.header["seq"])
            self.points += len(reply.t_utc_s)
            self.seen.append(reply.header["state"])
        client.close()

    def _watch(self) -> None:
        """Look at the run as a notebook does; the view ends with the run."""
        if (folder := self._folder()) is not None:
            watch(folder, "bench.unit")
            self.pictures.append(b"end")

    def DisplayHandle(self) -> Any:
        """Stand in for IPython.display, whose handle shows a picture and replaces it."""
        return SimpleNamespace(display=self._show, update=self._show)

    def _show(self, picture: bytes) -> None:
        self.pictures.append(picture)
        self.looked.set()

    def Image(self, data: bytes) -> bytes:
        return data

    def _ask_and_never_read(self) -> None:
        if (folder := self._folder()) is None:
            return
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as mute:
            mute.settimeout(0.1)
            try:
                mute.connect(str(folder / "live.sock"))
                while not self._ended.is_set():
                    mute.sendall(b'{"since": 0, "state": true}\n' * 100)
            except OSError:  # the run is over, or it was dropped
                self._ended.wait(20.0)


def conducted(plan: Plan, out: Path, act: Callable[[], object] = lambda: None, *beside: Beside) -> Conducted:
    watched = [*besides(plan, {}, virtual=True), *beside]
    return rehearsed(out, plan, act=lambda world, step: act(), seed=5, beside=watched).run


@pytest.mark.slow
def test_a_watched_run_writes_the_same_bytes_and_tells_the_truth(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = tiny_plan(tmp_path)
    alone = conducted(plan, tmp_path / "alone")
    with Crowd(tmp_path / "watched") as crowd:
        monkeypatch.setitem(sys.modules, "IPython.display", crowd)  # type: ignore[arg-type]
        watched = conducted(plan, tmp_path / "watched", lambda: crowd.looked.wait(20.0))
    assert contents(watched.folder) == contents(alone.folder)
    assert not list(watched.folder.glob("live*"))
    assert len(crowd.seen) > 5
    assert crowd.points > 600
    assert len(set(crowd.pictures)) > 1
    assert {picture[:4] for picture in crowd.pictures[:-1]} == {b"\x89PNG"}
    assert crowd.pictures[-1] == b"end"
    (end,) = [utc_s(t_ns) for _, t_ns, _ in SessionReader(watched.folder).events("end")]
    etas = [one["eta"] for one in crowd.seen if one["eta"] is not None]
    assert etas
    for eta in etas:
        assert eta["earliest_utc_s"] <= end <= eta["latest_utc_s"]
    boots = {one["boot_id"] for one in crowd.seen}
    assert len(boots) == 1
    assert len(boots.pop()) == 16
    last = crowd.seen[-1]
    assert (last["simulated"], last["clock"], last["source"]) == (True, "virtual", "live")
    assert last["records"]["planned"] == 15
    assert {str(record["flags"]) for record in last["records"]["last"]} == {"[]"}
    assert set(last["instruments"]) == set(plan.station.instruments)
    assert not any(link["state"] in ("lost", "silent") for one in crowd.seen for link in one["links"].values())
    json.dumps(crowd.seen, allow_nan=False)


def utc_s(t_ns: int) -> float:
    return t_ns / 1e9 + UTC_S
