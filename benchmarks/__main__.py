"""Run every measurement in a process of its own, one after the other, and say which one failed."""

from __future__ import annotations

import subprocess
import sys

NAMES = (
    *(
        "decoder",
        "step_cost",
        "replay",
        "campaign",
        "memory",
        "history",
        "batch",
        "archive",
        "latency",
        "page",
        "scrape",
        "tagger",
    ),
    "formats",
    "time_sync",
)


def main() -> int:
    """Exit status 0 when every measurement ran; nothing is judged, the tables say it."""
    failed = []
    for name in NAMES:
        sys.stdout.write(f"\n== {name}\n")
        sys.stdout.flush()
        if subprocess.run([sys.executable, "-m", f"benchmarks.{name}"], check=False).returncode:
            failed.append(name)
    if failed:
        sys.stdout.write(f"\nfailed: {', '.join(failed)}\n")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
