"""What a check before the run has found, and all of them together: a table, an event, or the refusal to start."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from bench.model.errors import BenchError, InputError, InstrumentError
from bench.model.events import Preflight

_NEXT = "put it right, then look again with 'bench check SEQUENCE --station STATION --live'"


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
        """One error that lists everything that keeps the run from starting; None if nothing does.

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
    return {
        "name": finding.name,
        "status": str(finding.status),
        "value": finding.value,
        "limit": finding.limit,
        "text": finding.text,
    }
