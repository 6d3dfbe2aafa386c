"""Time offset between an EGI and the inertial unit at a radar antenna, from a recording of both through a manoeuvre.

Method and requirements: docs/method-time-sync.md. The truth of a simulation enters nowhere.
"""

from __future__ import annotations

from bench.analysis import Analysis, Material, no_result, unseen_tables
from bench.model.errors import FitError
from bench.systems.time_sync.departures import chi2_of, implausible, rows_of, searched_rows
from bench.systems.time_sync.estimates import SyncResult, sync_estimates
from bench.systems.time_sync.estimators.kalman.innovation import observability
from bench.systems.time_sync.filtering import METHODS, Filtered, filtered, trajectory_figures
from bench.systems.time_sync.image import Image, first_pulse_s, image_of
from bench.systems.time_sync.limits import demands_of, densities_of, latency_of, spread_of
from bench.systems.time_sync.records import Recording, clocks_of, recording
from bench.systems.time_sync.report import figures, notes, tables
from bench.systems.time_sync.samples import prepared
from bench.systems.time_sync.wording import say


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Return offset by all filters and by the receive stamps; ``method`` says which filter is judged.

    Raises: FitError B-SYNC-001 to -009 and -011; a radar without an image is missing.
    """
    return analysis_of("time_sync", recording(material), material, method)


def analysis_of(campaign: str, taken: Recording, material: Material, method: str) -> Analysis:
    """Return everything that both units sent shows, by all filters; ``method`` says which one is judged.

    Raises: FitError B-SYNC-003 to -009 and -011; a radar without an image is missing.
    """
    demands, latency = demands_of(material.campaign), latency_of(material.campaign)
    densities = densities_of(material.campaign)
    ready = prepared(taken)
    clocks = clocks_of(taken, ready.middle_s, latency, material.line_s)
    spread = spread_of(material.campaign, ready.egi.position_std_m)
    filtering = filtered(ready, clocks, densities, spread, first_pulse_s(taken.radar))
    image, missing = _image(taken, filtering)
    seen = observability(filtering.run.covariance, filtering.run.first_covariance)
    result = SyncResult(taken.manoeuvre, ready, clocks, filtering, seen, image, demands, method)
    rows, entries = rows_of(result, densities, spread, taken), sync_estimates(result)
    residuals = rows.residuals(entries)
    searched, (chi2, dof) = searched_rows(rows, residuals), chi2_of(residuals)
    return Analysis(
        campaign,
        method,
        material.campaign["uut"],
        entries,
        evidence=[*implausible(result), *searched.evidence],
        groups=[{"reduced_chi2": chi2 / dof, "dof": dof}],
        notes=[*no_result(missing), *notes(result)],
        missing=missing,
        figures=[*trajectory_figures(ready.egi, taken.radar), *figures(result)],
        tables=[*tables(result, entries), *unseen_tables([searched])],
    )


def _image(taken: Recording, filtering: Filtered) -> tuple[Image | None, list[str]]:
    if taken.radar is None:
        return None, []
    try:
        return image_of(taken.radar, filtering), []
    except FitError as error:
        return None, [say("missing.image", why=error.message, code=error.code)]
