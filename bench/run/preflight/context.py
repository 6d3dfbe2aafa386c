"""What a check before the run may look at."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from bench.model.clock import NS, VIRTUAL_START_UTC_NS, Clock
from bench.model.errors import BenchError
from bench.model.ports import ByteLink, Instrument
from bench.plan import Plan, Station, roles_of
from bench.run.preflight.host import Host


@dataclass(kw_only=True)
class Surroundings:
    """The machine a run would take place on; ``out`` is where its session would go."""

    clock: Clock
    out: Path
    host: Host = field(default_factory=Host)


@dataclass(kw_only=True)
class PreflightContext(Surroundings):
    """The bench that is about to run: its plan, what of it is open, and the machine.

    ``absent`` holds, by role or link, why something could not be opened.
    """

    plan: Plan
    instruments: Mapping[str, Instrument]
    links: Mapping[str, ByteLink]
    absent: Mapping[str, BenchError] = field(default_factory=dict)

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
        """When the run starts if it starts now; the start of virtual time on a bench simulated in this process."""
        utc_ns = VIRTUAL_START_UTC_NS if self.in_process else self.clock.utc_ns()
        return datetime.fromtimestamp(utc_ns / NS, UTC)
