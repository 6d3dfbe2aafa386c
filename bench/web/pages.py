"""Pages of the browser, the catalogue of their texts, and the scripts, styles and icons they are made of."""

from __future__ import annotations

import mimetypes
import re
from collections.abc import Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.staticfiles import StaticFiles

from bench.model.texts import ENGLISH, Texts, languages
from bench.web.security.refusal import Refusal

_HERE = Path(__file__).parent
_COOKIE = "language"
_IMPORT = re.compile(r'from "\./([a-z-]+\.js)"')
_BOKEH_FILES = ("bokeh.min.js",)
mimetypes.add_type("text/javascript", ".js")  # a machine may say otherwise


@cache
def templates() -> Environment:
    """Return what renders the pages; what a page does not say is an error."""
    return Environment(
        loader=FileSystemLoader(_HERE / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def language_of(request: Request) -> str:
    """Return language of the page: chosen on it, else the first of the browser's that has a catalogue, else English."""
    wishes = [request.cookies.get(_COOKIE, "")]
    wishes += [wish.split(";")[0].strip() for wish in request.headers.get("accept-language", "").split(",")]
    known = languages(_HERE)
    return next((code for wish in wishes if (code := wish.split("-")[0].lower()) in known), ENGLISH)


@cache
def _modules(first: str) -> tuple[str, ...]:
    """Return a script and every script it imports, so that the browser fetches all of them at once."""
    names, waiting = [first], [first]
    while waiting:
        for name in _IMPORT.findall((_HERE / "static" / waiting.pop()).read_text(encoding="utf-8")):
            if name not in names:
                names.append(name)
                waiting.append(name)
    return tuple(names)


def page_of(
    request: Request, template: str, *, status: int = 200, headers: Mapping[str, str] | None = None, **values: object
) -> Response:
    """Return a page in the language of the browser; ``values``: what its template names."""
    language = language_of(request)
    known: dict[str, object] = {
        "t": Texts(_HERE, language),
        "language": language,
        "languages": {code: Texts(_HERE, code)("language.name") for code in languages(_HERE)},
    }
    return HTMLResponse(templates().get_template(template).render(**known, **values), status, headers)


async def index(request: Request) -> Response:
    """``GET /``: living runs, sessions, calibration history; the page asks for them itself."""
    return page_of(request, "index.html.j2", modules=_modules("start.js"))


async def run_page(request: Request) -> Response:
    """``GET /runs/{run}``: the live or replay page of one run."""
    return page_of(request, "run.html.j2", modules=_modules("page.js"), run=request.path_params["run"])


def refused(request: Request, refusal: Refusal) -> Response:
    """Return what was not done: a page for who opened an address in a browser, JSON for a script."""
    if "text/html" not in request.headers.get("accept", ""):
        return refusal.response()
    return page_of(request, "refused.html.j2", status=refusal.status, code=refusal.code, text=refusal.text)


async def texts(request: Request) -> Response:
    """``GET /api/v1/texts``: every text of the page by key, English where the language has none yet."""
    return JSONResponse(Texts(_HERE, language_of(request)).all)


async def static(request: Request) -> Response:
    """``GET /static/{file}``: a file of the page."""
    own = {path.name: path for path in _HERE.glob("static/[!.]*") if path.is_file()}
    return _send(request, own.get(request.path_params["file"]))


async def bokeh(request: Request) -> Response:
    """``GET /bokeh/{file}``: a file of BokehJS, from the installed package."""
    return _send(request, _bokeh_files().get(request.path_params["file"]))


@cache
def _bokeh_files() -> dict[str, Path]:
    """Return what is sent of BokehJS, by name; found without importing the package."""
    package = find_spec("bokeh")
    assert package is not None
    assert package.origin is not None
    folder = Path(package.origin).parent / "server" / "static" / "js"
    return {name: folder / name for name in _BOKEH_FILES}


def _send(request: Request, path: Path | None) -> Response:
    if path is None:
        raise Refusal(404, "B-WEB-013", "there is no such page")
    answer = StaticFiles().file_response(path, path.stat(), request.scope)
    # asked for again each time, so that a page never mixes the scripts of two versions
    answer.headers["Cache-Control"] = "private, no-cache"
    return answer
