"""What a browser may do with an answer: the headers of every response."""

from __future__ import annotations

import re

from starlette.datastructures import MutableHeaders
from starlette.types import Message

PAGE_CSP = (
    "default-src 'self'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "connect-src 'self'; object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
# a report comes from a folder that may have come from elsewhere: it is shown, and can do nothing
REPORT_CSP = (
    "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:; font-src data:; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)
REPORT = re.compile(r"/api/v1/runs/[^/]*/report")
ASSETS = ("/static/", "/bokeh/")
LOGIN_STATUS = 401
_ALWAYS = {
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Frame-Options": "DENY",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=(), payment=(), usb=(), serial=()",
}


def rules_for(path: str, start: Message) -> list[tuple[bytes, bytes]]:
    """Headers of the ``http.response.start`` message of an answer to ``path``, with the rules put in."""
    headers = MutableHeaders(raw=list(start["headers"]))
    for name, value in _ALWAYS.items():
        headers[name] = value
    headers["Content-Security-Policy"] = REPORT_CSP if REPORT.fullmatch(path) else PAGE_CSP
    # with "no-referrer" a browser sends the login form with "Origin: null", which is refused
    is_form = start["status"] == LOGIN_STATUS and headers.get("content-type", "").startswith("text/html")
    headers["Referrer-Policy"] = "same-origin" if is_form else "no-referrer"
    if not (path.startswith(ASSETS) and start["status"] in (200, 304)):
        headers["Cache-Control"] = "no-store"
    return headers.raw
