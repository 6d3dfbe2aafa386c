"""The machine the controller runs on: will it stay awake, is its clock right, has it room for the run."""

from __future__ import annotations

import platform
import re
from pathlib import Path

from bench.model.clock import NS
from bench.run.preflight.context import Surroundings
from bench.run.preflight.finding import Finding, Status
from bench.run.provenance import PACKAGES

LARGEST_CLOCK_ERROR_S = 1.0
CLOCK_SLACK_NS = 60 * NS
LEAST_OPEN_FILES = 256
LEAST_MEMORY_MB = 512.0
INHIBITOR = "systemd-inhibit"
SYSTEMD = "/run/systemd/system"  # is there while systemd runs the machine: sd_booted(3)
LOCK_FILE = Path(__file__).resolve().parents[3] / "requirements" / "run.txt"
_POWER = "/sys/class/power_supply"


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
    kinds = {one: host.text(f"{_POWER}/{one}/type") for one in supplies}
    batteries = [one for one, kind in kinds.items() if kind == "Battery"]
    batteries = [one for one in batteries if host.text(f"{_POWER}/{one}/scope") != "Device"]  # a mouse has one, too
    online = [one for one in supplies if host.text(f"{_POWER}/{one}/online") == "1"]
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
    """What the kernel can give without swapping, and what the process's control group leaves of it, megabyte."""
    found = re.search(r"^MemAvailable:\s+(\d+) kB", around.host.text("/proc/meminfo") or "", re.MULTILINE)
    free = [int(found[1]) / 1e3] if found else []
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
    found = {package: around.host.version(package) for package in PACKAGES if _plain(package) in due}
    other = [f"{one} {version}" for one, version in found.items() if version != due[_plain(one)]]
    wanted = re.search(r"with Python (\d+\.\d+)", lock)
    if wanted and not platform.python_version().startswith(f"{wanted[1]}."):
        other.insert(0, f"Python {platform.python_version()}")
    if other:
        text = "numbers may differ in their last digits from those of the lock"
        return Finding(name, Status.WARN, ", ".join(other), "as locked", text)
    return Finding(name, Status.OK, f"{len(found)} packages as locked", "as locked")


def _plain(package: str) -> str:
    return re.sub(r"[-_.]+", "-", package).lower()
