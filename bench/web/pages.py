"""Pages of the browser: the start page, the page of one run, and the catalogue of their texts."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response

from bench.model.texts import ENGLISH, Texts, languages

_HERE = Path(__file__).parent
_COOKIE = "language"
_IMPORT = re.compile(r'from "\./([a-z-]+\.js)"')


@cache
def _templates() -> Environment:
    return Environment(
        loader=FileSystemLoader(_HERE / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def language_of(request: Request) -> str:
    """Language of the page: chosen on it, else the first of the browser's that has a catalogue, else English."""
    wishes = [request.cookies.get(_COOKIE, "")]
    wishes += [wish.split(";")[0].strip() for wish in request.headers.get("accept-language", "").split(",")]
    known = languages(_HERE)
    return next((code for wish in wishes if (code := wish.split("-")[0].lower()) in known), ENGLISH)


@cache
def _modules(first: str) -> tuple[str, ...]:
    """Return a script and every script it imports, so that the browser fetches all of them at once."""
    found, waiting = [first], [first]
    while waiting:
        for name in _IMPORT.findall((_HERE / "static" / waiting.pop()).read_text(encoding="utf-8")):
            if name not in found:
                found.append(name)
                waiting.append(name)
    return tuple(found)


def _page(request: Request, template: str, script: str, **values: object) -> Response:
    language = language_of(request)
    page = _templates().get_template(template)
    known: dict[str, object] = {
        "t": Texts(_HERE, language),
        "language": language,
        "languages": languages(_HERE),
        "modules": _modules(script),
    }
    return HTMLResponse(page.render(**known, **values))


async def index(request: Request) -> Response:
    """``GET /``: living runs, sessions, calibration history; the page asks for them itself."""
    return _page(request, "index.html.j2", "start.js")


async def run_page(request: Request) -> Response:
    """``GET /runs/{run}``: the live or replay page of one run."""
    return _page(request, "run.html.j2", "page.js", run=request.path_params["run"])


async def texts(request: Request) -> Response:
    """``GET /api/v1/texts``: every text of the page by key, English where the language has none yet."""
    return JSONResponse(Texts(_HERE, language_of(request)).all)
