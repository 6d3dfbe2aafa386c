"""The bench's own processes: every module that is started by its name, in one table.

They are processes of their own so that a run cannot die of them, or so that they outlive it. None takes a module from
the folder it happens to be started in (``-P``).
"""

from __future__ import annotations

import sys

GUARD = "bench.run.guard"  # makes the bench safe when its controller is gone
NOTICE = "bench.run.guard.notice"  # tells people what the guard did
DRILL_CONTROLLER = "bench.run.bench.drill_controller"  # is killed under stimulus by ``bench drill``
EARLY_VERDICT = "bench.session.early"  # judges a session that is still being recorded
PARTIAL_RESULTS = "bench.session.partial"  # fits a session that is still being recorded, for the page
TREND = "bench.replay.build_trend"  # builds the trend file of a session that has none
STARTED = (GUARD, NOTICE, DRILL_CONTROLLER, EARLY_VERDICT, PARTIAL_RESULTS, TREND)

APPRISE = (sys.executable, "-P", "-c", "import sys; from apprise.cli import main; sys.exit(main())")
"""The program of the extra ``messages``, which is no module of ours."""


def own_process(module: str, *words: str) -> list[str]:
    """Return the command that starts one of the modules in ``STARTED`` with its arguments."""
    return [sys.executable, "-P", "-m", module, *words]
