"""A campaign in real time against a simulated bench of 14 instruments in another process: losses and CPU.

``python -m benchmarks.wall [SEQUENCE] [BURNERS]``: by default the campaign of some eight minutes without anything
beside it; BURNERS processes then keep every core busy. Not part of ``make bench``: it takes as long as it says.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path

from bench.model.clock import NS, WallClock

SEQUENCE = "scale_factor_wall"
BURN = "while True: pass"


def served(folder: Path, stack: ExitStack) -> Path:
    """Start the simulated bench; its station file."""
    command = [sys.executable, "-m", "bench", "sim", "af_rack_sim", "--dir", str(folder)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    stack.callback(process.wait)
    stack.callback(process.terminate)
    assert process.stdout is not None
    for line in process.stdout:
        if line.strip() == "ready":
            return folder / "station.yaml"
    raise SystemExit("the simulated bench did not start")


def burn(count: int, stack: ExitStack) -> None:
    """Start processes that take all the CPU they get."""
    for _ in range(count):
        process = subprocess.Popen([sys.executable, "-c", BURN])
        stack.callback(process.wait)
        stack.callback(process.kill)


def conducted(sequence: str, station: Path, out: Path) -> tuple[float, float, float]:
    """CPU seconds of the controller, CPU seconds with the guard it started, and wall seconds."""
    clock = WallClock()
    began_ns = clock.now_ns()
    words = ["run", sequence, "--station", str(station), "--out", str(out)]
    process = subprocess.Popen([sys.executable, "-m", "bench", *words], stderr=subprocess.DEVNULL)
    own_s = 0.0
    while (found := os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT)) is None:
        own_s = cpu_s(process.pid)
        clock.sleep(0.2)
    wall_s = (clock.now_ns() - began_ns) / NS
    _, _, usage = os.wait4(process.pid, 0)
    process.returncode = found.si_status
    if process.returncode not in (0, 1):
        raise SystemExit(f"the campaign ended with exit status {process.returncode}")
    return own_s, usage.ru_utime + usage.ru_stime, wall_s


def cpu_s(pid: int) -> float:
    """CPU seconds a process has used so far, without its children."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    """Run it and print one table."""
    words = sys.argv[1:]
    sequence = words[0] if words else SEQUENCE
    burners = int(words[1]) if len(words) > 1 else 0
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        station = served(Path(folder) / "bench", stack)
        burn(burners, stack)
        own_s, all_s, wall_s = conducted(sequence, station, Path(folder) / "out")
        results = json.loads(next(Path(folder, "out").glob("*/results.json")).read_text())
    quality = results["quality"]
    sys.stdout.write(
        f"{sequence} with {burners} busy processes beside it: {wall_s:.0f} s\n"
        f"  frames {quality['frames']}, bad {quality['frames_bad']}, lost {quality['frames_lost']}, "
        f"records {quality['records']}, taken again {quality['retaken']}\n"
        f"  CPU of the controller {own_s:.1f} s = {100 * own_s / wall_s:.1f} % of a core, "
        f"with fit and report; with the processes it waited for {all_s:.1f} s\n"
    )


if __name__ == "__main__":
    main()
