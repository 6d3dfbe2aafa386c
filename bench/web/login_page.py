"""The login form: plain HTML without a script, and nothing but itself to load."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined, Template
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response

from bench.model.texts import Texts
from bench.web.pages import language_of

FOLDER = Path(__file__).parent
_BACK = re.compile(r"/(runs/[A-Za-z0-9_-][A-Za-z0-9._-]{0,199})?")


def login_page(
    request: Request, status: int, back_to: str = "/", wrong: str = "", name: str = "", wait_s: int = 0
) -> Response:
    """The form; ``back_to`` is where a login leads, ``wrong`` the key of the text that says what went wrong
    with what was typed as ``name``."""
    texts = Texts(FOLDER, language_of(request))
    page = _template().render(
        text=texts, name=name, back_to=safe_way_back(back_to), wrong=texts(wrong, seconds=wait_s) if wrong else ""
    )
    return HTMLResponse(page, status, {"Retry-After": str(wait_s)} if wait_s else None)


def safe_way_back(path: str) -> str:
    """``path`` if it is a page of this server, else its first page: a login leads nowhere else."""
    return path if _BACK.fullmatch(path) else "/"


@cache
def _template() -> Template:
    environment = Environment(
        loader=FileSystemLoader(FOLDER / "templates"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    return environment.get_template("login.html.j2")
