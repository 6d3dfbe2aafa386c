"""Judges a session that is still being recorded; a process of its own, so that a run cannot die of a fit.

``python -m bench.session.early SESSION LIMITS``: reads the committed part of the session, prints one JSON document
``{"ok": ..., "records": ..., "checks": [...]}`` and exits with 0. It gives way to everything else on the machine.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bench.analysis import Check, link_checks
from bench.model.installed import named, unforeseen
from bench.model.posix import give_way
from bench.model.systems import system_of_analysis
from bench.session.service import read_view
from bench.session.view import analysis_of

NICE = 19


def verdict(folder: Path, limits: Mapping[str, float]) -> dict[str, Any]:
    """Return all checks of what the session holds so far. ``ok`` is False if one fails; None if nothing is judged."""
    view = read_view(folder)
    checks = link_checks(view.counts, limits["max_lost"], limits["max_bad"])
    campaign = view.manifest.get("campaign", {})
    system = system_of_analysis(str(campaign.get("analysis")))
    if view.has_analysis and system is not None and system.early:
        try:
            checks.extend(named(system.early).checks(view.rows, campaign, lambda: analysis_of(view), limits))
        except Exception as error:  # most often: too few records yet
            checks.append(Check("partial fit", None, None, 0.0, unforeseen(error).message))
    judged = [check.ok for check in checks if check.ok is not None]
    ok = all(judged) if judged else None
    return {"ok": ok, "records": len(view.rows), "checks": [asdict(check) for check in checks]}


def main(words: list[str]) -> int:
    """Entry point of the process."""
    give_way(NICE)
    folder, limits = Path(words[0]), json.loads(words[1])
    sys.stdout.write(json.dumps(verdict(folder, limits)) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
