"""Repeat a test of a safety limit only if the machine, not the bench, was late: ``@pytest.mark.limit(seconds)``.

The limit counts physical time and stays as it is. Beside such a test a process of its own sleeps and works by turns,
half of the time (one that works little is hardly made to wait), and adds up how late it is: a test that fails while
that comes to more than the limit has said nothing of the bench. It is run again, at most ``REPEATS`` times, and the
summary names it. On a machine that is not late a failure is a failure.
"""

import contextlib
import subprocess
import sys
from collections.abc import Iterator

import pytest
from _pytest.runner import runtestprotocol

REPEATS = 8  # three were too few for the kill drill at a load of 12 to 20
STALLED = "stalled_s"
METER = """
import select, sys, time
REST_S, WORK_S, USUAL_S = 0.02, 0.02, 0.002
late_s, asked, begun_s = 0.0, False, time.monotonic()
while not asked or sys.stdin.readline():
    if asked:
        print(late_s, flush=True)
        late_s = 0.0
    spent_s = time.process_time()
    asked = select.select([sys.stdin], [], [], REST_S)[0]
    while time.process_time() - spent_s < WORK_S:
        pass
    ended_s = time.monotonic()
    lost_s, begun_s = ended_s - begun_s - REST_S - WORK_S, ended_s
    late_s += lost_s if lost_s > USUAL_S else 0.0
"""  # a process of its own, that waits for no lock of this one; many short waits for a core are as late as a long one


class StallMeter:
    """A process that tells how late it was in all since it was last asked, in seconds."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-S", "-c", METER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )
        self.late_s()

    def late_s(self) -> float:
        """Return by how much the machine was late since the last call, in seconds."""
        assert self._process.stdout is not None
        self._process.stdin.write("\n")
        return float(self._process.stdout.readline())

    def stop(self) -> None:
        """End the process."""
        self._process.communicate()


@contextlib.contextmanager
def meter() -> Iterator[StallMeter]:
    """Run a meter beside a test."""
    running = StallMeter()
    try:
        yield running
    finally:
        running.stop()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Run a test of a limit, again if it failed while the machine was late by more than its limit."""
    mark = item.get_closest_marker("limit")
    if mark is None:
        return None
    (limit_s,) = mark.args
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    with meter() as running:
        stalls_s: list[float] = []
        reports = runtestprotocol(item, log=False, nextitem=nextitem)
        while any(report.failed for report in reports) and len(stalls_s) < REPEATS:
            stall_s = running.late_s()
            if stall_s <= limit_s:
                break
            stalls_s.append(stall_s)
            item.session._setupstate.teardown_exact(None)  # a bench that was disturbed is not the next one's
            item._initrequest()  # type: ignore[attr-defined]
            reports = runtestprotocol(item, log=False, nextitem=nextitem)
    for report in reports:
        report.user_properties += [(STALLED, stall_s) for stall_s in stalls_s if report.when == "call"]
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Name each test that was repeated, and the stall before."""
    rows = [
        f"{report.nodeid}: repeated, the machine was {stall_s:.1f} s late"
        for reports in terminalreporter.stats.values()
        for report in reports
        for name, stall_s in getattr(report, "user_properties", [])
        if name == STALLED and report.when == "call"
    ]
    if rows:
        terminalreporter.section(f"repeated behind a stall: {len(rows)}")
        for row in rows:
            terminalreporter.line(row)
