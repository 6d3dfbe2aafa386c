"""Scripts, styles and icons: own ones from ``static``, BokehJS from the installed package; only names of a list."""

from __future__ import annotations

import mimetypes
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path

from starlette.requests import Request
from starlette.responses import Response

from bench.web.security.refusal import Refusal

BOKEH_FILES = ("bokeh.min.js",)
_OWN = Path(__file__).parent / "static"
_TYPES = {".js": "text/javascript", ".mjs": "text/javascript", ".svg": "image/svg+xml", ".css": "text/css"}


@dataclass(frozen=True)
class Asset:
    """One file as it is sent."""

    content: bytes
    media_type: str
    etag: str


async def static(request: Request) -> Response:
    """Return a file of the page."""
    return _send(request, own_files().get(request.path_params["file"]))


async def bokeh(request: Request) -> Response:
    """Return a file of BokehJS."""
    return _send(request, bokeh_files().get(request.path_params["file"]))


def own_files() -> dict[str, Path]:
    """Return what there is to send of our own, by name."""
    return {path.name: path for path in _OWN.iterdir() if path.is_file() and not path.name.startswith(".")}


@cache
def bokeh_files() -> dict[str, Path]:
    """Return what is sent of BokehJS, by name; found without importing the package."""
    package = find_spec("bokeh")
    assert package is not None
    assert package.origin is not None
    folder = Path(package.origin).parent / "server" / "static" / "js"
    return {name: folder / name for name in BOKEH_FILES}


def _send(request: Request, path: Path | None) -> Response:
    if path is None:
        raise Refusal(404, "B-WEB-013", "there is no such page")
    asset = _read(path, path.stat().st_mtime_ns)
    # asked for again each time, so that a page never mixes the scripts of two versions
    headers = {"ETag": asset.etag, "Cache-Control": "private, no-cache"}
    if asset.etag in request.headers.get("if-none-match", ""):
        return Response(status_code=304, headers=headers)
    return Response(asset.content, media_type=asset.media_type, headers=headers)


@cache
def _read(path: Path, changed_ns: int) -> Asset:
    del changed_ns  # only tells one content from the next
    content = path.read_bytes()
    kind = _TYPES.get(path.suffix) or mimetypes.guess_type(path.name)[0] or "application/octet-stream"
    return Asset(content, kind, f'"{sha256(content).hexdigest()[:32]}"')
