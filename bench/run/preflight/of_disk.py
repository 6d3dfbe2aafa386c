"""Room for the session, and a disk that takes it fast enough."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from bench.model.clock import NS, Clock
from bench.model.errors import InputError
from bench.plan import summarise
from bench.run.bench.beginning import SPACE_FACTOR, check_space
from bench.run.preflight.context import PreflightContext
from bench.run.preflight.finding import Finding, Status

TRIAL_S = 2.0
MOST_BYTES = 64_000_000
LEAST_CHUNK = 65_536
SPEED_FACTOR = 2.0
SLOW_FSYNC_S, SLOWEST_FSYNC_S = 0.25, 1.0  # the session goes to the disk once a second


def space(context: PreflightContext) -> Finding:
    """The disk has twice the room the plan needs, and a file may grow so large."""
    name, need = "room on the disk", summarise(context.plan).disk_bytes
    limit = f"{SPACE_FACTOR * need / 1e6:.0f} MB"
    try:
        check_space(context.plan, context.out)
    except InputError as error:
        return Finding(name, Status.FAIL, "", limit, error.message)
    largest = None if context.in_process else context.host.largest_file_bytes()
    if largest is not None and largest < need:
        return Finding(name, Status.FAIL, f"{largest / 1e6:.0f} MB a file", limit, "raise the limit 'ulimit -f'")
    return Finding(name, Status.OK, "enough", limit)


@dataclass(frozen=True)
class DiskTrial:
    """What a short trial of the disk gave: fsynced bytes per second, 99th percentile of one fsync in second."""

    bytes_s: float
    fsync_p99_s: float


def try_disk(folder: Path, clock: Clock, chunk: int, sync: Callable[[int], None] = os.fsync) -> DiskTrial:
    """Write and fsync chunks of ``chunk`` bytes for two seconds (64 MB at most); the file is removed again.

    A folder that does not exist is not made: the nearest one above it is on the same disk. Raises: OSError.
    """
    place = next(one for one in (folder.absolute(), *folder.absolute().parents) if one.is_dir())
    path = place / f".preflight-{os.getpid()}"
    content, waits_s, written = bytes(chunk), [], 0
    began_ns = clock.now_ns()
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o600)
    try:
        while clock.now_ns() - began_ns < TRIAL_S * NS and written < MOST_BYTES:
            written += os.write(descriptor, content)
            before_ns = clock.now_ns()
            sync(descriptor)
            waits_s.append((clock.now_ns() - before_ns) / NS)
        seconds = (clock.now_ns() - began_ns) / NS
    finally:
        os.close(descriptor)
        path.unlink(missing_ok=True)
    return DiskTrial(written / max(seconds, 1e-9), sorted(waits_s)[math.ceil(0.99 * len(waits_s)) - 1])


def write_speed(context: PreflightContext, sync: Callable[[int], None] = os.fsync) -> Finding:
    """The disk takes at least twice what the run sends it each second, and an fsync is over in a quarter of one."""
    need_bytes_s = summarise(context.plan).disk_bytes / max(context.length_s, 1.0)
    limit = f"{SPEED_FACTOR * need_bytes_s / 1e6:.3f} MB/s, fsync in {SLOW_FSYNC_S * 1e3:.0f} ms"
    try:
        trial = try_disk(context.out, context.clock, max(LEAST_CHUNK, round(need_bytes_s)), sync)
    except OSError as error:
        return Finding("write speed", Status.FAIL, "", limit, f"{context.out} cannot be written: {error.strerror}")
    value = f"{trial.bytes_s / 1e6:.1f} MB/s, p99 {trial.fsync_p99_s * 1e3:.1f} ms"
    if trial.bytes_s < SPEED_FACTOR * need_bytes_s or trial.fsync_p99_s > SLOWEST_FSYNC_S:
        return Finding("write speed", Status.FAIL, value, limit, "choose a faster disk with --out")
    if trial.fsync_p99_s > SLOW_FSYNC_S:
        return Finding("write speed", Status.WARN, value, limit, "something else keeps the disk busy")
    return Finding("write speed", Status.OK, value, limit)
