"""Pages and texts of the browser side: nothing missing, nothing unused; colours that no checker of pages sees."""

import asyncio
import itertools
import json
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import numpy as np
import pytest
from numpy.typing import NDArray
from starlette.applications import Starlette
from starlette.routing import Route

import bench.web
from bench.report.plots.style import PALETTE as REPORT_PALETTE
from bench.web import figures, pages, runs

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

    routes = [Route("/", pages.index), Route("/runs/{run}", pages.run_page),
              Route("/texts", pages.texts),
              Route("/figures/{run}", runs.figures)]  # fmt: skip
    app = Starlette(routes=routes)
    app.state.hub = SimpleNamespace(outline=outline, work=work)
    return Client(app)


def test_every_script_is_part_of_a_page() -> None:
    used = {"theme.js"}.union(*(pages._modules(first) for first in ("start.js", "page.js")))
    assert set(SCRIPTS) == used


def test_the_language_is_the_chosen_one_or_english_and_the_name_of_a_run_never_markup(client: Client) -> None:
    assert client.get("/texts", accept_language="xx-YY, de;q=0.5").json() == ENGLISH
    assert client.get("/texts", accept_language="ko-KR,ko;q=0.9,en;q=0.8").json()["state.running"] == "실행 중"
    assert '<html lang="ko">' in client.get("/", accept_language="ko-KR").text
    assert "<b>" not in client.get("/runs/%3Cb%3E").text


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


CSS = (Path(bench.web.__file__).parent / "static" / "page.css").read_text(encoding="utf-8")
GRAPHICS = 3.0  # WCAG 2.2, success criterion 1.4.11
FAR = 15.0  # CIELAB distance of two colours that mean something else; 2.3 is just noticeable
# Linear RGB as seen without one kind of cone. Source: Machado, Oliveira, Fernandes, IEEE Trans. Vis. Comput. Graph.
# 15(6), 2009, matrices for severity 1.0; each leaves white as it is.
SIGHT = {
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
    "all cones": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
}
# Source: IEC 61966-2-1, sRGB to CIE XYZ, and its white.
XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


def linear(colour: str) -> NDArray[np.float64]:
    """Linear red, green, blue of #rrggbb. Source: WCAG 2.2, relative luminance."""
    shares = np.array([int(colour[index : index + 2], 16) / 255 for index in (1, 3, 5)])
    return np.where(shares <= 0.04045, shares / 12.92, ((shares + 0.055) / 1.055) ** 2.4)


def contrast(one: str, other: str) -> float:
    """Contrast ratio of two colours. Source: WCAG 2.2, contrast ratio."""
    dark, bright = sorted(float(XYZ[1] @ linear(colour)) for colour in (one, other))
    return (bright + 0.05) / (dark + 0.05)


def lab(rgb: NDArray[np.float64]) -> NDArray[np.float64]:
    """CIELAB of linear red, green, blue. Source: ISO/CIE 11664-4."""
    share = XYZ @ np.clip(rgb, 0.0, 1.0) / XYZ.sum(axis=1)
    x, y, z = np.where(share > (6 / 29) ** 3, np.cbrt(share), share * (29 / 6) ** 2 / 3 + 4 / 29)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def least_apart(colours: tuple[str, ...]) -> dict[str, float]:
    """How far the two nearest of some colours are apart, for each kind of sight."""
    found = {}
    for sight, matrix in SIGHT.items():
        seen = [lab(np.array(matrix) @ linear(colour)) for colour in colours]
        found[sight] = min(float(np.linalg.norm(one - other)) for one, other in itertools.combinations(seen, 2))
    return found


def states(theme: str) -> tuple[str, ...]:
    """Colours of the states of a run as the stylesheet has them."""
    block = CSS.split(':root[data-theme="light"]')[theme == "light"].split("}")[0]
    return tuple(re.findall(r"--(?:good|warn|bad|live|idle): (#[0-9a-f]{6})", block))


def test_the_rules_can_fail() -> None:
    """Ratios are published with WCAG; red and green of equal lightness are alike for one in ten men."""
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.005)
    found = least_apart(("#a8a800", "#d28e26"))
    assert (found["all cones"] > FAR, found["deuteranopia"] < FAR) == (True, True)


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_curves_stand_out_from_their_card(theme: str) -> None:
    palette = figures.PALETTES[theme]
    assert min(contrast(hue, palette.card) for hue in (*palette.hues, palette.now)) >= GRAPHICS
    assert min(contrast(hue, "#ffffff") for hue in REPORT_PALETTE) >= GRAPHICS
    assert len({(look["hue"], tuple(look["dash"])) for look in figures.looks()}) >= 10


@pytest.mark.parametrize(
    "colours",
    [states("dark"), states("light"), *(palette.hues for palette in figures.PALETTES.values()), REPORT_PALETTE],
)
def test_what_means_something_else_is_told_apart_whatever_somebody_sees(colours: tuple[str, ...]) -> None:
    assert len(colours) >= 5
    assert {sight: apart for sight, apart in least_apart(tuple(colours)).items() if apart < FAR} == {}
