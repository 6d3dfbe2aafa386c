"""study.json: every estimate of the study with its tolerance and verdict; the same tasks give the same bytes."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from bench.systems.time_sync.study.errors import error_estimates
from bench.systems.time_sync.study.images import image_estimates
from bench.systems.time_sync.study.notes import NOTES, QUICK
from bench.systems.time_sync.study.recovery import recovery_estimates
from bench.systems.time_sync.study.results import Cut, Results
from bench.systems.time_sync.study.study import ERRORLESS, NAME, SIGMA_R, StudyOptions, tasks_of
from bench.systems.time_sync.study.tolerance import unjudged


def results_of(options: StudyOptions, gave: Sequence[Any]) -> Results:
    """Return what the tasks gave, in their order."""
    return Results(tuple(zip(tasks_of(options), gave, strict=True)))


def study_document(options: StudyOptions, found: Results, software: str) -> dict[str, Any]:
    """Return the document; where and by how many it was computed does not stand in it."""
    offsets_ms = options.offsets_ms
    estimates = [
        *error_estimates(found, offsets_ms),
        *recovery_estimates(found, offsets_ms),
        *image_estimates(found, offsets_ms),
    ]
    if not options.judged:
        estimates = [one if one["conditions"]["filter"] == ERRORLESS else unjudged(one) for one in estimates]
    return {
        "schema": 1,
        "study": NAME,
        "runs": options.runs,
        "seed": options.seed,
        "offsets_ms": list(offsets_ms),
        "quick": options.quick,
        "decision_rule": "simple",
        "noise": {name: dict(zip(("m", "m/s", "deg"), sigmas, strict=True)) for name, sigmas in SIGMA_R.items()},
        "estimates": estimates,
        "cuts": [_cut(cut) for cut in _all_cuts(found)],
        "notes": [*([] if options.judged else [QUICK]), *NOTES],
        "provenance": {"simulated": True, "software": software},
    }


def study_json(document: Mapping[str, Any]) -> str:
    """Canonical text: sorted keys, shortest exact floats, one newline at the end."""
    return json.dumps(document, sort_keys=True, ensure_ascii=False, allow_nan=False, indent=1) + "\n"


def _all_cuts(found: Results) -> list[Cut]:
    return [*found.ideal().cuts, *(cut for one in found.images() for cut in one.cuts)]


def _cut(cut: Cut) -> dict[str, Any]:
    """Raw complex amplitude along a line through the image; the ideal one has no filter."""
    return {
        "direction": cut.direction,
        "offset_ms": cut.offset_ms,
        "filter": cut.solution,
        "run": 1,
        "at_m": cut.at_m.tolist(),
        "real": cut.amplitude.real.tolist(),
        "imaginary": cut.amplitude.imag.tolist(),
    }
