"""The pre-flight of a run: the bench, its links, its papers and the machine."""

from bench.run.preflight.context import Finding, Report, Status, Surroundings
from bench.run.preflight.of_machine import stay_awake
from bench.run.preflight.survey import Preflight, examine, examine_machine
