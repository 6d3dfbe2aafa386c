"""Pages and texts of the browser side: nothing missing, nothing unused."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from starlette.applications import Starlette
from starlette.routing import Route

import bench.web
from bench.web import pages, runs

HERE = Path(bench.web.__file__).parent
ENGLISH = json.loads((HERE / "texts" / "en.json").read_text(encoding="utf-8"))
SCRIPTS = {path.name: path.read_text(encoding="utf-8") for path in sorted((HERE / "static").glob("*.js"))}
TEMPLATES = {path.name: path.read_text(encoding="utf-8") for path in sorted((HERE / "templates").glob("*.j2"))}
GRAPHS = [{"title": "Gyros", "unit": "pulse", "signals": [f"port_a.npp[{n}]" for n in range(1, 11)], "window_s": 60}]


def test_every_text_that_is_asked_for_is_there() -> None:
    everything = "\n".join([*SCRIPTS.values(), *TEMPLATES.values()])
    asked = set(re.findall(r"\bt\([\"']([^\"'$]+)[\"']", everything))
    asked |= set(re.findall(r"\"(trouble\.[a-z-]+)\"", everything))
    assert asked - set(ENGLISH) == set()


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


def test_every_script_is_part_of_a_page() -> None:
    used = {"theme.js"}.union(*(pages._modules(first) for first in ("start.js", "fleet.js", "page.js")))
    assert set(SCRIPTS) == used


def test_the_name_of_a_run_is_never_markup(client: Client) -> None:
    assert "<b>" not in client.get("/runs/%3Cb%3E").text


def test_the_language_is_the_chosen_one_or_english(client: Client) -> None:
    assert client.get("/texts", accept_language="xx-YY, de;q=0.5").json() == ENGLISH
    assert client.get("/texts", accept_language="ko-KR,ko;q=0.9,en;q=0.8").json()["state.running"] == "실행 중"
    assert '<html lang="ko">' in client.get("/", accept_language="ko-KR").text


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
