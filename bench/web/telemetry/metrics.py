"""Runs as OpenMetrics: ``GET /metrics`` for Prometheus and everything that reads its formats.

The names follow the conventions of Prometheus: base units, ``_total`` for what only grows. What is not known has no
sample: a figure of an hour ago would look like one of now.
Source: OpenMetrics 1.0; the text is written by prometheus_client.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping
from typing import Any

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily, StateSetMetricFamily
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4, generate_latest
from prometheus_client.metrics_core import Metric
from prometheus_client.openmetrics import exposition as openmetrics
from starlette.requests import Request
from starlette.responses import Response

from bench import __version__
from bench.web.now import number_of
from bench.web.recorded.outcome import OUTCOMES
from bench.web.telemetry.lookout import Lookout, SeenRun

LONGEST_LABEL = 200
RUN_STATES = ("starting", "running", "waiting", "holding", "ending", "ended", "stopped", "lost")
_LIVING = RUN_STATES[:5]
ATTENTION = ("none", "some", "much")
OUTPUTS = ("off", "energised", "moving", "unknown")
LINK_STATES = ("waiting", "streaming", "stale", "silent", "lost")
SEVERITIES = ("warning", "alarm", "fault")
_COUNTED = ("frames", "bad", "lost", "duplicate")
_RECORDS = ("planned", "done", "retaken", "flagged")
_ESTIMATE = ("run", "quantity", "unit", "conditions", "quality")

Document = Mapping[str, Any]


class Scrapes:
    """Answers ``GET /metrics``; what several ask for within a second is written once."""

    def __init__(self, lookout: Lookout) -> None:
        self._lookout = lookout
        self._runs: tuple[SeenRun, ...] = ()
        self._texts: dict[str, bytes] = {}  # of these runs, by content type

    async def answer(self, request: Request) -> Response:
        """Return OpenMetrics, or the older text of Prometheus for whoever takes nothing else."""
        runs = await self._lookout.runs()
        if runs is not self._runs:
            self._runs, self._texts = runs, {}
        accepted = request.headers.get("accept", "")
        is_older = "text/plain" in accepted and "application/openmetrics-text" not in accepted
        kind = CONTENT_TYPE_PLAIN_0_0_4 if is_older else openmetrics.CONTENT_TYPE_LATEST
        if kind not in self._texts:
            self._texts[kind] = (generate_latest if is_older else openmetrics.generate_latest)(_Scraped(runs))
        return Response(self._texts[kind], headers={"Content-Type": kind})


class _Scraped:
    """What prometheus_client asks of a registry."""

    def __init__(self, runs: Iterable[SeenRun]) -> None:
        self._runs = tuple(runs)

    def collect(self) -> list[Metric]:
        """Return the families of all runs."""
        return families(self._runs)


def families(runs: Iterable[SeenRun]) -> list[Metric]:
    """Return the metric families of runs, each with the samples of all of them; no two samples of the same labels."""
    table = _Table()
    table.words("bench_server", "The page server that tells this.", {}, {"version": __version__})
    runs = tuple(runs)
    in_use = {run.state.get("station") for run in runs if run.state.get("state") in _LIVING}
    for run in runs:
        name = _label(run.state.get("run"))
        _add_run(table, {"run": name}, run)
        _add_bench(table, {"run": name}, run, in_use)
        _add_links(table, {"run": name}, run.state)
        _add_estimates(table, name, run.state)
    return list(table.families.values())


def _add_run(table: _Table, of: dict[str, str], run: SeenRun) -> None:
    state = run.state
    uut = _mapping(state.get("uut"))
    named = {key: _label(state.get(key)) for key in ("title", "sequence", "station", "clock")}
    named |= {key: _label(uut.get(key)) for key in ("model", "serial")}
    named["simulated"] = _label(state.get("simulated")).lower()
    table.words("bench_run", "What runs where, on which unit.", of, named)
    table.states("bench_run_state", "What the run is doing.", of, RUN_STATES, state.get("state"))
    table.states("bench_run_attention", "How much somebody is needed.", of, ATTENTION, state.get("attention"))
    outcome = _mapping(_mapping(state.get("session")).get("outcome")).get("word")
    if outcome is not None:
        table.states("bench_run_outcome", "How a run that is over has ended.", of, OUTCOMES, outcome)
    age = "Time since the run answered the page server."
    table.gauge("bench_run_age", age, of, run.age_s, unit="seconds")
    progress = "Share of the planned time that is over, 0 to 1."
    table.gauge("bench_run_progress", progress, of, state.get("progress"), unit="ratio")
    until = _difference(_mapping(state.get("eta")).get("likely_utc_s"), state.get("t_utc_s"))
    table.gauge("bench_run_eta", "Time until the likely end of the run.", of, until, unit="seconds")
    records = _mapping(state.get("records"))
    for what in _RECORDS:
        table.gauge("bench_records", "Records of the run.", {**of, "what": what}, records.get(what))
    if "alarms" in state:
        entries = _rows(state["alarms"])
        lasting = [entry.get("severity") for entry in entries if entry.get("active") and not entry.get("shelved")]
        for severity in SEVERITIES:
            count = lasting.count(severity)
            table.gauge("bench_alarms", "Alarms that last and are not shelved.", {**of, "severity": severity}, count)


def _add_bench(table: _Table, of: dict[str, str], run: SeenRun, in_use: Container[object]) -> None:
    """Add what is on; a run that is over does not say off of a station that another run has in use."""
    bench = _mapping(run.state.get("bench"))
    word = bench.get("state") or "unknown"
    if word != "off" or run.state.get("state") in _LIVING or run.state.get("station") not in in_use:
        about = "What is on, by the replies of the instruments."
        table.states("bench_outputs_state", about, of, OUTPUTS, word)
    left, unconfirmed = "Instruments that were to be made safe and have not confirmed it.", bench.get("unconfirmed")
    table.gauge("bench_outputs_unconfirmed", left, of, None if unconfirmed is None else len(_mapping(unconfirmed)))
    since = _difference(run.state.get("t_utc_s"), bench.get("confirmed_utc_s"))
    table.gauge("bench_outputs_age", "Age of the oldest reply that this rests on.", of, since, unit="seconds")
    for place, value_degC in run.temperatures_degC.items():
        labels = {**of, "place": _label(place)}
        table.gauge("bench_temperature", "Newest reading by the name of its signal.", labels, value_degC, "celsius")


def _add_links(table: _Table, of: dict[str, str], state: Document) -> None:
    for name, entry in _mapping(state.get("links")).items():
        link, labels = _mapping(entry), {**of, "link": _label(name)}
        table.states("bench_link_state", "How the link is.", labels, LINK_STATES, link.get("state"))
        table.gauge("bench_rate", "Frames in a second, as measured.", labels, link.get("rate_Hz"), unit="hertz")
        age = "Age of the newest good frame."
        table.gauge("bench_frame_age", age, labels, link.get("age_s"), unit="seconds")
        for what in _COUNTED:
            counted = {**labels, "what": "good" if what == "frames" else what}
            table.counter("bench_frames", "Frames since this part of the run began.", counted, link.get(what))
        jumps = "Times that the counter went on elsewhere: how many frames are missing there is not known."
        table.counter("bench_counter_jumps", jumps, labels, link.get("jumps"))


def _add_estimates(table: _Table, run: str, state: Document) -> None:
    """Add the estimates that the page shows, in their own unit; a refused one has no value.

    One that is only expected has neither a value nor a quality, and is left out.
    """
    for row in _rows(_mapping(state.get("estimates")).get("rows")):
        if row.get("value") is None and row.get("quality") is None:
            continue
        conditions = ", ".join(f"{name}={value}" for name, value in _mapping(row.get("conditions")).items())
        texts = (run, row.get("quantity"), row.get("unit"), conditions, row.get("quality") or "sound")
        labels = dict(zip(_ESTIMATE, map(_label, texts), strict=True))
        table.gauge("bench_estimate_value", "Estimate, in its unit.", labels, row.get("value"))
        uncertainty = "Expanded uncertainty of the estimate, in its unit."
        table.gauge("bench_estimate_uncertainty", uncertainty, labels, row.get("expanded_uncertainty"))
        for side, limit in _limits(row):
            table.gauge("bench_estimate_limit", "Limit of the estimate, in its unit.", {**labels, "side": side}, limit)


def _limits(row: Document) -> Iterator[tuple[str, Any]]:
    limit, limits = number_of(row.get("limit")), _mapping(row.get("limits"))
    if limit is not None:
        yield from (("low", -limit), ("high", limit))
    else:
        yield from ((side, limits.get(side)) for side in ("low", "high"))


class _Table:
    """Families by name, in the order of their first sample; the second sample of the same labels is left out,
    because one pair of them makes a scraper refuse everything."""

    def __init__(self) -> None:
        self.families: dict[str, Metric] = {}
        self._there: set[tuple[str, ...]] = set()

    def gauge(self, name: str, text: str, labels: dict[str, str], value: object, unit: str = "") -> None:
        """Add a value, if it is a number."""
        self._add(GaugeMetricFamily, name, text, labels, number_of(value), unit=unit)

    def counter(self, name: str, text: str, labels: dict[str, str], value: object) -> None:
        """Add a count, if it is a number."""
        self._add(CounterMetricFamily, name, text, labels, number_of(value))

    def states(self, name: str, text: str, labels: dict[str, str], states: tuple[str, ...], now: object) -> None:
        """Add a set of states of which one is 1; none is, where a run of another version says another word."""
        self._add(StateSetMetricFamily, name, text, labels, {state: state == now for state in states})

    def words(self, name: str, text: str, labels: dict[str, str], values: dict[str, str]) -> None:
        """Add words that belong to the labels."""
        self._add(InfoMetricFamily, name, text, labels, values)

    def _add(self, kind: Any, name: str, text: str, labels: dict[str, str], value: Any, **more: str) -> None:
        """Add the sample of a family, which begins with its first one; None is no value."""
        key = (name, *labels.values())
        if value is None or key in self._there:
            return
        self._there.add(key)
        family: Any = self.families.setdefault(name, kind(name, text, labels=list(labels), **more))
        family.add_metric(list(labels.values()), value)


def _label(value: object) -> str:
    """Return a text as a label: what is no character of Unicode is replaced, and it has an end."""
    return ("" if value is None else str(value)).encode("utf-8", "replace").decode()[:LONGEST_LABEL]


def _mapping(value: object) -> Document:
    return value if isinstance(value, Mapping) else {}


def _rows(value: object) -> list[Document]:
    return [_mapping(entry) for entry in value] if isinstance(value, list) else []


def _difference(later: object, earlier: object) -> float | None:
    a, b = number_of(later), number_of(earlier)
    return None if a is None or b is None else a - b
