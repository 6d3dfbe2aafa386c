"""The controller's side of a guard process: starts it, tells it that all is well, and ends the run if it is gone."""

from __future__ import annotations

import json
import os
import select
import subprocess
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import bench
from bench.model.clock import NS, Clock
from bench.model.errors import RunError
from bench.model.events import Guard
from bench.model.posix import GUARD, own_process
from bench.run.guard.decision import Brief
from bench.run.guard.process import READY
from bench.run.stop import CHAMBER_AIR, LINKS, SEQUENCER, Health, StopSwitch, guarded

BEAT_S = 0.5
# The last heartbeat is sent when the sequencer was silent for less than 1.5 s, the longest call of a driver; with the
# guard's own 2 s a hang is acted on 3 to 3.5 s after the last sign of life. A writer that waits for a slow disk is no
# reason to end a run: it stands still meanwhile (bench.run.watch.disk).
LONGEST_SILENCE_S = {SEQUENCER: 1.5, LINKS: 3.0}
START_S = 30.0
UNANSWERED_S = 5.0
GOODBYE_S = 5.0
_READ_BYTES = 65536
_AT_WORK: list[subprocess.Popen[bytes]] = []  # guards that this process has left behind


class GuardProcess:
    """A guard process and the heartbeat to it; context manager, left with a goodbye that says what is not confirmed.

    A guard that has to go on after it is left alone, and outlives this process.
    The run ends (B-RUN-091) at the next check when the guard has ended or does not answer: never without a guard.
    Raises: RunError B-RUN-090 on entering if the guard does not start.
    """

    def __init__(
        self, brief: Brief, health: Health, stop: StopSwitch, clock: Clock, tell: Callable[[Guard], None]
    ) -> None:
        self._brief = brief
        self._roles = {address.role for address in brief.instruments}
        self._health = health
        self._stop = stop
        self._clock = clock
        self._tell = tell
        self._lock = threading.Lock()
        self._withheld, self._said_goodbye = "", False
        self._lost = False
        self._unanswered_ns: int | None = None
        self._begun_ns = clock.now_ns()

    def _start(self) -> None:
        command = own_process(GUARD)
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(
            command, stdin=pipe, stdout=pipe, stderr=pipe, start_new_session=True, env=_environment()
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._to, self._from = self._process.stdin.fileno(), self._process.stdout.fileno()
        with suppress(OSError):
            os.write(self._to, self._brief.line())
        if not self._is_ready():
            raise self._not_started()
        os.set_blocking(self._to, False)
        os.set_blocking(self._from, False)

    def __enter__(self) -> GuardProcess:
        self._start()
        self._tell(Guard(state="ready", pid=self._process.pid))
        self._periodic = self._clock.every(BEAT_S, guarded(self.beat, self._stop))
        self.beat()
        return self

    def __exit__(self, *_: object) -> None:
        self._periodic.cancel()
        with self._lock:
            left = self._say_goodbye()
            if left and self._process.poll() is not None:  # the one that died is replaced: somebody has to go on
                self._close_pipes()
                with suppress(RunError):
                    self._start()
                    self._said_goodbye = False
                    self._say_goodbye()
        self._close_pipes()
        if left:
            _AT_WORK.append(self._process)
        else:
            self._end()

    def _say_goodbye(self) -> dict[str, str]:
        """Say once what this controller leaves behind; returns it."""
        left = {role: state for role, state in self._health.unconfirmed.items() if role in self._roles}
        if not self._said_goodbye:
            self._said_goodbye = True
            self._send({"goodbye": left, "heat_off": self._health.heat_off})
        return left

    def beat(self) -> None:
        """Tell the guard that all is well, if it is; what is left at the end is the guard's at once."""
        if self._health.is_over and self._health.unconfirmed:
            with self._lock:
                self._say_goodbye()
            return
        silence_s = self._health.silence_s()
        silent = [part for part, limit_s in LONGEST_SILENCE_S.items() if silence_s.get(part, 0.0) >= limit_s]
        with self._lock:
            if silent and not self._withheld:
                self._tell(Guard(state="withheld", parts=silent))
            self._withheld = " ".join(silent)
            if not silent and not self._lost:
                self._send({"values": self._health.values(), "air_age_s": self._air_age_s(), "at": self._health.at()})
                self._hear()

    def _air_age_s(self) -> float:
        """Return the age of the newest reading of the chamber's air; without any, for how long it could have come."""
        age_s = self._health.age_s(CHAMBER_AIR)
        return (self._clock.now_ns() - self._begun_ns) / NS if age_s is None else age_s

    def _send(self, message: Mapping[str, Any]) -> None:
        try:
            os.write(self._to, json.dumps(message, separators=(",", ":")).encode() + b"\n")
        except BlockingIOError:
            pass  # the guard does not read: its answers will be missed
        except OSError as error:
            self._lose(f"the guard has ended ({error.strerror})")

    def _hear(self) -> None:
        """Each heartbeat is answered; the run must not go on under a guard that is stopped."""
        now_ns = self._clock.now_ns()
        try:
            answer: bytes | None = os.read(self._from, _READ_BYTES)
        except BlockingIOError:
            answer = None
        if answer == b"":
            self._lose("the guard has ended")
        elif answer is not None:
            self._unanswered_ns = None
        elif self._unanswered_ns is None:
            self._unanswered_ns = now_ns
        elif now_ns - self._unanswered_ns > UNANSWERED_S * NS:
            self._lose(f"the guard has not answered for {UNANSWERED_S:g} s")

    def _lose(self, text: str) -> None:
        if self._lost or self._stop.over:
            return
        self._lost = True
        self._tell(Guard(state="lost", text=text))
        self._stop.fail(
            RunError(
                "B-RUN-091",
                f"{text}; the run does not go on without it",
                where="guard",
                next_step="look into guard.jsonl of the session, then 'bench resume SESSION'",
            )
        )

    def _is_ready(self) -> bool:
        heard = b""
        while not heard.endswith(READY):
            readable, _, _ = select.select([self._from], [], [], START_S)
            chunk = os.read(self._from, _READ_BYTES) if readable else b""
            if not chunk:
                return False
            heard += chunk
        return True

    def _not_started(self) -> RunError:
        self._process.kill()
        _, problem = self._process.communicate()
        last = problem.decode(errors="replace").strip().rpartition("\n")[2] or f"it was not ready after {START_S:g} s"
        return RunError(
            "B-RUN-090",
            f"the guard process did not start: {last}",
            where="guard",
            next_step="'bench drill' shows whether it works; nothing was switched on",
        )

    def _close_pipes(self) -> None:
        for stream in (self._process.stdin, self._process.stdout, self._process.stderr):
            if stream is not None:
                with suppress(OSError):
                    stream.close()

    def _end(self) -> None:
        """Let the guard go; one that does not is of no use any more."""
        try:
            self._process.wait(GOODBYE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def _environment() -> dict[str, str]:
    """The guard finds the same packages as the controller, wherever it was started."""
    own = str(Path(bench.__file__).resolve().parents[1])
    known = os.environ.get("PYTHONPATH", "")
    return {**os.environ, "PYTHONPATH": own if not known else os.pathsep.join((own, known))}
