"""Twelve situations as people meet them: what the first page, the page of a run, a phone and the terminal say of each.

``make situations`` takes the pictures, for a person to look at.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from browser_rig import PageServer, visiting
from playwright.sync_api import Browser, Page
from recorded import writable_copy
from shown_run import ShownRun, now_utc_s

from bench.record import OPEN_MARKER
from bench.run.feed.outputs import Outputs
from bench.tui.look import Look, catalogue
from bench.tui.page import page_of
from bench.tui.watch import Seen

pytestmark = pytest.mark.waits

PLACES = {
    "calibrator": ("fluke_5720a", "GPIB0::4::INSTR"), "switch": ("keithley_7002", "GPIB0::7::INSTR"),
    "supply": ("hp_6632b", "GPIB0::5::INSTR"), "chamber": ("thermotron_3800", "GPIB0::1::INSTR"),
}  # fmt: skip
QUIET = {"calibrator": {"ISR?": "0"}, "switch": {":CLOS:STAT?": "(@)"}}
DRIVEN = {"calibrator": {"ISR?": "4097", "OUT?": "2.0E-02,A,0E+00"}, "switch": {":CLOS:STAT?": "(@1!1!3)"}}
WARM = {
    "supply": {"OUTP?": "1", "MEAS:VOLT?": "18.0", "MEAS:CURR?": "1.25"},
    "chamber": {"MODE?": "16", "SETP1?": "55.0", "PVAR1?": "54.8"},
}
SIZES = {"wide": {"width": 1280, "height": 800}, "phone": {"width": 390, "height": 844}}
COLOURS = {"none": "--good", "some": "--warn", "much": "--bad"}
PORT = "port_a: no byte for 30 s"


# Age of what was heard last in the moment in which the page says that it knows nothing: by the page's own clock.
AGE_WHEN_UNKNOWN = """async () => {
  const { age_s } = await import("/static/state.js");
  const bench = document.querySelector("#bench");
  const seen = () => { if (bench.dataset.state === "unknown") window.age_s ??= age_s(); };
  new MutationObserver(seen).observe(bench, { attributes: true });
}"""


@dataclass(frozen=True)
class Situation:
    """One that lives. ``word`` and ``attention`` are what every view says; ``says``: words that must stand there."""

    word: str
    attention: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    says: tuple[str, ...] = ()
    replies: Mapping[str, Mapping[str, str]] = field(default_factory=lambda: {**QUIET, **WARM})


def alarm(text: str, code: str | None = None) -> dict[str, Any]:
    return {"id": text, "severity": "alarm", "code": code, "t_utc_s": now_utc_s(), "text": text, "active": True,
            "acknowledged": None}  # fmt: skip


def held(by: str, reason: str) -> dict[str, Any]:
    wait = {"reason": reason, "since_utc_s": now_utc_s() - 100, "until_utc_s": None, "last": None}
    return {"state": "holding", "holds": {by: reason}, "wait": wait}


QUESTION = {
    "id": "1", "text": "Connect the unit to channel 3 of the matrix.", "confirm": "technician", "unit": None,
    "low": None, "high": None, "since_utc_s": 0.0,
}  # fmt: skip
LIVING = {
    "running": Situation("RUNNING", "none", says=("calibrator", "20 mA"), replies={**DRIVEN, **WARM}),
    "soak": Situation("RUNNING", "none", says=("soak 55", "18 V, 1.25 A")),
    "prompt": Situation("WAITING FOR A PERSON", "some", {"state": "waiting", "prompt": QUESTION}, (QUESTION["text"],)),
    "port": Situation("HOLDING", "much", {**held("link port_a", PORT), "alarms": [alarm(PORT, "B-LINK-003")]}, (PORT,)),
    "instrument": Situation("HOLDING", "some", held("instrument dmm", "dmm: no answer"), ("dmm: no answer",)),
    "runaway": Situation("RUNNING", "much", {"alarms": [alarm("air 61.2 degC runs away")]}, ("runs away",)),
    "door": Situation("HOLDING", "much", {**held("interlock door", "door is open"), "alarms": [alarm("door is open")]},
                      ("door is open",)),
}  # fmt: skip
OVER = {"pass": "PASS", "fail": "FAIL", "doubtful": "DOUBTFUL", "damaged": "DAMAGED", "guard": "FAULT"}


def bench_of(replies: Mapping[str, Mapping[str, str]]) -> dict[str, Any]:
    """The state of the bench as the run's own reducer makes it of replies of now."""
    outputs, now = Outputs(PLACES, 150.0), now_utc_s()
    for role, told in replies.items():
        for question, reply in told.items():
            outputs.on_traffic(role, "tx", question, now - 12.0)
            outputs.on_traffic(role, "rx", reply, now - 12.0)
    return outputs.document(now)


def state_of(situation: Situation) -> dict[str, Any]:
    return {"attention": situation.attention, "bench": bench_of(situation.replies), **situation.changes}


@pytest.fixture(scope="module")
def living(server: PageServer) -> Iterator[dict[str, ShownRun]]:
    runs = {}
    for number, (name, situation) in enumerate(LIVING.items()):
        runs[name] = ShownRun(server.out, f"20260301T00000{number}Z_{name}_7")
        runs[name].state.update(state_of(situation))
    yield runs
    for run in runs.values():
        run.close()


@pytest.fixture(scope="module")
def over(server: PageServer, golden: Path) -> dict[str, str]:
    """A recording, five times: its results judged, its end cut off, and left open by a run that its guard ended."""
    names = {what: f"20260302T00000{number}Z_{what}_7" for number, what in enumerate(OVER)}
    for what, name in names.items():
        folder = writable_copy(golden, server.out / name)
        results = json.loads((folder / "results.json").read_text())
        for estimate in results["estimates"]:
            estimate |= {"verdict": "fail" if what == "fail" else "pass", "limit": 1.0}
        if what == "doubtful":
            results["estimates"][0] |= {"quality": "doubtful", "reasons": []}
        (folder / "results.json").write_text(json.dumps(results))
    last = sorted((server.out / names["damaged"]).glob("session.*.mcap"))[-1]
    os.truncate(last, last.stat().st_size // 2)
    (server.out / names["guard"] / OPEN_MARKER).touch()
    said = [{"what": "act", "text": "no heartbeat for 2 s", "utc": "2026-03-02T01:00:00+00:00"},
            {"what": "safe", "instruments": [], "utc": "2026-03-02T01:00:02+00:00"}]  # fmt: skip
    (server.out / names["guard"] / "guard.jsonl").write_text("".join(json.dumps(line) + "\n" for line in said))
    return names


def colour(page: Page, selector: str, what: str) -> str:
    return str(page.eval_on_selector(selector, "(element, what) => getComputedStyle(element)[what]", what))


def named(page: Page, name: str) -> str:
    """A colour of the page's palette as the browser computes it."""
    script = """(name) => {
        const probe = document.body.appendChild(document.createElement("i"));
        probe.style.color = `var(${name})`;
        const found = getComputedStyle(probe).color;
        probe.remove();
        return found;
    }"""
    return str(page.evaluate(script, name))


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_the_first_page(
    browser: Browser, server: PageServer, living: dict[str, ShownRun], over: dict[str, str], screenshots: Path,
    theme: str,
) -> None:  # fmt: skip
    with visiting(browser, server, "viewer", viewport=SIZES["wide"], color_scheme=theme) as visitor:
        page = visitor.page
        page.goto(f"{server.origin}/")
        for name, situation in LIVING.items():
            card = f"a.run-card[href='/runs/{living[name].name}']"
            page.wait_for_selector(card)
            text = page.inner_text(card)
            assert situation.word in text
            assert all(words in text for words in (*situation.says, "ENERGISED", "confirmed")), text
            assert "SAFE" not in text.upper()
            assert colour(page, card, "borderLeftColor") == named(page, COLOURS[situation.attention])
        guarded = page.inner_text(f"a.run-card[href='/runs/{over['guard']}']")
        assert all(words in guarded for words in ("STOPPED", "no heartbeat for 2 s", "OUTPUTS OFF", "by the guard"))
        attention = page.eval_on_selector_all("a.run-card", "(cards) => cards.map((card) => card.dataset.attention)")
        assert attention == sorted(attention, key=["much", "some", "none"].index)
        for what in ("pass", "fail", "doubtful", "damaged"):
            page.click(f"#outcomes button[data-outcome={what}]")
            row = page.inner_text(f"#sessions tr[data-key='{over[what]}']")
            assert OVER[what] in row
        page.click("#outcomes button[data-outcome='']")
        rows = page.eval_on_selector_all("#sessions tbody tr", "(rows) => rows.map((row) => row.dataset.key)")
        assert rows[-1] == over["damaged"]
        for size, viewport in SIZES.items():
            page.set_viewport_size(viewport)
            picture(page, screenshots / f"first_{size}_{theme}.png")


def picture(page: Page, path: Path) -> None:
    """Take a picture, if somebody wants to look at it: a whole page takes a browser without a graphics card seconds."""
    if "BENCH_SCREENSHOTS" in os.environ:
        page.screenshot(path=path, full_page=True)


def tops(page: Page, *selectors: str) -> list[float]:
    boxes = [page.locator(selector).bounding_box() for selector in selectors]
    return [box["y"] for box in boxes if box is not None]


@pytest.mark.parametrize("name", LIVING)
def test_the_page_of_a_run(
    browser: Browser, server: PageServer, living: dict[str, ShownRun], screenshots: Path, name: str
) -> None:
    """In this order: what is on, what now, alarms, how long, who has the command."""
    situation = LIVING[name]
    alarms = ["#alarms-card"] if situation.changes.get("alarms") else []
    with visiting(browser, server, "viewer", viewport=SIZES["wide"]) as visitor:
        page = visitor.page
        page.goto(f"{server.origin}/runs/{living[name].name}")
        page.wait_for_selector("body[data-fresh=fresh]")
        page.wait_for_selector("#bench[data-state=energised]")
        assert page.inner_text("#badge-word") == situation.word
        text = page.inner_text("body")
        assert all(words in text for words in situation.says), text
        for size, viewport in SIZES.items():
            page.set_viewport_size(viewport)
            found = tops(page, "#bench", "#badge", *alarms, "#eta", "#operator")
            assert found == sorted(found)
            assert len(found) == 4 + len(alarms)
            picture(page, screenshots / f"run_{name}_{size}.png")


def test_a_lost_link_is_unknown_within_five_seconds(browser: Browser, server: PageServer) -> None:
    run = ShownRun(server.out, "20260303T000000Z_lost_7")
    run.state.update(state_of(LIVING["running"]))
    with visiting(browser, server, "viewer", may_fail=True) as visitor:
        page = visitor.page
        page.goto(f"{server.origin}/runs/{run.name}")
        page.wait_for_selector("#bench[data-state=energised]")
        page.evaluate(AGE_WHEN_UNKNOWN)
        run.close()
        page.wait_for_selector("#bench[data-state=unknown]")
        assert page.evaluate("window.age_s") < 5.0
        assert "20 mA" not in page.inner_text("#bench")


def test_a_first_page_whose_server_is_gone_is_unknown(browser: Browser, tmp_path: Path) -> None:
    server = PageServer(tmp_path)
    run = ShownRun(server.out, "20260303T000000Z_gone_7")
    run.state.update(state_of(LIVING["running"]))
    with visiting(browser, server, "viewer", may_fail=True) as visitor:
        page = visitor.page
        page.goto(f"{server.origin}/")
        page.wait_for_selector(".run-card .bench[data-state=energised]")
        server.end()
        page.wait_for_selector(".run-card .bench[data-state=unknown]", timeout=9000)  # 5 s after it was heard last
        assert page.get_attribute(".run-card", "data-attention") == "much"
    run.close()


@pytest.mark.parametrize("what", OVER)
def test_a_session_that_is_over_begins_with_its_outcome(
    browser: Browser, server: PageServer, over: dict[str, str], screenshots: Path, what: str
) -> None:
    with visiting(browser, server, "viewer", viewport=SIZES["wide"]) as visitor:
        page = visitor.page
        page.goto(f"{server.origin}/runs/{over[what]}")
        page.wait_for_selector("#session-outcome:not([hidden])")
        assert page.inner_text("#session-outcome .outcome-word") == OVER[what]
        assert page.is_visible("#session-outcome #report")
        picture(page, screenshots / f"over_{what}.png")


@pytest.mark.parametrize("name", LIVING)
def test_the_terminal_says_the_same(living: dict[str, ShownRun], screenshots: Path, name: str) -> None:
    situation = LIVING[name]
    lines = page_of(Seen(living[name].state, "x"), Look(catalogue()))
    text = "\n".join(line.plain for line in (*lines.head, *lines.body))
    assert situation.word in text
    assert "ENERGISED" in text
    assert all(words in " ".join(text.split()) for words in situation.says), text
    (screenshots / f"top_{name}.txt").write_text(text, encoding="utf-8")
