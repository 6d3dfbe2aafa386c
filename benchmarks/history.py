"""What a history of 1,000 calibrations of one unit costs: writing one, comparing all, the whole command.

The calibrations are those of the tests: 10 channels x 5 temperatures x 4 quantities = 200 estimates each, drifting,
seen through a calibrator with a new certificate each year. CPU time; the history is a SQLite file.

Run: python -m benchmarks.history [calibrations].
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

from bench.store import Filters, compare_unit, dues_of, list_calibrations, record_calibration

SAMPLE = Path(__file__).resolve().parents[1] / "tests" / "support" / "report"
CALIBRATIONS = 1000
SEED = 1
ROUNDS = 5


def write(url: str, count: int) -> float:
    """Fill a history; CPU seconds per calibration."""
    sys.path.append(str(SAMPLE))
    from store_sample import calibrations

    documents = calibrations(count, 7.0, SEED)
    began = process_time()
    for document, manifest in documents:
        record_calibration(url, document, manifest, "report")
    return (process_time() - began) / count


def command_cpu_s(*words: str) -> float:
    """CPU seconds of a command as a process of its own, start of Python included."""
    process = subprocess.Popen([sys.executable, "-m", "bench", *words], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"bench {' '.join(words)} ended with status {process.returncode}")
    return usage.ru_utime + usage.ru_stime


def main() -> None:
    """Print one table."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else CALIBRATIONS
    with TemporaryDirectory() as folder:
        url = f"sqlite:///{folder}/history.sqlite"
        write_s = write(url, count)
        compare_s, drift_s, list_s = [], [], []
        for _ in range(ROUNDS):
            began = process_time()
            comparison = compare_unit(url, Filters())
            dues_of(comparison, 365)
            compare_s.append(process_time() - began)
            began = process_time()
            compare_unit(url, Filters(quantity="dsf_n"))
            drift_s.append(process_time() - began)
            began = process_time()
            list_calibrations(url, Filters())
            list_s.append(process_time() - began)
        size_MB = Path(folder, "history.sqlite").stat().st_size / 1e6
        rows = [
            (f"write one calibration, mean of {count}", write_s),
            (f"compare all: drift, E_n, control, due of {len(comparison.parameters)} parameters", min(compare_s)),
            ("the same of one quantity", min(drift_s)),
            ("list", min(list_s)),
            (
                "bench history compare --json, everything",
                command_cpu_s("history", "compare", "--history", url, "--json"),
            ),
            (
                "bench history due, everything",
                command_cpu_s("history", "due", "--max-interval", "3653", "--history", url),
            ),
            ("bench history --help, the start of Python and the command", command_cpu_s("history", "--help")),
        ]
    lines = [f"history of {count} calibrations, {size_MB:.1f} MB", f"{'':<64}{'CPU s':>8}"]
    lines += [f"{name:<64}{seconds:>8.3f}" for name, seconds in rows]
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
