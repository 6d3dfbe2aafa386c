"""The machine the controller runs on: will it stay awake, is its clock right, have memory and disk room for the run."""

from __future__ import annotations

import math
import os
import platform
import re
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from bench.model.clock import NS, Clock
from bench.model.errors import InputError
from bench.model.events import Inhibit
from bench.model.posix import ALONE
from bench.plan import summarise
from bench.run.bus.beginning import SPACE_FACTOR, check_space, folder_above
from bench.run.context import RunContext
from bench.run.preflight.context import Finding, PreflightContext, Status, Surroundings
from bench.run.provenance import PACKAGES

LARGEST_CLOCK_ERROR_S = 1.0
CLOCK_SLACK_NS = 60 * NS
LEAST_OPEN_FILES = 256
LEAST_MEMORY_MB = 512.0
INHIBITOR = "systemd-inhibit"
SYSTEMD = "/run/systemd/system"  # is there while systemd runs the machine: sd_booted(3)
LOCK_FILE = Path(__file__).resolve().parents[3] / "requirements" / "run.txt"
_POWER = "/sys/class/power_supply"
_REFUSED_S = 0.5
_END_S = 2.0
_WORDS = (INHIBITOR, "--what=sleep:idle:handle-lid-switch", "--who=bench", "--mode=block", "--why=a run is on", "cat")
TRIAL_S = 2.0
MOST_BYTES = 64_000_000
LEAST_CHUNK = 65_536
SPEED_FACTOR = 2.0
SLOW_FSYNC_S, SLOWEST_FSYNC_S = 0.25, 1.0  # the session goes to the disk once a second


def clock_state(around: Surroundings) -> Finding:
    """The kernel's clock is disciplined by something (NTP, PTP ...), and it has not gone back.

    Order and durations of a run come from the monotonic clock; only the dates of session and certificate are at stake.
    """
    name, limit = "clock", f"synchronised, within {LARGEST_CLOCK_ERROR_S:g} s"
    newest_ns = around.host.newest_change_utc_ns(around.out)
    if newest_ns is not None and newest_ns > around.clock.utc_ns() + CLOCK_SLACK_NS:
        text = f"{around.out} holds something from the future: the clock has gone back"
        return Finding(name, Status.WARN, "behind", limit, text)
    state = around.host.kernel_clock()
    if state is None:
        return Finding(name, Status.WARN, "unknown", limit, "the kernel does not tell; look at the date")
    if not state.synchronised:
        return Finding(name, Status.WARN, "not synchronised", limit, "start chrony, ntpd or systemd-timesyncd")
    value = f"within {state.largest_error_s:.3g} s"
    status = Status.OK if state.largest_error_s <= LARGEST_CLOCK_ERROR_S else Status.WARN
    return Finding(name, status, value, limit, "by the kernel's own estimate")


def sleep(around: Surroundings) -> Finding:
    """The machine does not suspend in the middle of the night."""
    host, limit = around.host, "never while a run is on"
    states = host.text("/sys/power/state")
    if not states:
        return Finding("suspend", Status.OK, "cannot suspend", limit)
    if host.exists(SYSTEMD) and host.output((INHIBITOR, "--version")) is not None:
        return Finding("suspend", Status.OK, "inhibited", limit, "the run takes an inhibitor from systemd")
    text = f"the kernel knows {states!r} and nobody can be asked to keep it awake: switch suspend off"
    return Finding("suspend", Status.WARN, "possible", limit, text)


def mains(around: Surroundings) -> Finding:
    """A laptop stands on its charger."""
    host = around.host
    supplies = host.names(_POWER)
    kinds = {supply: host.text(f"{_POWER}/{supply}/type") for supply in supplies}
    batteries = [supply for supply, kind in kinds.items() if kind == "Battery"]
    batteries = [
        supply for supply in batteries if host.text(f"{_POWER}/{supply}/scope") != "Device"
    ]  # a mouse has one, too
    online = [supply for supply in supplies if host.text(f"{_POWER}/{supply}/online") == "1"]
    if not batteries:
        return Finding("mains", Status.OK, "no battery", "mains")
    if online:
        return Finding("mains", Status.OK, online[0], "mains")
    charge = host.text(f"{_POWER}/{batteries[0]}/capacity") or "?"
    return Finding("mains", Status.WARN, f"battery, {charge} %", "mains", "connect the charger")


def room_to_run(around: Surroundings) -> Finding:
    """Memory and descriptors are enough for a campaign."""
    host = around.host
    limit = f"{LEAST_MEMORY_MB:.0f} MB, {LEAST_OPEN_FILES} files"
    files = host.most_open_files()
    if files is not None and files < LEAST_OPEN_FILES:
        return Finding("memory, files", Status.FAIL, f"{files} open files", limit, "raise the limit 'ulimit -n'")
    free_MB = _free_memory_MB(around)
    shown = "no limit" if files is None else f"{files} files"
    if free_MB is None:
        return Finding("memory, files", Status.WARN, f"memory unknown, {shown}", limit)
    status = Status.OK if free_MB >= LEAST_MEMORY_MB else Status.WARN
    text = "" if status is Status.OK else "end what else runs on this machine"
    return Finding("memory, files", status, f"{free_MB:.0f} MB, {shown}", limit, text)


def _free_memory_MB(around: Surroundings) -> float | None:
    """Return megabytes that the kernel can give without swapping and the process's control group leaves of them."""
    match = re.search(r"^MemAvailable:\s+(\d+) kB", around.host.text("/proc/meminfo") or "", re.MULTILINE)
    free = [int(match[1]) / 1e3] if match else []
    most, used = (around.host.text(f"/sys/fs/cgroup/memory.{name}") or "" for name in ("max", "current"))
    if most.isdecimal() and used.isdecimal():
        free.append((int(most) - int(used)) / 1e6)
    return min(free, default=None)


def software(around: Surroundings) -> Finding:
    """Python and the packages that numbers depend on are those of the lock."""
    name = "versions"
    lock = around.host.text(str(LOCK_FILE))
    if lock is None:
        return Finding(name, Status.SKIPPED, "", "", "an installed package carries no lock")
    due = {_plain(package): version for package, version in re.findall(r"^([\w.-]+)==([\w.]+)", lock, re.MULTILINE)}
    versions = {package: around.host.version(package) for package in PACKAGES if _plain(package) in due}
    other = [f"{package} {version}" for package, version in versions.items() if version != due[_plain(package)]]
    wanted = re.search(r"with Python (\d+\.\d+)", lock)
    if wanted and not platform.python_version().startswith(f"{wanted[1]}."):
        other.insert(0, f"Python {platform.python_version()}")
    if other:
        text = "numbers may differ in their last digits from those of the lock"
        return Finding(name, Status.WARN, ", ".join(other), "as locked", text)
    return Finding(name, Status.OK, f"{len(versions)} packages as locked", "as locked")


def _plain(package: str) -> str:
    return re.sub(r"[-_.]+", "-", package).lower()


@contextmanager
def stay_awake(context: RunContext, words: tuple[str, ...] = _WORDS) -> Iterator[None]:
    """Beside a run on the wall clock: an inhibitor of systemd, held by a program that ends with this process.

    Without systemd nothing is held; the pre-flight has said so. Writes an event "inhibit" {held, text}. A run whose
    inhibitor is refused goes on: the pre-flight judges, this only helps.
    """
    if context.clock.virtual or context.plan.station.in_process:
        yield
        return
    holder = _start(words)
    text = (
        f"nobody can be asked to keep the machine awake ({INHIBITOR})" if holder is None else "the machine stays awake"
    )
    context.event(Inhibit(held=holder is not None, text=text))
    try:
        yield
    finally:
        if holder is not None:
            _end(holder)


def _start(words: tuple[str, ...]) -> subprocess.Popen[bytes] | None:
    """Return the holder, alive; None if missing or refused. Its input is a pipe, and it ends with this process."""
    quiet = subprocess.DEVNULL
    try:
        holder = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=quiet, stderr=quiet, start_new_session=True)
    except OSError:
        return None
    try:
        holder.wait(_REFUSED_S)
    except subprocess.TimeoutExpired:
        return holder
    assert holder.stdin is not None
    holder.stdin.close()
    return None


def _end(holder: subprocess.Popen[bytes]) -> None:
    assert holder.stdin is not None
    with suppress(OSError):
        holder.stdin.close()
    try:
        holder.wait(_END_S)
    except subprocess.TimeoutExpired:
        holder.kill()
        holder.wait()


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
    """Result of a short trial of the disk: fsynced bytes per second, 99th percentile of one fsync in second."""

    bytes_s: float
    fsync_p99_s: float


def try_disk(folder: Path, clock: Clock, chunk: int, sync: Callable[[int], None] = os.fsync) -> DiskTrial:
    """Write and fsync chunks of ``chunk`` bytes for two seconds (64 MB at most); the file is removed again.

    A folder that does not exist is not made: the nearest one above it is on the same disk. Raises: OSError.
    """
    path = folder_above(folder) / f".preflight-{os.getpid()}"
    content, waits_s, written = bytes(chunk), [], 0
    began_ns = clock.now_ns()
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | ALONE, 0o600)
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
