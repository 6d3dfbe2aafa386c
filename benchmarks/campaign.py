"""What the whole 38-hour campaign costs, against a simple loop that would merely decode its stream.

The campaign is ``bench run`` in a process of its own, everything included: start of Python, simulated bench, drivers,
recording, decoding, fit and report. The loop is find + crcmod + struct on frames held in memory; its cost per frame
is measured in the same run and multiplied by the frames of the counted link.

Run: python -m benchmarks.campaign.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from bench.frame import load_frame
from benchmarks.decoder import FRAMES, columns, cost_ns, peer_loop

RATES_Hz = (100.0, 10.0)  # counted link, housekeeping link
LOOP_FRAMES = 50_000
TWICE = ("dwell=200 s", "settle=40 s", "slot=18000 s")
DONE = (0, 1)  # every verdict passes, or one fails: the campaign is complete either way


@dataclass(frozen=True)
class Cost:
    """CPU seconds and the largest resident memory of a process, and what its campaign held."""

    cpu_s: float
    peak_MB: float
    frames: int
    records: int


def campaign_cost(*settings: str) -> Cost:
    """Run the campaign on the simulated bench and read what it cost the system."""
    with TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "bench", "run", "scale_factor_38h"]
        command += ["--clock", "virtual", "--seed", "1", "--out", folder]
        command += [word for setting in settings for word in ("--set", setting)]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        assert process.stderr is not None
        complaint = process.stderr.read()
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        found = sorted(Path(folder).glob("*/results.json"))
        if process.returncode not in DONE or not found:
            raise SystemExit(f"the campaign ended with status {process.returncode}: {complaint[-2000:]}")
        results = json.loads(found[0].read_text(encoding="utf-8"))
    quality = results["quality"]
    return Cost(usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024, quality["frames"], quality["records"])


def loop_ns() -> float:
    """CPU nanoseconds per frame of the find + crcmod + struct loop."""
    stream = load_frame(FRAMES / "ngu_a.yaml").encode(columns(LOOP_FRAMES), LOOP_FRAMES).tobytes()
    return cost_ns(lambda: peer_loop(stream), LOOP_FRAMES, 5)


def main() -> None:
    """Print one table."""
    before_ns = loop_ns()
    once = campaign_cost()
    twice = campaign_cost(*TWICE)
    per_frame_ns = min(before_ns, loop_ns())
    counted = once.frames * RATES_Hz[0] / sum(RATES_Hz)
    loop_s = per_frame_ns * counted * 1e-9
    rows = [
        f"campaign: {once.records} records, {once.frames} frames of both links",
        f"{'':<52}{'CPU s':>10}{'peak MB':>10}",
        f"{'bench run scale_factor_38h, everything':<52}{once.cpu_s:>10.1f}{once.peak_MB:>10.0f}",
        f"{'the same, twice as long':<52}{twice.cpu_s:>10.1f}{twice.peak_MB:>10.0f}",
        f"{f'find + crcmod + struct loop, {counted:.0f} frames decoded':<52}{loop_s:>10.1f}",
        f"campaign / loop {once.cpu_s / loop_s:.3f}    twice as long / once {twice.cpu_s / once.cpu_s:.2f}",
    ]
    sys.stdout.write("\n".join(rows) + "\n")


if __name__ == "__main__":
    main()
