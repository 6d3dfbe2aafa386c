"""What the pre-flight found, as a table on the terminal."""

from __future__ import annotations

from rich import box
from rich.console import Console
from rich.table import Table

from bench.run.preflight import Finding, Report, Status

_COLUMNS = ("", "looked at", "found", "due")
_MARKS = {Status.OK: "ok", Status.WARN: "WARN", Status.FAIL: "FAIL", Status.SKIPPED: "-"}


def print_preflight(out: Console, found: Report, title: str = "Pre-flight") -> None:
    """Print one line for each finding, and under the table a sentence for each that is not simply in order."""
    table = Table(title=title, box=box.SIMPLE, title_justify="left", collapse_padding=True, pad_edge=False)
    for name in _COLUMNS:
        table.add_column(name, no_wrap=name in _COLUMNS[:2], overflow="fold")
    for finding in found.findings:
        table.add_row(_MARKS[finding.status], finding.name, finding.value, finding.limit)
    out.print(table)
    for status in (Status.FAIL, Status.WARN, Status.SKIPPED):
        for finding in found.of(status):
            out.print(_remark(finding))
    counts = [f"{len(found.of(status))} {status}" for status in Status]
    out.print(", ".join(counts))


def _remark(finding: Finding) -> str:
    return f"{_MARKS[finding.status]:4} {finding.name}: {finding.text or 'no judgement'}"
