"""A turntable that spins and a tagger that streams when their controller is killed or stopped.

Within the deadline the table is at rest with open interlocks, the tagger without stream and supply. What counts is what
the simulated instruments really do, never a readback of the bench's own.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from served import SAFE_S, Controller, Served, serving

pytestmark = [pytest.mark.waits, pytest.mark.limit(SAFE_S)]

SPINNING = """\
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
STREAMING = """\
sequence: streaming
station: rlg_bench_sim
frame: {edges: time_tags, rlg: rlg_housekeeping}
prepare:
  - supply.configure: {voltage: 15 V, current_limit: 1 A, over_voltage: 16.5 V}
  - supply.output_on
  - settle: 5 s
  - tagger.configure: {clock: 20 MHz}
  - tagger.start
  - settle: 5 s
steps:
  - supply.measure_current
  - settle: 10 min
finally:
  - tagger.stop
  - supply.output_off
"""
ENDS = [signal.SIGKILL, signal.SIGSTOP]


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with serving(tmp_path_factory.mktemp("table"), of="gnc_bench_sim") as served:
        yield served


def table_of(instruments: dict[str, Any]) -> tuple[object, ...]:
    return instruments["turntable"]["rates_deg_s"], instruments["turntable"]["interlocks"]


def tagger_of(instruments: dict[str, Any]) -> tuple[object, ...]:
    return instruments["tagger"]["measuring"], instruments["supply"]["on"]


def drilled(bench: Served, tmp_path: Path, sequence: str, number: signal.Signals, spoken: str) -> Iterator[Any]:
    """Yield the instruments while all is on, end the controller by a signal, and yield them when its guard is done."""
    path = tmp_path / "sequence.yaml"
    path.write_text(sequence)
    controller = Controller(bench.station, path, tmp_path / "out")
    try:
        controller.wait_for(spoken)
        time.sleep(0.5)
        yield bench.state()["instruments"]
        moment_s = time.monotonic()
        os.kill(controller.process.pid, number)
        assert controller.wait_for_guard("safe", "unsafe")["what"] == "safe"
        yield bench.state()["instruments"]
        roles = ("turntable",) if "turntable" in sequence else ("tagger", "supply")
        after_s = bench.changed_s(*roles) - moment_s
        print(f"{number.name}: at rest {after_s:.2f} s after")
        assert 0 < after_s <= SAFE_S
    finally:
        controller.kill()


@pytest.mark.slow
@pytest.mark.parametrize("number", ENDS)
def test_a_killed_or_stopped_controller_leaves_a_table_at_rest_with_open_interlocks(
    table: Served, tmp_path: Path, number: signal.Signals
) -> None:
    spinning, rest = drilled(table, tmp_path, SPINNING, number, "measure_rate")
    assert table_of(spinning)[0] == [-250.0, 0.0, 270.0]
    assert table_of(rest) == ([0.0] * 3, ["Open"] * 3)


@pytest.mark.sweep
@pytest.mark.parametrize("number", ENDS)
def test_a_killed_or_stopped_controller_leaves_no_stream_and_no_supply(tmp_path: Path, number: signal.Signals) -> None:
    with serving(tmp_path / "bench", of="rlg_bench_sim") as bench:
        streaming, rest = drilled(bench, tmp_path, STREAMING, number, "measure_current")
    assert (tagger_of(streaming), tagger_of(rest)) == ((True, True), (False, False))
