"""Time offset between an EGI and the inertial unit at a radar antenna, from a recording of both through a manoeuvre.

Method and requirements: docs/time-sync.md. The truth of a simulation enters nowhere.
"""

from __future__ import annotations

from bench.campaigns.analysis import Analysis
from bench.campaigns.material import Material
from bench.campaigns.time_sync_clocks import clocks_of
from bench.campaigns.time_sync_estimates import SyncResult, sync_estimates
from bench.campaigns.time_sync_figures import figures
from bench.campaigns.time_sync_filter import METHODS as _METHODS
from bench.campaigns.time_sync_filter import Filtered, filtered
from bench.campaigns.time_sync_image import Image, first_pulse_s, image_of
from bench.campaigns.time_sync_limits import demands_of, densities_of, latency_of, spread_of
from bench.campaigns.time_sync_notes import notes
from bench.campaigns.time_sync_records import Recording, recording
from bench.campaigns.time_sync_samples import prepared
from bench.campaigns.time_sync_tables import tables
from bench.fit.sync_observability import observability
from bench.model.errors import FitError

METHODS: tuple[str, ...] = _METHODS


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Offset by all filters and by the receive stamps; ``method`` says which filter is judged.

    Raises: FitError B-FIT-004 (unknown method), B-SYNC-001 to -009 and -011; a radar without an image is missing.
    """
    if method not in METHODS:
        raise FitError("B-FIT-004", f"unknown method {method!r}", next_step=f"use one of: {', '.join(METHODS)}")
    demands, latency = demands_of(material.campaign), latency_of(material.campaign)
    densities = densities_of(material.campaign)
    taken = recording(material)
    ready = prepared(taken)
    clocks = clocks_of(taken, ready.middle_s, latency, material.line_s)
    spread = spread_of(material.campaign, ready.egi.position_std_m)
    found = filtered(ready, clocks, densities, spread, first_pulse_s(taken.radar))
    image, missing = _image(taken, found)
    seen = observability(found.run.covariance, found.run.first_covariance)
    result = SyncResult(taken.manoeuvre, ready, clocks, found, seen, image, demands, method)
    return Analysis(
        campaign="time_sync",
        method=method,
        uut=dict(material.campaign["uut"]),
        estimates=sync_estimates(result),
        notes=[*(f"No result: {one}." for one in missing), *notes(result)],
        missing=missing,
        figures=figures(result),
        tables=tables(result),
    )


def _image(taken: Recording, found: Filtered) -> tuple[Image | None, list[str]]:
    if taken.radar is None:
        return None, []
    try:
        return image_of(taken.radar, found), []
    except FitError as error:
        return None, [f"radar image: {error.message} ({error.code})"]
