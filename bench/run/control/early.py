"""Early verdicts beside a run: a process of its own judges what is recorded so far, and the run only listens.

Whatever becomes of that process (it crashes, hangs, prints nonsense), the run goes on; a verdict that could not be
given is an event like any other.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from bench.model.clock import to_ns
from bench.model.errors import RunError
from bench.model.events import Verdict
from bench.model.posix import EARLY_VERDICT, own_process
from bench.plan import Early
from bench.run.context import RunContext
from bench.run.control.channel import EARLY
from bench.run.stop import HOLD_LIMIT_S, repeated

LIMITS = ("max_lost", "max_bad", "max_dispersion", "max_residual")
TIMEOUT_S = 900.0
POLL_S = 1.0
MOST_OUTPUT = 1_000_000


def judge_command(folder: Path, early: Early) -> list[str]:
    """Return the process that judges a session."""
    limits = {name: getattr(early, name) for name in LIMITS}
    return own_process(EARLY_VERDICT, str(folder), json.dumps(limits))


class EarlyVerdicts:
    """Starts the judge when a verdict is due and hears what it says; ``poll`` never waits."""

    def __init__(self, early: Early, context: RunContext, command: list[str], timeout_s: float = TIMEOUT_S) -> None:
        self._early = early
        self._context = context
        self._command = command
        self._timeout_ns = to_ns(timeout_s)
        self._next_ns = context.clock.now_ns() + to_ns(early.after)
        self._process: subprocess.Popen[bytes] | None = None
        self._output: IO[bytes] | None = None
        self._until_ns = 0

    def poll(self) -> None:
        """Call each second: start, hear or end the judge."""
        now_ns = self._context.clock.now_ns()
        if self._process is not None:
            if self._process.poll() is not None:
                self._take(self._finished())
            elif now_ns > self._until_ns:
                self.close()
                self._take(Verdict(ok=None, error="no verdict in time"))
        elif now_ns >= self._next_ns and not self._context.stop.over:
            self._next_ns = now_ns + to_ns(self._early.every)
            self._start(now_ns)

    def close(self) -> None:
        """End the judge, if it is at work."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._forget()

    def _start(self, now_ns: int) -> None:
        try:
            self._output = tempfile.TemporaryFile()  # noqa: SIM115 - closed by _forget
            self._process = subprocess.Popen(
                self._command, stdin=subprocess.DEVNULL, stdout=self._output, stderr=subprocess.DEVNULL,
                start_new_session=True,
            )  # fmt: skip
        except OSError as error:
            self._forget()
            self._take(Verdict(ok=None, error=f"the judge does not start: {error.strerror or error}"))
        self._until_ns = now_ns + self._timeout_ns

    def _finished(self) -> Verdict:
        assert self._process is not None
        assert self._output is not None
        status = self._process.returncode
        self._output.seek(0)
        text = self._output.read(MOST_OUTPUT)
        self._forget()
        try:
            document = json.loads(text) if status == 0 else None
        except ValueError:
            document = None
        verdict = Verdict.read(document) if isinstance(document, dict) else None
        return Verdict(ok=None, error=f"exit status {status}") if verdict is None or verdict.raw else verdict

    def _forget(self) -> None:
        if self._output is not None:
            self._output.close()
        self._process = self._output = None

    def _take(self, verdict: Verdict) -> None:
        self._context.event(verdict)
        if verdict.ok is False:
            self._react(verdict.failed)

    def _react(self, said: str) -> None:
        if self._early.on_fail == "hold":
            self._context.stop.holds.hold(EARLY, said, HOLD_LIMIT_S)
        elif self._early.on_fail == "abort":
            advice = "look at the event 'verdict' of the session; 'bench fit SESSION' shows what it holds"
            self._context.stop.fail(RunError("B-RUN-072", said, where=EARLY, next_step=advice))


@contextmanager
def early_verdicts(context: RunContext, early: Early) -> Iterator[EarlyVerdicts]:
    """Judge while the run goes on, on the wall clock."""
    verdicts = EarlyVerdicts(early, context, judge_command(context.folder, early))
    try:
        with repeated(context.clock, context.stop, (POLL_S, verdicts.poll)):
            yield verdicts
    finally:
        verdicts.close()
