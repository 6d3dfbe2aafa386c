"""Refusals of the page server: a status, a code and a text as JSON, like every error of the bench."""

from __future__ import annotations

from starlette.responses import JSONResponse, Response

from bench.model.errors import BenchError, InputError


class Refusal(InputError):
    """A request that is not done. ``status``: of HTTP; ``wait_s``: when to try again, 0 for never."""

    def __init__(self, status: int, code: str, message: str, *, next_step: str = "", wait_s: int = 0) -> None:
        super().__init__(code, message, next_step=next_step)
        self.status = status
        self.wait_s = wait_s

    @property
    def text(self) -> str:
        """What is wrong and what to do."""
        return f"{self.message}.{f' Next: {self.next_step}' if self.next_step else ''}"

    def response(self) -> Response:
        """Return ``{"error": code, "text": what is wrong and what to do}``."""
        headers = {"Retry-After": str(self.wait_s)} if self.wait_s else {}
        return JSONResponse({"error": self.code, "text": self.text}, self.status, headers)


def refusal_of(error: Exception) -> Refusal:
    """Return an error raised on purpose as a refusal, without the place on the disk, which is nobody's business."""
    assert isinstance(error, BenchError)
    return error if isinstance(error, Refusal) else Refusal(400, error.code, error.message, next_step=error.next_step)
