"""The process of the controller, as its guard holds it: a handle that no later process can slip into."""

from __future__ import annotations

import os
import select
import signal
from contextlib import suppress


class Controller:
    """The parent process. The handle is a process file descriptor (Linux 5.3); elsewhere the parent's number, which
    is trusted only while it is still the parent's.
    """

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._handle: int | None = None
        with suppress(OSError, AttributeError):
            self._handle = os.pidfd_open(pid)
        self._gone = os.getppid() != pid  # it died before its handle was open: the number may be somebody else's

    def end(self, limit_s: float) -> bool:
        """Kill it, stopped or not, and wait until it has left; False if it has not after ``limit_s``."""
        if self._gone:
            return True
        with suppress(ProcessLookupError):
            if self._handle is not None:
                signal.pidfd_send_signal(self._handle, signal.SIGKILL)
            elif os.getppid() == self._pid:
                os.kill(self._pid, signal.SIGKILL)
        if self._handle is None:
            return os.getppid() != self._pid
        readable, _, _ = select.select([self._handle], [], [], limit_s)
        return bool(readable)
