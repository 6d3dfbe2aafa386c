"""``/login``, ``POST /logout`` and ``GET /api/v1/session``: who somebody is, and for how long; the login form is plain
HTML without a script, and nothing but itself to load.
"""

from __future__ import annotations

import re
from urllib.parse import parse_qs

from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response

from bench import __version__
from bench.web.pages import page_of
from bench.web.security.logins import Login, clean_name
from bench.web.security.tokens import draw_id
from bench.web.serving import Serving

PROTO = 1
_FIELDS = 3
_SHOWN = 40  # of a refused name in the audit
_BACK = re.compile(r"/(runs/[A-Za-z0-9_-][A-Za-z0-9._-]{0,199})?")


async def login(request: Request) -> Response:
    """Return name and token against a cookie; the way back is a page of this server."""
    serving: Serving = request.app.state.serving
    if request.method != "POST":
        return RedirectResponse("/", 303)  # somebody who is in already
    form = await _form(request)
    name, back_to = clean_name(form.get("name", "")), safe_way_back(form.get("back_to", "/"))
    address = request.scope["address"]

    shown = form.get("name", "")[:_SHOWN]

    def refuse(wrong: str) -> Response:
        serving.audit.write("login", name=shown, role=None, address=address, ok=False, text=wrong)
        return login_page(request, 401, back_to, wrong, shown)

    if wait_s := serving.limit.wait_s(address):  # the right token waits too, or guessing would go on
        # not in the audit: strangers must not push out what is in it
        return login_page(request, 429, back_to, "login.wait", shown, wait_s)
    role = serving.tokens.role_of(form.get("token", "").strip())
    if role is None:
        serving.limit.failed(address)
        return refuse("login.wrong_token")
    if name is None:
        return refuse("login.wrong_name")
    who = Login(name, role, draw_id())
    serving.audit.write("login", name=name, role=role, address=address, ok=True, text="")
    return RedirectResponse(back_to, 303, {"Set-Cookie": serving.cookies.header(who)})


async def logout(request: Request) -> Response:
    """End the login, so that no copy of its cookie opens anything, and give the command up.

    The reply is JSON like that of a command.
    """
    serving: Serving = request.app.state.serving
    who: Login = request.user
    serving.lease.leave(who)
    serving.logged_out.add(who)
    serving.audit.write("logout", name=who.name, role=who.role, address=request.scope["address"], ok=True, text="")
    return JSONResponse({"ok": True, "text": "logged out"}, headers={"Set-Cookie": serving.cookies.forget()})


async def session(request: Request) -> Response:
    """Answer who is logged in and who has the command."""
    serving: Serving = request.app.state.serving
    who: Login = request.user
    return JSONResponse(
        {
            "proto": PROTO,
            "name": who.name,
            "role": who.role,
            "operator": serving.lease.document(),
            "is_operator": serving.lease.held_by(who),
            "software": __version__,
        }
    )


async def _form(request: Request) -> dict[str, str]:
    """Return fields of the form, the first of each name; nothing for what is none."""
    try:
        fields = parse_qs((await request.body()).decode(), keep_blank_values=True, max_num_fields=_FIELDS)
    except ValueError:
        return {}
    return {name: values[0] for name, values in fields.items()}


def login_page(
    request: Request, status: int, back_to: str = "/", wrong: str = "", name: str = "", wait_s: int = 0
) -> Response:
    """Return the form; ``back_to`` is where a login leads, ``wrong`` the key of the text that says what went wrong
    with what was typed as ``name``."""
    shown = {"name": name, "back_to": safe_way_back(back_to), "wrong": wrong, "seconds": wait_s}
    headers = {"Retry-After": str(wait_s)} if wait_s else None
    return page_of(request, "login.html.j2", status=status, headers=headers, **shown)


def safe_way_back(path: str) -> str:
    """Return ``path`` if it is a page of this server, else its first page: a login leads nowhere else."""
    return path if _BACK.fullmatch(path) else "/"
