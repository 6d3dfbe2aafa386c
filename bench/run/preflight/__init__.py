"""What is looked at before a run begins: the bench, its links, its papers and the machine."""

from bench.run.preflight.context import Surroundings
from bench.run.preflight.finding import Finding, Report, Status
from bench.run.preflight.inhibit import stay_awake
from bench.run.preflight.live import examine, examine_machine
from bench.run.preflight.survey import Preflight

__all__ = [
    "Finding",
    "Preflight",
    "Report",
    "Status",
    "Surroundings",
    "examine",
    "examine_machine",
    "stay_awake",
]
