"""A turntable that spins when its controller is killed or stopped: at rest with open interlocks within the deadline.

What counts is what the simulated table really does, never a readback of the bench's own.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from served import SAFE_S, Controller, Served

pytestmark = [pytest.mark.waits, pytest.mark.limit(SAFE_S)]

SEQUENCE = """\
sequence: spinning
station: gnc_bench_sim
frame: {rs422: gnc_422}
timeline:
  - {at: 0 s, call: {turntable.set_limits: {axis: 1, rate: 300 deg/s, acceleration: 300 deg/s2}}}
  - {at: 4 s, call: {turntable.set_limits: {axis: 2, rate: 300 deg/s, acceleration: 300 deg/s2}}}
  - {at: 8 s, call: {turntable.set_limits: {axis: 3, rate: 300 deg/s, acceleration: 300 deg/s2}}}
  - {at: 12 s, call: turntable.close_interlock}
  - {at: 23 s, call: {turntable.spin: {axis: 1, rate: -250 deg/s}}}
  - {at: 26 s, call: {turntable.spin: {axis: 3, rate: 270 deg/s}}}
  - {at: 29 s, call: {turntable.measure_rate: {axis: 3}}}
  - {at: 600 s, call: turntable.open_interlock}
"""
SPINNING = [-250.0, 0.0, 270.0]


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    served = Served(tmp_path_factory.mktemp("table"), of="gnc_bench_sim")
    try:
        yield served
    finally:
        served.close()


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_killed_or_stopped_controller_leaves_a_table_at_rest_with_open_interlocks(
    table: Served, tmp_path: Path, out: Path, number: signal.Signals
) -> None:
    sequence = tmp_path / "spinning.yaml"
    sequence.write_text(SEQUENCE)
    controller = Controller(table.station, sequence, out)
    try:
        controller.wait_for("measure_rate")
        time.sleep(0.5)
        assert table.state()["instruments"]["turntable"]["rates_deg_s"] == SPINNING
        moment_s = time.monotonic()
        os.kill(controller.process.pid, number)
        assert controller.wait_for_guard("safe", "unsafe")["what"] == "safe"
        found = table.state()["instruments"]["turntable"]
        assert found["interlocks"] == ["Open"] * 3
        assert found["rates_deg_s"] == [0.0] * 3
        after_s = table.changed_s("turntable") - moment_s
        print(f"{number.name}: at rest and open {after_s:.2f} s after")
        assert 0 < after_s <= SAFE_S
    finally:
        controller.kill()
