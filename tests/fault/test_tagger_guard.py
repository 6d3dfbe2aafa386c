"""A time tagger that streams when its controller is killed or stopped: no stream and no supply within the deadline.

What counts is what the simulated instruments really do, never a readback of the bench's own.
"""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest
from served import SAFE_S, Controller, Served

pytestmark = [pytest.mark.waits, pytest.mark.limit(SAFE_S)]

SEQUENCE = """\
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


@pytest.mark.sweep
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_killed_or_stopped_controller_leaves_no_stream_and_no_supply(tmp_path: Path, number: signal.Signals) -> None:
    bench = Served(tmp_path / "bench", of="rlg_bench_sim")
    sequence = tmp_path / "streaming.yaml"
    sequence.write_text(SEQUENCE)
    controller = Controller(bench.station, sequence, tmp_path / "out")
    try:
        controller.wait_for("measure_current")
        time.sleep(0.5)
        found = bench.state()["instruments"]
        assert (found["tagger"]["measuring"], found["supply"]["on"]) == (True, True)
        moment_s = time.monotonic()
        os.kill(controller.process.pid, number)
        assert controller.wait_for_guard("safe", "unsafe")["what"] == "safe"
        found = bench.state()["instruments"]
        assert (found["tagger"]["measuring"], found["supply"]["on"]) == (False, False)
        after_s = max(bench.changed_s("tagger"), bench.changed_s("supply")) - moment_s
        print(f"{number.name}: no stream, no supply {after_s:.2f} s after")
        assert 0 < after_s <= SAFE_S
    finally:
        controller.kill()
        bench.close()
