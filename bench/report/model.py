"""The contents of a report, before any drawing: plain values with units, nothing to compute twice."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from bench.analysis import Estimate, Figure, Floats, Table, Trace, estimates_of, unit_text
from bench.model.texts import ENGLISH, quantity_title, sequence_title

_CLOCK_OF_A_LOG = "log"  # in the manifest of what was imported


def _no_floats() -> Floats:
    return np.empty(0)


@dataclass(frozen=True)
class Picture:
    """A figure for a page: SVG text without prologue, a caption, and a sentence for readers who do not see it."""

    name: str
    svg: str
    caption: str
    description: str


@dataclass(frozen=True)
class TemperatureTrace(Trace):
    """Temperatures of a run, (n,), degC, at ``t_s`` seconds from the start of the campaign phase; NaN = no reading."""


@dataclass(frozen=True)
class Surrounding:
    """Temperature of a place around the unit, (n,), degC, at ``t_s`` seconds from the start of the campaign phase.

    ``laboratory``: the air of the room, by the station file.
    """

    name: str
    t_s: Floats
    degC: Floats
    laboratory: bool = False


@dataclass(frozen=True)
class Bar:
    """A stretch of the timetable on one lane; seconds from the start of the campaign, negative while preparing."""

    lane: str
    kind: str
    start_s: float
    duration_s: float


@dataclass(frozen=True)
class Timetable:
    """Lanes of bars and the planned temperature as corners of a polyline, (k,), seconds and degC."""

    bars: tuple[Bar, ...] = ()
    planned_t_s: Floats = field(default_factory=_no_floats)
    planned_degC: Floats = field(default_factory=_no_floats)

    @property
    def lanes(self) -> tuple[str, ...]:
        """Names of the lanes, in order of first use."""
        return tuple(dict.fromkeys(bar.lane for bar in self.bars))


@dataclass(frozen=True)
class Residual:
    """One row of the fit: what was left over, ppm of the level, at a signed current of one channel and temperature."""

    channel: int
    kind: str
    temperature_degC: float
    current_A: float
    residual_ppm: float
    std_ppm: float = float("nan")


@dataclass(frozen=True)
class RecordCounts:
    """Records and frames of the session, by what became of them.

    ``by_channel``: records, flagged, frames, bad, lost of each channel; empty if the records belong to no channel.
    """

    records: int = 0
    flagged: int = 0
    frames: int = 0
    bad: int = 0
    lost: int = 0
    by_flag: Mapping[str, int] = field(default_factory=dict)
    by_channel: Mapping[int, tuple[int, int, int, int, int]] = field(default_factory=dict)


@dataclass(frozen=True)
class RunStory:
    """The happenings of a run. ``commands``, ``alarms``: a document for each, ``time`` since the run began.

    ``length_s``: from start to end, NaN if unknown; ``log_s``: of a log of another system.   ``hashes``:
    SHA-256 of the texts the run was made from, by name.   ``damage``: places at which the recording is damaged.
    ``left_out``: the run went on without this unit, which several share.
    """

    tables: tuple[Table, ...] = ()
    commands: tuple[Mapping[str, Any], ...] = ()
    alarms: tuple[Mapping[str, Any], ...] = ()
    surroundings: tuple[Surrounding, ...] = ()
    length_s: float = float("nan")
    log_s: float = float("nan")
    hashes: Mapping[str, str] = field(default_factory=dict)
    damage: int = 0
    left_out: bool = False


@dataclass(frozen=True)
class ReportModel:
    """Everything a report shows. ``results`` is the document of results.json; the rest explains it.

    ``started_utc``: ISO 8601, empty if unknown.   ``main``: quantities that the analysis declares as its main ones.
    ``predicted``: estimates as the plan predicts them, of which the uncertainties count.
    """

    title: str
    results: Mapping[str, Any]
    campaign: Mapping[str, Any] = field(default_factory=dict)
    standards: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    origin: Mapping[str, Any] = field(default_factory=dict)
    identities: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    timetable: Timetable = field(default_factory=Timetable)
    trace: TemperatureTrace = field(default_factory=TemperatureTrace)
    residuals: tuple[Residual, ...] = ()
    components: tuple[Mapping[str, Any], ...] = ()
    counts: RecordCounts = field(default_factory=RecordCounts)
    prompts: tuple[Mapping[str, Any], ...] = ()
    figures: tuple[Figure, ...] = ()
    tables: tuple[Table, ...] = ()
    notes: tuple[str, ...] = ()
    started_utc: str = ""
    run: RunStory = field(default_factory=RunStory)
    main: tuple[str, ...] = ()
    predicted: tuple[Estimate, ...] = ()

    @property
    def simulated(self) -> bool:
        """True unless the provenance says that a real bench was measured; a report never guesses in its favour."""
        return self.results.get("provenance", {}).get("simulated") is not False

    @property
    def of_a_log(self) -> bool:
        """True for the log of another system: nothing of it was measured by a bench."""
        return self.origin.get("clock") == _CLOCK_OF_A_LOG

    @property
    def analysis(self) -> str:
        """Name of the analysis, "" if the results do not say it."""
        return str(self.results.get("campaign", ""))

    @cached_property
    def rows(self) -> Sequence[Estimate]:
        """All estimates, in the order of results.json."""
        return estimates_of(self.results)

    def subject(self, language: str = ENGLISH) -> str:
        """Return the title of the campaign, that of a shipped sequence in a language."""
        campaign, sequence = self.analysis, str(self.origin.get("sequence", ""))
        return unit_text(sequence_title(campaign, sequence, self.title, language))

    def title_of(self, quantity: str, language: str = ENGLISH) -> str:
        """Return the name of a quantity for people."""
        return quantity_title(self.analysis, quantity, language)

    def estimates(self, quantity: str) -> list[Estimate]:
        """Return the estimates of one quantity, in the order of results.json."""
        return [row for row in self.rows if row.quantity == quantity]
