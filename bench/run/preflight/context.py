"""The context of the pre-flight checks, the machine and the bench that is about to run; and the findings.

Nothing of the machine raises and nothing waits longer than its limit: a machine without systemd, a container, another
kernel answer "unknown" (None). All findings together are a table, an event, or the refusal to start.
"""

from __future__ import annotations

import ctypes
import os
import struct
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import StrEnum
from importlib import metadata
from pathlib import Path

from bench.model.clock import NS, VIRTUAL_START_UTC_NS, Clock
from bench.model.errors import BenchError, InputError, InstrumentError
from bench.model.events import Preflight
from bench.model.ports import ByteLink, Instrument
from bench.model.posix import soft_limit
from bench.plan import Plan, Station, roles_of

_TIMEX_BYTES = 512  # struct timex has 208 bytes on 64-bit Linux
_TIMEX = struct.Struct("i4xqqqqi")  # modes, offset, frequency, largest error, estimated error, status
_UNSYNCHRONISED = 0x0040  # STA_UNSYNC
_NEXT = "put it right, then look again with 'bench check SEQUENCE --station STATION --live'"


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
        """Return a small file of /proc or /sys, None if it cannot be read."""
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
        """Return device of an open terminal, "" if it is no terminal."""
        try:
            return "" if descriptor is None else os.ttyname(descriptor)
        except (OSError, AttributeError):
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
        except (OSError, AttributeError, TypeError):  # another kernel; Windows has no library without a name
            return None
        _, _, _, largest_us, _, status = _TIMEX.unpack_from(answer.raw)
        return KernelClock(not status & _UNSYNCHRONISED, largest_us * 1e-6)

    def most_open_files(self) -> int | None:
        """Return descriptors the process may have open; None: no limit."""
        return soft_limit("RLIMIT_NOFILE")

    def largest_file_bytes(self) -> int | None:
        """Return size a file may have; None: no limit."""
        return soft_limit("RLIMIT_FSIZE")

    def version(self, package: str) -> str | None:
        """Return version of an installed package."""
        try:
            return metadata.version(package)
        except metadata.PackageNotFoundError:
            return None

    def newest_change_utc_ns(self, folder: Path) -> int | None:
        """Return when the newest entry of a folder was changed, nanoseconds since 1970; None if it holds nothing."""
        try:
            return max((entry.stat(follow_symlinks=False).st_mtime_ns for entry in os.scandir(folder)), default=None)
        except OSError:
            return None


@dataclass(kw_only=True)
class Surroundings:
    """The machine a run would take place on; ``out`` is where its session would go."""

    clock: Clock
    out: Path
    host: Host = field(default_factory=Host)


@dataclass(kw_only=True)
class PreflightContext(Surroundings):
    """The bench that is about to run: its plan, what of it is open, and the machine.

    ``absent`` holds, by role or link, why something could not be opened; ``uncommissioned`` why drivers with commands
    that nobody has confirmed may be used all the same ("" = they may not). ``asks_only``: nothing may be set.
    """

    plan: Plan
    instruments: Mapping[str, Instrument]
    links: Mapping[str, ByteLink]
    absent: Mapping[str, BenchError] = field(default_factory=dict)
    uncommissioned: str = ""
    asks_only: bool = False

    @property
    def station(self) -> Station:
        """The station of the plan."""
        return self.plan.station

    @property
    def in_process(self) -> bool:
        """True for a bench that is simulated inside this process: nothing of it is a machine's affair."""
        return self.station.in_process

    @property
    def used_roles(self) -> set[str]:
        """Roles of instruments that a step of the plan talks to."""
        return roles_of(self.plan.steps) & self.station.instruments.keys()

    @property
    def length_s(self) -> float:
        """Planned time from the first prompt to the last step, second."""
        return self.plan.prepare_s + self.plan.duration_s + self.plan.finally_s

    @property
    def start_utc(self) -> datetime:
        """Start of the run if it starts now; that of virtual time on a bench simulated in this process."""
        utc_ns = VIRTUAL_START_UTC_NS if self.in_process else self.clock.utc_ns()
        return datetime.fromtimestamp(utc_ns / NS, UTC)


class Status(StrEnum):
    """``warn`` is told and goes on, ``fail`` keeps the run from starting, ``skipped`` says why nothing was judged."""

    OK = "ok"
    WARN = "warn"
    FAIL = "fail"
    SKIPPED = "skipped"


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at: what was found, what is due, and a sentence for a person.

    ``of_bench`` tells a fault of the bench (exit status 3) from a mistake in files, folders or the plan (2).
    """

    name: str
    status: Status
    value: str = ""
    limit: str = ""
    text: str = ""
    of_bench: bool = False


@dataclass(frozen=True)
class Report:
    """All findings, in the order in which they were made."""

    findings: tuple[Finding, ...]

    def of(self, status: Status) -> list[Finding]:
        """Return the findings of one status."""
        return [finding for finding in self.findings if finding.status is status]

    def refusal(self) -> BenchError | None:
        """Return one error that lists everything that keeps the run from starting; None if nothing does.

        B-RUN-081 if anything of it is a fault of the bench, else B-RUN-080.
        """
        failed = self.of(Status.FAIL)
        if not failed:
            return None
        message = f"not started: {'; '.join(told(finding) for finding in failed)}"
        if any(finding.of_bench for finding in failed):
            return InstrumentError("B-RUN-081", message, where="pre-flight", next_step=_NEXT)
        return InputError("B-RUN-080", message, where="pre-flight", next_step=_NEXT)

    def event(self) -> Preflight:
        """Return the findings as an event of the session (docs/unattended.md)."""
        return Preflight(
            ok=len(self.of(Status.OK)),
            warn=len(self.of(Status.WARN)),
            fail=len(self.of(Status.FAIL)),
            skipped=len(self.of(Status.SKIPPED)),
            findings=[fields_of(finding) for finding in self.findings],
        )


def told(finding: Finding) -> str:
    """Return a finding in one clause."""
    limit = f" (due: {finding.limit})" if finding.limit else ""
    value = f" {finding.value}" if finding.value else ""
    return f"{finding.name}:{value}{limit}{', ' if value or limit else ' '}{finding.text}".rstrip(", :")


def fields_of(finding: Finding) -> dict[str, str]:
    """Return a finding as plain words."""
    return {name: str(getattr(finding, name)) for name in ("name", "status", "value", "limit", "text")}
