"""What the 38-hour and the 25-hour campaign cost, against a simple loop that would merely decode their streams.

A campaign is ``bench run`` in a process of its own, everything included: start of Python, simulated bench, drivers,
recording, decoding, fit and report. The loop is find + crcmod + struct on frames held in memory; its cost per frame
of either port is measured in the same run and multiplied by the frames of that port.

The session is then fitted twice and reported: read from its bytes, and from what is kept of that.

Run: python -m benchmarks.campaign [SEQUENCE].
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from resource import struct_rusage
from tempfile import TemporaryDirectory

from bench.frame import load_frame
from benchmarks.decoder import FRAMES, columns, cost_ns, housekeeping, housekeeping_loop, peer_loop

RATES_Hz = (100.0, 10.0)  # counted link, housekeeping link
LOOP_FRAMES = 50_000
CAMPAIGNS = {  # and the settings that make them last twice as long
    "scale_factor_38h": ("dwell=200 s", "settle=40 s", "slot=18000 s"),
    "bias_ramp_25h": (),
}
READ_AGAIN = {"bench fit, first": "fit", "bench fit, again": "fit", "bench report after it": "report"}
DONE = (0, 1)  # every verdict passes, or one fails: the campaign is complete either way


@dataclass(frozen=True)
class Cost:
    """CPU seconds and the largest resident memory of a process, and what its campaign held.

    ``read_again``: CPU seconds of commands that read the session.
    """

    cpu_s: float
    peak_MB: float
    frames: int
    records: int
    read_again: Mapping[str, float]


def campaign_cost(sequence: str, *settings: str) -> Cost:
    """Run a campaign on the simulated bench and read what it cost the system."""
    with TemporaryDirectory() as folder:
        words = ["run", sequence, "--clock", "virtual", "--seed", "1", "--out", folder]
        usage = usage_of(*words, *(word for setting in settings for word in ("--set", setting)))
        (results_file,) = Path(folder).glob("*/results.json")
        quality = json.loads(results_file.read_text(encoding="utf-8"))["quality"]
        commands = {} if settings else READ_AGAIN  # once is enough
        read_again = {name: cpu_s(usage_of(word, str(results_file.parent))) for name, word in commands.items()}
    return Cost(cpu_s(usage), usage.ru_maxrss / 1024, quality["frames"], quality["records"], read_again)


def cpu_s(usage: struct_rusage) -> float:
    """Return CPU seconds, those of the system with them."""
    return usage.ru_utime + usage.ru_stime


def usage_of(*words: str) -> struct_rusage:
    """Run a command of the bench and return what it cost the system."""
    command = [sys.executable, "-m", "bench", *words]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    complaint = process.stderr.read()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode not in DONE:
        raise SystemExit(f"bench {words[0]} ended with status {process.returncode}: {complaint[-2000:]}")
    return usage


def loop_ns() -> tuple[float, float]:
    """CPU nanoseconds per frame of the find + crcmod + struct loop: counted link, housekeeping link."""
    counted = load_frame(FRAMES / "ngu_a.yaml").encode(columns(LOOP_FRAMES), LOOP_FRAMES).tobytes()
    beside = load_frame(FRAMES / "ngu_b.yaml").encode(housekeeping(LOOP_FRAMES), LOOP_FRAMES, "housekeeping").tobytes()
    return (
        cost_ns(lambda: peer_loop(counted), LOOP_FRAMES, 5),
        cost_ns(lambda: housekeeping_loop(beside), LOOP_FRAMES, 5),
    )


def loop_s(each_ns: tuple[float, float], frames: int) -> float:
    """CPU seconds of the loop for all frames of a campaign, which come at the rates of both links."""
    return sum(cost * frames * rate / sum(RATES_Hz) for cost, rate in zip(each_ns, RATES_Hz, strict=True)) * 1e-9


def measured(sequence: str, twice: tuple[str, ...]) -> list[str]:
    """Lines of the table of one campaign; ``twice`` makes it last twice as long."""
    before_ns = loop_ns()
    once = campaign_cost(sequence)
    long = campaign_cost(sequence, *twice) if twice else None
    each_ns = [min(pair) for pair in zip(before_ns, loop_ns(), strict=True)]
    simple_s = loop_s((each_ns[0], each_ns[1]), once.frames)
    name = f"bench run {sequence}, everything"
    rows = [
        f"{sequence}: {once.records} records, {once.frames} frames of both links",
        f"{'':<52}{'CPU s':>10}{'peak MB':>10}",
        f"{name:<52}{once.cpu_s:>10.1f}{once.peak_MB:>10.0f}",
        f"{'find + crcmod + struct loop, both links':<52}{simple_s:>10.1f}",
        f"campaign / loop {once.cpu_s / simple_s:.3f}",
    ]
    rows += [f"{name:<52}{spent_s:>10.2f}" for name, spent_s in once.read_again.items()]
    if long is not None:
        rows.insert(3, f"{'the same, twice as long':<52}{long.cpu_s:>10.1f}{long.peak_MB:>10.0f}")
        rows[5] += f"    twice as long / once {long.cpu_s / once.cpu_s:.2f}"
    return rows


def main() -> None:
    """Print one table for each campaign."""
    for sequence in sys.argv[1:] or CAMPAIGNS:
        sys.stdout.write("\n".join(measured(sequence, CAMPAIGNS.get(sequence, ()))) + "\n\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
