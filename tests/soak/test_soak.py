"""Seeded campaigns with mixed faults: the bench is safe at the end, the record valid, every result true or flagged.

Here are some, what shows that a violation is seen, how seeds are soaked in blocks, and rows 23 and 24: virtual hours
after which memory, descriptors and threads stay what they were. ``make soak`` soaks any number (tests/soak/run.py).
The page is open for 38 hours of a run that is fed at a hundred times its speed (23 minutes).
"""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import soak_blocks
import soak_campaign
from block_rows import add_row, in_blocks, read_rows, seeds_left
from browser_rig import PageServer, Visitor, chromium, metrics, visiting
from fault_schedule import TimedFault
from hypothesis import given
from hypothesis import strategies as st
from playwright.sync_api import CDPSession
from shown_run import HOURS, FastRun
from soak_blocks import Block, soaked_block
from soak_campaign import (
    ALLOCATOR,
    SHORT,
    TURN,
    Campaign,
    Hour,
    Soaked,
    campaign_of,
    grown,
    shortest,
    weigh_estimates,
)

from bench.analysis import Estimate
from bench.model.clock import VIRTUAL_START_UTC_NS
from bench.model.events import UNDECLARED
from bench.plan import PlannedCall
from bench.plan.plan import no_effect
from bench.run import sequencer
from bench.run.feed import bench_state, run_state

SHORT_INTERVAL_S = 50.0  # between faults: so short that as many faults are drawn as in 13 campaigns of make soak


def violations(tmp_path: Path, seeds: range, name: str = SHORT) -> dict[str, list[str]]:
    campaign = campaign_of(name, tmp_path, SHORT_INTERVAL_S)
    found = {f"{name} {seed}": campaign.soaked(seed, tmp_path / name / str(seed)).violations for seed in seeds}
    return {seed: wrong for seed, wrong in found.items() if wrong}


@pytest.mark.parametrize("seeds", [pytest.param(8, marks=pytest.mark.slow), pytest.param(267, marks=pytest.mark.sweep)])
def test_mixed_faults_short(tmp_path: Path, seeds: int) -> None:
    assert violations(tmp_path, range(seeds)) | violations(tmp_path, range(seeds // 8), TURN) == {}


def test_a_kind_of_step_with_a_falsely_empty_set_of_effects_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(PlannedCall, "effects", no_effect)
    (found,) = violations(tmp_path, range(1)).values()
    assert any(text.startswith(UNDECLARED) and "leave it off" in text for text in found)


def test_every_view_that_shows_off_what_is_on_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_state._Part, "known", lambda part: (False, VIRTUAL_START_UTC_NS / 1e9))
    monkeypatch.setattr(run_state, "GOOD_FOR", 1000.0)
    (found,) = violations(tmp_path, range(1)).values()
    views = {text.partition(":")[0] for text in found}
    assert {"page", "top", "metrics", "message", "recorded page", "recorded top", "recorded metrics"} <= views


def test_a_seed_is_reproduced(tmp_path: Path) -> None:
    campaign = campaign_of(SHORT, tmp_path)
    first, second = (campaign.soaked(3, tmp_path / name) for name in ("a", "b"))
    assert first == second
    assert first.faults
    segments = [sorted((tmp_path / name).rglob("*.mcap")) for name in ("a", "b")]
    assert [path.read_bytes() for path in segments[0]] == [path.read_bytes() for path in segments[1]]


def test_a_bench_that_is_left_on_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sequencer, "make_safe", lambda *_, **__: [])
    soaked = campaign_of(SHORT, tmp_path).soaked(0, tmp_path, ())
    assert any("unsafe: supply" in text for text in soaked.violations)
    assert soaked.ended == "done"


def test_a_wrong_number_is_found(tmp_path: Path) -> None:
    campaign = campaign_of(SHORT, tmp_path)
    for channel in campaign.plan.campaign["channels"]:
        channel["k0_C"] *= 1.001
    soaked = campaign.soaked(0, tmp_path, ())
    assert any("sigma off" in text for text in soaked.violations)


@pytest.mark.parametrize(
    ("quality", "value", "std", "violated", "flagged"),
    [
        ("doubtful", 7.0, None, False, 1),  # seeds 20380 and 20393: four of eight records were left
        ("refused", None, None, False, 1),
        ("sound", 7.0, None, True, 1),
        ("sound", None, None, True, 1),
        ("sound", 7.0, 1.0, True, 0),
        ("sound", 2.0, 1.0, False, 0),
    ],
)
def test_an_estimate_without_uncertainty_must_say_that_it_is_not_sound(
    quality: str, value: float | None, std: float | None, violated: bool, flagged: int
) -> None:
    named = {"quantity": "dsf_n", "conditions": {"channel": 1}}
    estimate = Estimate.model_construct(**named, value=value, std_uncertainty=std, quality=quality, dropped=0)
    soaked = Soaked(0, ())
    weigh_estimates([estimate], [{**named, "value": 1.0}], soaked, suspect=False)
    assert (bool(soaked.violations), soaked.flagged) == (violated, flagged)


@pytest.mark.parametrize(
    ("sequence", "seed", "words", "hours"),
    [
        pytest.param("scale_factor_short", 1, (), 2.0, marks=pytest.mark.slow),
        pytest.param("scale_factor_38h", 0, ("held",), 38.0, marks=pytest.mark.sweep),
    ],
)
def test_what_hours_of_a_campaign_hold(
    tmp_path: Path, sequence: str, seed: int, words: tuple[str, ...], hours: float
) -> None:
    """One campaign in a fresh process: what earlier tests left in memory would hide or feign a growth."""
    command = [sys.executable, str(soak_campaign.__file__), sequence, str(seed), str(tmp_path), *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, **ALLOCATOR})
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert (found["violations"], found["ended"]) == ([], "done")
    assert found["hours"][-1]["hour"] >= hours


@pytest.mark.parametrize(
    ("name", "last", "told"),
    [
        ("resident_MiB", 104.0, "resident memory grew by 4.00 MiB"),
        ("held_MiB", 52.0, "held memory grew by 2.00 MiB"),
        ("threads", 3, "threads: "),
        ("descriptors", 90, "descriptors: "),
    ],
)
def test_what_grows_is_told(name: str, last: float, told: str) -> None:
    steady = {"resident_MiB": 100.0, "held_MiB": 50.0, "descriptors": 12, "threads": 2}
    seen = [Hour(float(hour), **(steady | ({name: last} if hour > 14 else {}))) for hour in range(1, 21)]  # type: ignore[arg-type]
    assert [text for text in grown(seen) if not text.startswith(told)] == []
    assert len(grown(seen)) == 1
    assert grown([Hour(float(hour), **steady) for hour in range(1, 21)]) == []  # type: ignore[arg-type]


NEEDED = (TimedFault(12.5, "trip"), TimedFault(40.0, "stuck", "port_a", ("55",), 3.0))
OTHERS = [TimedFault(float(at), "drop", "port_b", (0.01,), 60.0) for at in range(50, 55)]


def block(first: int, last: int, campaign: str = SHORT) -> Block:
    return Block(campaign, first, last, "0123abc", "2 done; 1 B-RUN-031", 7, 30, 1, 0, 0.2, 1.9)


def violated(faults: Any) -> list[str]:
    """A bug that needs two faults."""
    return ["unsafe: supply on"] if set(NEEDED) <= set(faults) else []


@given(st.lists(st.booleans(), max_size=40))
def test_no_fault_of_a_shortest_list_can_be_left_out(noise: list[bool]) -> None:
    faults = [TimedFault(float(number), "trip") for number in range(len(noise))]
    needed = {fault for fault, kept in zip(faults, noise, strict=True) if kept}
    assert shortest(faults, lambda some: needed <= set(some)) == [fault for fault in faults if fault in needed]


def test_rows_are_read_as_they_were_added(tmp_path: Path) -> None:
    rows = [block(0, 99), block(100, 100, "scale_factor_38h")]
    for row in rows:
        add_row(row, tmp_path / "blocks.csv")
    assert read_rows(Block, tmp_path / "blocks.csv") == rows
    assert read_rows(Block, tmp_path / "none.csv") == []


def test_what_stands_in_a_row_is_not_soaked_again() -> None:
    left = seeds_left([range(4), range(8, 10)], 15)
    assert left == [4, 5, 6, 7, 10, 11, 12, 13, 14]
    assert in_blocks(left, 3) == [range(4, 7), range(7, 8), range(10, 13), range(13, 15)]
    assert seeds_left([range(15)], 15) == []


@pytest.fixture
def planted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Soak a campaign that has a bug."""

    def soaked(self: Campaign, seed: int, folder: Path, faults: Any = None, clock: Any = None) -> Soaked:
        under = ([*OTHERS[:2], *NEEDED, *OTHERS[2:]] if seed == 4 else OTHERS) if faults is None else faults
        return Soaked(seed, under, "done", violated(under), 10, 0, 0.5)

    campaign = Campaign(SHORT, None, (), 250.0, 80.0, ())  # type: ignore[arg-type]
    monkeypatch.setattr(Campaign, "soaked", soaked)
    monkeypatch.setattr(soak_blocks, "campaign_of", lambda *_: campaign)


@pytest.mark.usefixtures("planted")
def test_a_seed_that_fails_is_told_with_the_faults_it_needs() -> None:
    row, (failure,) = soaked_block(SHORT, range(3, 6), "0123abc")
    assert (row.first, row.last, row.ended, row.violations, row.faults, row.hours) == (3, 5, "3 done", 1, 17, 1.5)
    assert (failure.seed, failure.violations, failure.faults) == (4, ("unsafe: supply on",), NEEDED)


LOOK_ms = 20_000
MOST_TIMES = 1.5
HELD = ("JSHeapUsedSize", "Nodes", "JSEventListeners")


def held(visitor: Visitor, cdp: CDPSession, run: FastRun) -> dict[str, float]:
    """What is held now by browser and server."""
    found = metrics(cdp)
    resident_kB = next(
        line.split()[1]
        for line in Path(f"/proc/{visitor.server.process.pid}/status").read_text().splitlines()
        if line.startswith("VmRSS:")
    )
    now = {name: found[name] for name in HELD} | {"server_MB": int(resident_kB) / 1e3, "hours": run.hours}
    print(" ".join(f"{name} {value:.1f}" for name, value in now.items()), flush=True)
    return now


def use(visitor: Visitor) -> None:
    """Somebody looks: windows, zoom, cursor, numbers as a table, the other theme."""
    page = visitor.page
    plots = page.locator("figure.graph .plot")
    plots.last.focus()
    for key in ("+", "+", "+", "ArrowLeft", "0", "d", "d"):
        page.keyboard.press(key)
        page.wait_for_timeout(300)
    plots.first.hover()
    for number, window in enumerate(("10 min", "1 h", "run")):
        button = page.locator("figure.graph").nth(number).get_by_role("button", name=window, exact=True)
        button.click()
        assert button.get_attribute("aria-pressed") == "true"
    page.wait_for_timeout(500)


@pytest.mark.sweep
def test_38_hours(tmp_path: Path) -> None:
    server = PageServer(
        tmp_path, (str(Path(__file__).resolve().parents[1] / "support" / "page" / "page_with_fits.py"),)
    )
    run = FastRun(server.out, "20260101T000000Z_fast_1")
    seen = []
    try:
        with chromium() as browser, visiting(browser, server, "operator") as visitor:
            page = visitor.open_run(run.name)
            cdp = page.context.new_cdp_session(page)
            cdp.send("Performance.enable")
            page.locator("figure.graph details.numbers summary").first.click()
            label = page.locator("figure.graph").first.locator(".ends button").first
            texts = set()
            while run.hours < HOURS:
                use(visitor)
                page.wait_for_timeout(LOOK_ms if run.hours > 1 else 1000)
                visitor.requests.clear()
                texts.add(label.inner_text())
                assert page.inner_text("#badge-word") == "RUNNING"
                if run.hours > 1:
                    seen.append(held(visitor, cdp, run))
            page.wait_for_selector("#estimates tbody tr")
            assert len(texts) > len(seen) / 2, "nothing moved"
    finally:
        run.close()
        server.end()
    first, last = seen[0], seen[-1]
    for name in (*HELD, "server_MB"):
        assert last[name] < MOST_TIMES * first[name], (name, first[name], last[name])
