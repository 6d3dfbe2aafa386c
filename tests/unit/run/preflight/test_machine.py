"""What the pre-flight says about the machine, its disk and its serial ports."""

import errno
import json
import os
import select
import sys
import termios
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from preflight_bench import NOON_NS, TODAY, Machine, clock_at_noon, context, in_process_plan, served_plan

from bench.model.clock import NS
from bench.model.errors import LinkError
from bench.model.lab import find_shipped
from bench.plan import Station, compile_sequence, load_station
from bench.plan.served import served_station
from bench.plan.summary import summarise
from bench.run.bus.opener import open_port
from bench.run.guard.drill import RESULT
from bench.run.preflight import Status
from bench.run.preflight.context import Host, KernelClock
from bench.run.preflight.of_machine import (
    LOCK_FILE,
    PACKAGES,
    clock_state,
    mains,
    room_to_run,
    sleep,
    software,
    space,
    try_disk,
    write_speed,
)
from bench.run.preflight.survey import drill, guard, latency_timers, line_settings, quiet

BAUD = 921_600


def memory(free_kB: int) -> dict[str, str]:
    return {"/proc/meminfo": f"MemTotal: 8000000 kB\nMemAvailable:   {free_kB} kB\n"}


def power(**files: str) -> Machine:
    supplies = sorted({name.split("__")[0] for name in files})
    paths = {f"/sys/class/power_supply/{name.replace('__', '/')}": text for name, text in files.items()}
    return Machine(files=paths, folders={"/sys/class/power_supply": supplies})


def latency(text: str) -> Machine:
    return Machine(files={"terminal 7": "/dev/ttyUSB7", "/sys/bus/usb-serial/devices/ttyUSB7/latency_timer": text})


SYNCHRONISED = KernelClock(True, 0.02)
GUARD = {Path(sys.executable).name: "ready"}
SYSTEMD = {"/run/systemd/system": ()}
INHIBIT = {"systemd-inhibit": "systemd 252"}
KNOWS = {"/sys/power/state": "freeze mem disk"}
GROUP = {"/sys/fs/cgroup/memory.max": "600000000", "/sys/fs/cgroup/memory.current": "200000000"}
MUCH_kB = 4_000_000
USB = {"port_a": SimpleNamespace(fileno=lambda: 7), "port_b": SimpleNamespace()}
DRAINED = {"BAT0__type": "Battery", "BAT0__capacity": "81"}


@pytest.mark.parametrize(
    ("check", "machine", "status", "value"),
    [
        (clock_state, Machine(clock=SYNCHRONISED, newest_ns=NOON_NS), Status.OK, "within 0.02 s"),
        (clock_state, Machine(clock=SYNCHRONISED, newest_ns=NOON_NS + 61 * NS), Status.WARN, "behind"),
        (clock_state, Machine(clock=KernelClock(True, 3.0), newest_ns=None), Status.WARN, "within 3 s"),
        (clock_state, Machine(clock=KernelClock(False, 0.02), newest_ns=None), Status.WARN, "not synchronised"),
        (clock_state, Machine(clock=None, newest_ns=None), Status.WARN, "unknown"),
        (sleep, Machine(), Status.OK, None),
        (sleep, Machine(files={"/sys/power/state": ""}), Status.OK, None),
        (sleep, Machine(files=KNOWS), Status.WARN, None),
        (sleep, Machine(files=KNOWS, folders=SYSTEMD), Status.WARN, None),
        (sleep, Machine(files=KNOWS, programs=INHIBIT), Status.WARN, None),
        (sleep, Machine(files=KNOWS, folders=SYSTEMD, programs=INHIBIT), Status.OK, None),
        (mains, Machine(), Status.OK, "no battery"),
        (mains, power(BAT0__type="Battery", AC__type="Mains", AC__online="1"), Status.OK, "AC"),
        (mains, power(**DRAINED, AC__type="Mains", AC__online="0"), Status.WARN, "battery, 81 %"),
        (mains, power(BAT0__type="Battery"), Status.WARN, "battery, ? %"),
        (mains, power(mouse__type="Battery", mouse__scope="Device"), Status.OK, "no battery"),
        (room_to_run, Machine(files=memory(512_000)), Status.OK, None),
        (room_to_run, Machine(files=memory(511_000)), Status.WARN, None),
        (room_to_run, Machine(files=memory(MUCH_kB) | GROUP), Status.WARN, None),
        (room_to_run, Machine(files=memory(MUCH_kB) | GROUP | {"/sys/fs/cgroup/memory.max": "max"}), Status.OK, None),
        (room_to_run, Machine(), Status.WARN, None),
        (room_to_run, Machine(files=memory(MUCH_kB), open_files=255), Status.FAIL, None),
        (room_to_run, Machine(files=memory(MUCH_kB), open_files=None), Status.OK, None),
        (guard, Machine(programs=GUARD), Status.OK, None),
        (guard, Machine(), Status.FAIL, None),
        (latency_timers, latency("1"), Status.OK, "1 ms"),
        (latency_timers, latency("2"), Status.OK, "2 ms"),
        (latency_timers, latency("16"), Status.WARN, "16 ms"),
    ],
)
def test_what_a_machine_is_like(
    tmp_path: Path, check: Any, machine: Machine, status: Status, value: str | None
) -> None:
    found = check(context(tmp_path, host=machine, links=USB if check is latency_timers else {}))
    (finding,) = found if isinstance(found, list) else [found]
    assert (finding.status, value if value is None else finding.value) == (status, value)


def test_a_rehearsal_needs_no_guard_and_no_drill(tmp_path: Path) -> None:
    bench = context(tmp_path, plan=in_process_plan())
    assert (guard(bench).status, drill(bench).status) == (Status.SKIPPED, Status.SKIPPED)


def test_versions_are_those_of_the_lock(tmp_path: Path) -> None:
    lock = "#  with Python 3.99\nnumpy==2.2.0 \\\n    --hash=sha256:0\ncrcmod-plus==2.3.6\npyvisa==1.16.2\n"
    host = Machine(
        files={str(LOCK_FILE): lock}, versions={"numpy": "2.2.0", "crcmod-plus": "2.3.6", "PyVISA": "1.16.1"}
    )
    found = software(context(tmp_path, host=host))
    assert found.status is Status.WARN
    assert found.value.startswith("Python 3.")
    assert found.value.endswith("PyVISA 1.16.1")
    assert "numpy" not in found.value
    assert software(context(tmp_path, host=Machine())).status is Status.SKIPPED


def test_the_lock_names_the_packages_that_numbers_depend_on() -> None:
    lock = LOCK_FILE.read_text(encoding="utf-8").lower()
    assert [one for one in PACKAGES if f"\n{one.lower()}==" not in lock] == ["inertial-bench"]


@pytest.mark.parametrize(
    ("days", "passed", "status"),
    [(1.0, True, Status.OK), (30.0, True, Status.OK), (30.1, True, Status.WARN), (1.0, False, Status.FAIL)],
)
def test_the_last_drill(tmp_path: Path, days: float, passed: bool, status: Status) -> None:
    bench = context(tmp_path)
    began = bench.start_utc - timedelta(days=days)
    folder = tmp_path / f"20260101T000000Z_drill_{bench.station.name}"
    folder.mkdir()
    found = {"station": bench.station.name, "utc": began.isoformat(), "passed": passed}
    (folder / RESULT).write_text(json.dumps(found))
    assert drill(bench).status is status


def test_a_bench_without_a_drill(tmp_path: Path) -> None:
    assert drill(context(tmp_path)).status is Status.WARN


def test_a_bench_that_no_drill_can_try_is_not_told_to_run_one(tmp_path: Path) -> None:
    """A table and a supply: there is no stimulus that could be on and harms nothing."""
    found = drill(context(tmp_path, plan=compile_sequence("gnc_unit_test", gnc_station(tmp_path))))
    assert (found.status, "drill could switch on" in found.text) == (Status.SKIPPED, True)


def gnc_station(folder: Path) -> Station:
    source = load_station(find_shipped("stations", "gnc_bench_sim"))
    resources = dict.fromkeys(source.instruments, "TCPIP0::h::hislip0::INSTR")
    path = folder / "station.yaml"
    path.write_text(served_station(source, resources, {"rs422": "/dev/null"}, folder / "control.sock", TODAY))
    return load_station(path)


def test_a_machine_is_asked_without_errors(tmp_path: Path) -> None:
    host = Host()
    assert host.text(str(tmp_path / "none")) is None
    assert host.names(str(tmp_path / "none")) == []
    assert host.output(("no-such-program",)) is None
    assert host.output(("false",)) is None
    assert host.output(("sleep", "60"), limit_s=0.05) is None
    assert host.output(("echo", "here")) == "here"
    assert host.version("no-such-package") is None
    assert host.terminal(None) == ""
    with (tmp_path / "file").open("w") as file:
        assert host.terminal(file.fileno()) == ""
    (tmp_path / "file").unlink()
    assert host.newest_change_utc_ns(tmp_path) is None
    (tmp_path / "session").mkdir()
    assert host.newest_change_utc_ns(tmp_path) == (tmp_path / "session").stat().st_mtime_ns
    state = host.kernel_clock()
    assert state is None or state.largest_error_s >= 0.0


def test_room_on_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need = summarise(served_plan()).disk_bytes
    assert space(context(tmp_path)).status is Status.OK
    assert space(context(tmp_path, host=Machine(file_bytes=need - 1))).status is Status.FAIL
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=2 * need - 1))
    found = space(context(tmp_path))
    assert found.status is Status.FAIL
    assert not found.of_bench


def test_a_trial_of_the_disk_leaves_nothing_behind(tmp_path: Path) -> None:
    clock = clock_at_noon()
    waits_s = iter([0.5] + [0.015] * 1000)
    trial = try_disk(tmp_path / "not" / "there", clock, 1000, lambda _: clock.sleep(next(waits_s)))
    assert trial.bytes_s == pytest.approx(101 * 1000 / 2.0)
    assert trial.fsync_p99_s == 0.015, "one of 101 is above the 99th percentile"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("fsync_s", "status"), [(0.005, Status.OK), (0.24, Status.OK), (0.3, Status.WARN), (1.1, Status.FAIL)]
)
def test_a_slow_disk(tmp_path: Path, fsync_s: float, status: Status) -> None:
    clock = clock_at_noon()
    assert write_speed(context(tmp_path, clock=clock), lambda _: clock.sleep(fsync_s)).status is status


def test_a_disk_that_does_not_keep_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """64 KiB each 0.2 s are 0.33 MB/s; twice 0.2 MB/s are due."""
    clock = clock_at_noon()
    bench = context(tmp_path, clock=clock)
    monkeypatch.setattr(
        "bench.run.preflight.of_machine.summarise", lambda _: SimpleNamespace(disk_bytes=0.2e6 * bench.length_s)
    )
    found = write_speed(bench, lambda _: clock.sleep(0.63))
    assert (found.status, found.limit.split(",")[0]) == (Status.FAIL, "0.400 MB/s")


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    def refuse(_: int) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    found = write_speed(context(tmp_path), refuse)
    assert found.status is Status.FAIL
    assert "Read-only" in found.text
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def line() -> Iterator[tuple[Any, int]]:
    """A port of the machine opened as the bench opens it, and the descriptor of its other end."""
    other, own = os.openpty()
    port = open_port("port_a", os.ttyname(own), BAUD, exclusive=True)
    yield port, other
    port.close()
    os.close(own)
    os.close(other)


def change(port: Any, index: int, clear: int, setting: int) -> None:
    modes = termios.tcgetattr(port.fileno())
    modes[index] = modes[index] & ~clear | setting
    termios.tcsetattr(port.fileno(), termios.TCSANOW, modes)


def test_a_port_is_as_the_bench_opened_it(tmp_path: Path, line: tuple[Any, int]) -> None:
    for other in (SimpleNamespace(), SimpleNamespace(fileno=lambda: -1)):
        found = line_settings(context(tmp_path, links={"port_a": line[0], "port_b": other}))
        assert [finding.status for finding in found] == [Status.OK, Status.SKIPPED]


@pytest.mark.parametrize(
    ("index", "clear", "setting", "value"),
    [
        (0, 0, termios.IXON, "XON/XOFF on"),
        (0, 0, termios.IXOFF, "XON/XOFF on"),
        (2, 0, termios.CRTSCTS, "RTS/CTS on"),
        (2, 0, termios.CSTOPB, "2 stop bits"),
        (5, -1, termios.B9600, "9600 baud"),
    ],
)
def test_a_port_that_somebody_changed(
    tmp_path: Path, line: tuple[Any, int], index: int, clear: int, setting: int, value: str
) -> None:
    change(line[0], index, clear, setting)
    found = line_settings(context(tmp_path, links={"port_a": line[0], "port_b": SimpleNamespace()}))[0]
    assert (found.status, found.value, found.of_bench) == (Status.FAIL, value, True)


def test_a_port_that_does_not_open(tmp_path: Path) -> None:
    error = LinkError("B-RUN-003", "no-such-device does not open", where="port_a")
    found = line_settings(context(tmp_path, links={"port_b": SimpleNamespace()}, absent={"port_a": error}))[0]
    assert (found.status, found.value, found.of_bench) == (Status.FAIL, "B-RUN-003", True)


def test_what_is_no_terminal(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with (tmp_path / "file").open() as file:
        found = line_settings(context(tmp_path, links={"port_a": file, "port_b": SimpleNamespace()}))[0]
    assert found.status is Status.WARN


def test_what_the_links_deliver_before_the_unit_is_on(tmp_path: Path, line: tuple[Any, int]) -> None:
    port, other = line
    (silent,) = quiet(context(tmp_path, links={"port_a": port}))
    assert (silent.status, silent.value) == (Status.OK, "0 bytes")
    os.write(other, b"garbage")
    select.select([port.fileno()], [], [], 10.0)
    (noisy,) = quiet(context(tmp_path, links={"port_a": port}))
    assert (noisy.status, noisy.value) == (Status.OK, "7 bytes")
    assert port.read(100) == b"garbage", "nothing was taken away"


def test_a_port_that_fails(tmp_path: Path) -> None:
    class Gone:
        @property
        def in_waiting(self) -> int:
            raise OSError(errno.EIO, "Input/output error")

    (found,) = quiet(context(tmp_path, links={"port_a": Gone()}))
    assert (found.status, found.of_bench) == (Status.FAIL, True)
