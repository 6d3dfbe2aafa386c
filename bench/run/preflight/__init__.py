"""What is looked at before a run begins: the bench, its links, its papers and the machine."""

from bench.run.preflight.context import PreflightContext, Surroundings
from bench.run.preflight.finding import Finding, Report, Status, report_table, told
from bench.run.preflight.host import Host
from bench.run.preflight.live import examine, examine_machine
from bench.run.preflight.survey import Check, Preflight, survey

__all__ = [
    "Check",
    "Finding",
    "Host",
    "Preflight",
    "PreflightContext",
    "Report",
    "Status",
    "Surroundings",
    "examine",
    "examine_machine",
    "report_table",
    "survey",
    "told",
]
