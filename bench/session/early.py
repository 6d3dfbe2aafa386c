"""Judges a session that is still being recorded; a process of its own, so that a run cannot die of a fit.

``python -m bench.session.early SESSION LIMITS``: reads the committed part of the session, prints one JSON document
``{"ok": ..., "records": ..., "checks": [...]}`` and exits with 0. It gives way to everything else on the machine.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bench.analysis.registry import analyse
from bench.model.errors import BenchError
from bench.session.service import read_view
from bench.session.view import material_of
from bench.systems.af_converter.constants import read_campaign
from bench.systems.af_converter.early import (
    Check,
    drift_check,
    link_checks,
    repeat_check,
    residual_check,
    scatter_check,
)

NICE = 19


def verdict(folder: Path, limits: Mapping[str, float]) -> dict[str, Any]:
    """All checks of what the session holds so far. ``ok`` is False if one fails; None if nothing can be judged yet."""
    view = read_view(folder)
    checks = link_checks(view.counts, limits["max_lost"], limits["max_bad"])
    if view.has_analysis:
        try:
            campaign = read_campaign(view.manifest["campaign"])
            checks.append(repeat_check(view.rows, campaign, limits["max_dispersion"]))
            checks.append(scatter_check(view.rows, campaign, limits["max_dispersion"]))
            analysis = analyse(material_of(view))
            checks.append(residual_check(analysis, limits["max_residual"]))
            checks.append(drift_check(analysis, limits["max_dispersion"]))
        except BenchError as error:  # most often: too few records yet
            checks.append(Check("partial fit", None, None, 0.0, error.message))
    judged = [check.ok for check in checks if check.ok is not None]
    ok = all(judged) if judged else None
    return {"ok": ok, "records": len(view.rows), "checks": [asdict(check) for check in checks]}


def main(words: list[str]) -> int:
    """Entry point of the process."""
    os.nice(NICE)
    folder, limits = Path(words[0]), json.loads(words[1])
    sys.stdout.write(json.dumps(verdict(folder, limits)) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
