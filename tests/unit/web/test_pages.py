"""Pages and texts of the browser side: nothing missing, nothing unused."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from starlette.applications import Starlette
from starlette.routing import Route

import bench.web
from bench.model.texts import languages
from bench.web import pages, runs

HERE = Path(bench.web.__file__).parent
ENGLISH = json.loads((HERE / "texts" / "en.json").read_text(encoding="utf-8"))
SCRIPTS = {path.name: path.read_text(encoding="utf-8") for path in sorted((HERE / "static").glob("*.js"))}
TEMPLATES = {path.name: path.read_text(encoding="utf-8") for path in sorted((HERE / "templates").glob("*.j2"))}
# Words of docs/live-protocol.md and of results.json that the page has to know, by family of keys.
FAMILIES = {
    "graph": {"rates", "counts"},
    "temperature": {"air", "unit"},
    "bench": {"off", "energised", "moving", "unknown"},
    "bench.figure": {"setpoint", "air", "closed"},
    "bench.remains": {"mains", "hot", "cold"},
    "outcome": {
        "pass",
        "conditional_pass",
        "fail",
        "conditional_fail",
        "doubtful",
        "not_judged",
        "no_results",
        "fault",
        "stopped",
        "damaged",
        "report",
        "pdf",
        "certificate",
        "specimen",
    },
    "start.counts": {"pass", "conditional_pass", "fail", "conditional_fail", "doubtful", "none"},
    "log.severity": {"none", "warning", "alarm", "fault"},
    "state": {
        "starting",
        "running",
        "waiting",
        "holding",
        "ending",
        "ended",
        "stopped",
        "lost",
        "connecting",
        "idle",
        "unknown",
    },
    "fleet.why": {"connecting", "unreached", "silent", "refused", "untrusted", "misnamed", "foreign", "server"},
    "alarm": {"warning", "alarm", "fault"},
    "instrument.state": {"ok", "away", "error"},
    "link.state": {"waiting", "streaming", "stale", "silent", "lost"},
    "verdict": {"pass", "fail", "conditional_pass", "conditional_fail", "indeterminate", "none"},
    "quality": {"doubtful", "refused"},
    "role": {"viewer", "operator", "bench"},
}
GRAPHS = [{"title": "Gyros", "unit": "pulse", "signals": [f"port_a.npp[{n}]" for n in range(1, 11)], "window_s": 60}]


def used_keys() -> set[str]:
    """Keys that scripts and templates ask for, word for word or as a list of names of a family."""
    everything = "\n".join([*SCRIPTS.values(), *TEMPLATES.values()])
    literal = set(re.findall(r"[\"']([a-z]+(?:[.-][a-z_-]+)+)[\"']", everything))
    families = re.findall(r"`([a-z.]+)\.\$\{\w+\}(-[a-z]+)?`", everything)
    names = set(re.findall(r"[\"']([a-z]+)[\"']", everything))
    names |= set(re.findall(r"[{ ,]([a-z]+)(?=: (?:fixed|code|number|\{\})|, time| }, |, age)", everything))
    found = {f"{family}.{name}{tail}" for family, tail in families for name in names}
    found |= {f"{family}.{name}" for family in ("link", "record", "instrument", "log") for name in names}
    found |= {f"{family}.{name}" for family, members in FAMILIES.items() for name in members}
    return literal | found


def test_every_text_that_is_asked_for_is_there() -> None:
    everything = "\n".join([*SCRIPTS.values(), *TEMPLATES.values()])
    asked = set(re.findall(r"\bt\([\"']([^\"'$]+)[\"']", everything))
    asked |= set(re.findall(r"\"(trouble\.[a-z-]+)\"", everything))
    assert asked - set(ENGLISH) == set()
    known = {f"{family}.{name}" for family, members in FAMILIES.items() for name in members}
    assert known - set(ENGLISH) == set()


def test_no_text_is_left_over() -> None:
    assert {key for key in ENGLISH if not key.startswith(("login.", "language."))} - used_keys() == set()


@pytest.mark.parametrize("language", languages(HERE))
def test_a_language_has_no_key_that_english_lacks_and_the_same_names(language: str) -> None:
    catalogue = json.loads((HERE / "texts" / f"{language}.json").read_text(encoding="utf-8"))
    assert set(catalogue) <= set(ENGLISH)
    names = {key: set(re.findall(r"\{(\w+)\}", text)) for key, text in ENGLISH.items()}
    assert {key for key, text in catalogue.items() if set(re.findall(r"\{(\w+)\}", text)) != names[key]} == set()


class _Elements(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.inside: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))
        self.inside.append(tag)

    def handle_data(self, data: str) -> None:
        if self.inside and self.inside[-1] == "script":
            assert not data.strip(), "an inline script"

    def handle_endtag(self, tag: str) -> None:
        self.inside.append("")


class Client:
    """Asks an application without a server."""

    def __init__(self, app: Starlette) -> None:
        self._app = app

    def get(self, path: str, **headers: str) -> httpx.Response:
        async def ask() -> httpx.Response:
            transport = httpx.ASGITransport(app=self._app)
            async with httpx.AsyncClient(transport=transport, base_url="http://bench") as client:
                return await client.get(path, headers={name.replace("_", "-"): text for name, text in headers.items()})

        return asyncio.run(ask())


@pytest.fixture
def client() -> Client:
    async def outline(run: str) -> tuple[dict[str, Any], bool]:
        return {"run": run, "graphs": GRAPHS, "signals": []}, False

    async def work(task: Callable[..., Any], *arguments: Any) -> Any:
        return task(*arguments)

    routes = [Route("/", pages.index), Route("/fleet", pages.fleet), Route("/runs/{run}", pages.run_page),
              Route("/texts", pages.texts),
              Route("/figures/{run}", runs.figures)]  # fmt: skip
    app = Starlette(routes=routes)
    app.state.hub = SimpleNamespace(outline=outline, work=work)
    return Client(app)


@pytest.mark.parametrize("path", ["/", "/fleet", "/runs/20260101T000000Z_x_7"])
def test_a_page_has_no_inline_script_and_every_file_it_names(client: Client, path: str) -> None:
    reply = client.get(path)
    parser = _Elements()
    parser.feed(reply.text)
    named = [attrs.get("src") or attrs.get("href") or "" for tag, attrs in parser.found if tag in ("script", "link")]
    own = [name.removeprefix("/static/") for name in named if name.startswith("/static/")]
    assert {name for name in own if not (HERE / "static" / name).is_file()} == set()
    assert {name for name in named if not name.startswith(("/static/", "/bokeh/bokeh.min.js", "/api/v1/"))} == set()
    assert not [attrs for _, attrs in parser.found if any(name.startswith("on") for name in attrs)]
    ids = [attrs["id"] for _, attrs in parser.found if "id" in attrs]
    assert len(ids) == len(set(ids))
    assert ("html", {"lang": "en"}) in parser.found


def test_every_element_that_a_script_looks_for_is_on_its_page(client: Client) -> None:
    for path, first in (("/", "start.js"), ("/fleet", "fleet.js"), ("/runs/x", "page.js")):
        html = client.get(path).text
        scripts = "".join(SCRIPTS[module] for module in pages._modules(first))
        wanted = set(re.findall(r'byId\("([a-z-]+)"\)(?!\?)', scripts))
        assert {name for name in wanted if f'id="{name}"' not in html} == set(), path


def test_every_script_is_part_of_a_page() -> None:
    used = {"theme.js"}.union(*(pages._modules(first) for first in ("start.js", "fleet.js", "page.js")))
    assert set(SCRIPTS) == used
    assert {name: len(text.splitlines()) for name, text in SCRIPTS.items() if len(text.splitlines()) >= 250} == {}


def test_the_name_of_a_run_is_never_markup(client: Client) -> None:
    assert "<b>" not in client.get("/runs/%3Cb%3E").text


def test_the_language_is_the_chosen_one_or_english(client: Client) -> None:
    assert client.get("/texts", accept_language="xx-YY, de;q=0.5").json() == ENGLISH
    assert client.get("/texts", accept_language="ko-KR,ko;q=0.9,en;q=0.8").json()["state.running"] == "실행 중"
    page = client.get("/", accept_language="ko-KR").text
    assert '<html lang="ko">' in page
    assert '<option value="ko" lang="ko" selected>한국어</option>' in page
    assert '<option value="en" lang="en">English</option>' in page


def test_figures_have_no_code_and_leave_no_reading_out(client: Client) -> None:
    made = client.get("/figures/x").json()
    text = json.dumps(made)
    assert "CustomJS" not in text
    assert len(made["graphs"]) == 1
    for item in (*made["graphs"], made["temperature"], made["history"]):
        (plot,) = item["doc"]["roots"]
        # BokehJS draws every lod_factor-th point of a figure that is dragged, above lod_threshold points
        assert plot["attributes"]["lod_threshold"] is None
    names = re.findall(r'"name": "(curve-\d+)"', json.dumps(made["graphs"][0]))
    assert names == [f"curve-{index}" for index in range(10)]
