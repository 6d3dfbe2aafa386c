"""What a finished session holds, in the form that analysis and report need; from a run or from the folder alone."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench import __version__
from bench.analysis.analysis import Analysis
from bench.analysis.joined import joined
from bench.analysis.material import Exchange, Material, Reading, Trace
from bench.analysis.registry import analyse
from bench.analysis.results import INCOMPLETE, build_results
from bench.frame import CommandLayout, parse_frame
from bench.model.clock import NS
from bench.plan import Step
from bench.record import RecordRow
from bench.replay.parts import Splice
from bench.report import Report, RunStory, TemperatureTrace, report_model
from bench.run.preflight import report_table
from bench.session.happenings import happening_tables, punctuality
from bench.session.line_times import line_times_s
from bench.session.operation import alarms_raised, commands_given, hashes_of, length_s, surroundings
from bench.session.splices import splice_documents, splice_tables

SOFTWARE = f"inertial-bench {__version__}"
KEPT_EVENTS = (
    "environment", "prompt", "phase", "slip", "overrun", "late", "retake", "skip", "error", "end", "reading", "hold",
    "release", "resume", "reentry", "link", "interlock", "alarm", "guard", "preflight", "verdict", "config",
    "clock_step", "control", "surroundings", "exchange",
)  # fmt: skip


@dataclass
class SessionView:
    """One session: manifest, records, counts and the few events that a report shows.

    ``counts``: frames, frames_bad, frames_lost over all links; ``events``: (kind, t_mono_ns, fields) in order.
    ``splices``: where the run was gone on with; ``incomplete``: the run has not ended. ``utc_offset_ns``: UTC minus
    monotonic time, None if unknown; ``make_up``: hashes of the sessions that complete this one. ``texts``: the YAML
    texts the run was made from, by name.
    """

    manifest: Mapping[str, Any]
    rows: Sequence[RecordRow]
    counts: Mapping[str, int]
    session_sha256: str
    plan_steps: Sequence[Step] = ()
    events: list[tuple[str, int, Mapping[str, Any]]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    damaged: bool = False
    splices: Sequence[Splice] = ()
    incomplete: bool = False
    utc_offset_ns: int | None = None
    make_up: tuple[str, ...] = ()
    series: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    texts: Mapping[str, str] = field(default_factory=dict)

    def events_of(self, kind: str) -> list[tuple[int, Mapping[str, Any]]]:
        """Times and fields of all events of one kind."""
        return [(t_ns, fields) for found, t_ns, fields in self.events if found == kind]

    @property
    def has_analysis(self) -> bool:
        """False for a sequence that only records."""
        return str(self.manifest.get("campaign", {}).get("analysis", "none")) != "none"


def analyse_view(view: SessionView, method: str | None = None) -> tuple[dict[str, Any], Analysis]:
    """Estimates of a session and the document results.json."""
    manifest = view.manifest
    analysis = analyse(material_of(view), method)
    counts = {
        **view.counts,
        "records": len(view.rows),
        "retaken": len(view.events_of("retake")),
        "splices": len(view.splices),
    }
    provenance = {
        "simulated": manifest["simulated"],
        "plan_sha256": manifest["plan_sha256"],
        "frame_sha256": manifest["frame_sha256"].get(manifest["measurement_link"], ""),
        "session_sha256": view.session_sha256,
        "software": SOFTWARE,
    }
    if view.make_up:
        provenance["make_up_sha256"] = list(view.make_up)
    decision = manifest["campaign"].get("decision")
    document = build_results(
        manifest["session"], analysis, counts, provenance, decision,
        splices=splice_documents(view.splices), incomplete=view.incomplete,
    )  # fmt: skip
    return document, analysis


def material_of(view: SessionView) -> Material:
    """What the analysis may see of a session."""
    return Material(
        rows=joined(view.rows),
        campaign=view.manifest["campaign"],
        standards=view.manifest["standards"],
        trace=_trace(view),
        readings=[_reading(t_ns, fields) for t_ns, fields in view.events_of("reading")],
        series=view.series,
        exchanges=_last_of_each([_exchange(fields) for _, fields in view.events_of("exchange")]),
        layouts=_layouts(view),
        utc_offset_s=None if view.utc_offset_ns is None else view.utc_offset_ns / NS,
        line_s=line_times_s(view.manifest, view.texts),
    )


def _last_of_each(exchanges: Sequence[Exchange]) -> list[Exchange]:
    """A test that was done again, because the run was stopped within its item, counts as it was done last."""
    last = {one.step: number for number, one in enumerate(exchanges)}
    return [one for number, one in enumerate(exchanges) if not one.item or last[one.step] == number]


def _exchange(fields: Mapping[str, Any]) -> Exchange:
    return Exchange(
        step=int(fields["step"]),
        item=str(fields["item"]),
        name=str(fields["name"]),
        sequence=int(fields["sequence"]),
        attempts=int(fields["attempts"]),
        begin_s=int(fields["begin_ns"]) / NS,
        end_s=int(fields["end_ns"]) / NS,
        status=None if fields["status"] is None else int(fields["status"]),
        refused=bool(fields["refused"]),
        sent=bytes.fromhex(fields["sent"]),
        received=bytes.fromhex(fields["received"]),
        conditions=dict(fields.get("conditions", {})),
    )


def _layouts(view: SessionView) -> Mapping[str, CommandLayout]:
    """Payloads of the measurement link's commands, from the frame definition the session holds."""
    name = view.manifest.get("links", {}).get(view.manifest.get("measurement_link"))
    return parse_frame(view.texts[name], name).commands if name in view.texts else {}


def _reading(t_ns: int, fields: Mapping[str, Any]) -> Reading:
    return Reading(
        t_s=t_ns / NS,
        step=int(fields["step"]),
        role=str(fields["role"]),
        name=str(fields["name"]),
        value=fields["value"],
        conditions=dict(fields.get("conditions", {})),
        arguments=dict(fields.get("arguments", {})),
    )


def report_html(view: SessionView, results: Mapping[str, Any], analysis: Analysis) -> str:
    """The report as one HTML page."""
    return report_of(view, results, analysis).html()


def report_of(view: SessionView, results: Mapping[str, Any], analysis: Analysis) -> Report:
    """The report, drawn; it can be written as a page and on paper."""
    model = report_model(
        results,
        view.rows,
        view.plan_steps,
        temperature_trace(view),
        view.manifest,
        prepare_s=float(view.manifest["planned"]["prepare_s"]),
        residuals=analysis.residuals,
        components=analysis.components,
        prompts=[dict(fields) for _, fields in view.events_of("prompt")],
        figures=analysis.figures,
        tables=analysis.tables,
        notes=[*([INCOMPLETE] if view.incomplete else []), *analysis.notes, *punctuality(view), *view.notes],
        run=_story(view),
    )
    return Report(model)


def _story(view: SessionView) -> RunStory:
    return RunStory(
        tables=tuple(_about_the_run(view)),
        commands=tuple(commands_given(view)),
        alarms=tuple(alarms_raised(view)),
        surroundings=tuple(surroundings(view, view.texts, _campaign_ns(view))),
        length_s=length_s(view),
        hashes=hashes_of(view.texts),
    )


def _about_the_run(view: SessionView) -> list[dict[str, Any]]:
    looked_at = [report_table(fields) for _, fields in view.events_of("preflight")]
    return [*happening_tables(view), *splice_tables(view.splices), *looked_at]


def temperature_trace(view: SessionView) -> TemperatureTrace:
    """Temperatures against seconds from the start of the campaign phase."""
    start_ns = _campaign_ns(view)
    trace = _trace(view)
    gaps_s = [splice.at_ns / NS for splice in view.splices]  # the lines are broken where nothing was recorded
    at = np.searchsorted(trace.t_s, gaps_s)
    return TemperatureTrace(
        t_s=np.insert(trace.t_s, at, gaps_s) - start_ns / NS,
        air_degC=np.insert(trace.air_degC, at, np.nan),
        unit_degC=np.insert(trace.unit_degC, at, np.nan),
    )


def _campaign_ns(view: SessionView) -> int:
    return next((t for t, fields in view.events_of("phase") if fields["name"] == "campaign"), 0)


def _trace(view: SessionView) -> Trace:
    temperatures = view.events_of("environment")
    return Trace(
        t_s=np.array([t_ns / NS for t_ns, _ in temperatures]),
        air_degC=np.array([_number(fields["air_degC"]) for _, fields in temperatures]),
        unit_degC=np.array([_number(fields["unit_degC"]) for _, fields in temperatures]),
    )


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
