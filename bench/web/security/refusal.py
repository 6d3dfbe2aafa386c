"""Refusals of the page server: a status, a code and a text as JSON, like every error of the bench."""

from __future__ import annotations

from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from bench.model.errors import BenchError, InputError


class Refusal(InputError):
    """A request that is not done. ``status``: of HTTP; ``wait_s``: when to try again, 0 for never."""

    def __init__(self, status: int, code: str, message: str, *, next_step: str = "", wait_s: int = 0) -> None:
        super().__init__(code, message, next_step=next_step)
        self.status = status
        self.wait_s = wait_s

    def response(self) -> Response:
        return answer(self, self.status, self.wait_s)


def answer(error: BenchError, status: int, wait_s: int = 0) -> Response:
    """Return ``{"error": code, "text": what is wrong and what to do}``."""
    advice = f" Next: {error.next_step}" if error.next_step else ""
    headers = {"Retry-After": str(wait_s)} if wait_s else {}
    return JSONResponse({"error": error.code, "text": f"{error.message}.{advice}"}, status, headers)


async def on_bench_error(request: Request, error: Exception) -> Response:
    """Errors that handlers raise on purpose; where they happened on the disk is nobody's business."""
    del request
    if isinstance(error, Refusal):
        return error.response()
    assert isinstance(error, BenchError)
    return answer(error, 400)
