"""What the checks ask of the machine the controller runs on: files of the kernel, programs, limits of the process.

Nothing here raises and nothing waits longer than its limit: a machine without systemd, a container, another kernel
answer "unknown" (None).
"""

from __future__ import annotations

import ctypes
import os
import resource
import struct
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

_TIMEX_BYTES = 512  # struct timex has 208 bytes on 64-bit Linux
_TIMEX = struct.Struct("i4xqqqqi")  # modes, offset, frequency, largest error, estimated error, status
_UNSYNCHRONISED = 0x0040  # STA_UNSYNC


@dataclass(frozen=True)
class KernelClock:
    """State of the kernel's clock: is it disciplined by anything, and its own estimate of its largest error, second.

    Source: adjtimex(2), STA_UNSYNC and maxerror.
    """

    synchronised: bool
    largest_error_s: float


class Host:
    """The machine as it is; tests put another one in its place."""

    def text(self, path: str) -> str | None:
        """A small file of /proc or /sys, None if it cannot be read."""
        try:
            return Path(path).read_text(encoding="utf-8", errors="replace").strip()
        except OSError:
            return None

    def names(self, folder: str) -> list[str]:
        """Return what a folder holds, [] if it cannot be read."""
        try:
            return sorted(path.name for path in Path(folder).iterdir())
        except OSError:
            return []

    def exists(self, path: str) -> bool:
        """Return whether there is such a file or folder."""
        return Path(path).exists()

    def terminal(self, descriptor: int | None) -> str:
        """Device of an open terminal, "" if it is none."""
        try:
            return "" if descriptor is None else os.ttyname(descriptor)
        except OSError:
            return ""

    def output(self, words: Sequence[str], limit_s: float = 5.0) -> str | None:
        """Return what a program prints; None if it is missing, fails or takes longer than ``limit_s``."""
        try:
            done = subprocess.run(words, capture_output=True, text=True, timeout=limit_s, check=True)
        except (OSError, subprocess.SubprocessError):
            return None
        return done.stdout.strip()

    def kernel_clock(self) -> KernelClock | None:
        """Return the kernel's clock; None where it cannot be asked."""
        if struct.calcsize("l") != 8:
            return None
        try:
            library = ctypes.CDLL(None)
            answer = ctypes.create_string_buffer(_TIMEX_BYTES)
            if library.adjtimex(answer) < 0:
                return None
        except (OSError, AttributeError):
            return None
        _, _, _, largest_us, _, status = _TIMEX.unpack_from(answer.raw)
        return KernelClock(not status & _UNSYNCHRONISED, largest_us * 1e-6)

    def most_open_files(self) -> int | None:
        """Descriptors the process may have open; None: no limit."""
        return _soft(resource.RLIMIT_NOFILE)

    def largest_file_bytes(self) -> int | None:
        """Size a file may have; None: no limit."""
        return _soft(resource.RLIMIT_FSIZE)

    def version(self, package: str) -> str | None:
        """Version of an installed package."""
        try:
            return metadata.version(package)
        except metadata.PackageNotFoundError:
            return None

    def newest_change_utc_ns(self, folder: Path) -> int | None:
        """When the newest entry of a folder was changed, nanoseconds since 1970; None if it holds nothing."""
        try:
            return max((entry.stat(follow_symlinks=False).st_mtime_ns for entry in os.scandir(folder)), default=None)
        except OSError:
            return None


def _soft(kind: int) -> int | None:
    soft, _ = resource.getrlimit(kind)
    return None if soft == resource.RLIM_INFINITY else soft
