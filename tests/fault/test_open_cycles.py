"""Row 24: a thousand benches that were opened, failed and closed leave no descriptor and no thread behind."""

import gc
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from rehearsal import rehearsed
from served import Served
from soak_campaign import soak_plan

from bench.model.clock import WallClock
from bench.model.errors import BenchError
from bench.plan import Plan, load_station
from bench.record import Journal, SessionWriter
from bench.run.bench.opener import open_bench
from bench.run.guard.lock import bench_lock
from sim_instruments.worlds.common.world import World

pytestmark = pytest.mark.waits

CYCLES = 1000
SHORT = 15
SERVED = 40


def kept() -> tuple[int, int]:
    """Descriptors and threads of this process."""
    gc.collect()
    return len(list(Path("/proc/self/fd").iterdir())), threading.active_count()


def constant(cycle: Callable[[int], None], cycles: int) -> None:
    """After a first few, no cycle leaves anything behind."""
    for number in range(3):
        cycle(number)
    before = kept()
    for number in range(3, 3 + cycles):
        cycle(number)
    assert kept() == before


def failing_run(plan: Plan, out: Path) -> Callable[[int], None]:
    """A run whose instrument is not the one it should be: opened, refused, closed."""

    def exchange(world: World) -> None:
        world.faults.instrument("switch").identity = "ACME,42,0,0"

    def cycle(_: int) -> None:
        with pytest.raises(BenchError, match="B-INST-002"):
            rehearsed(out, plan, exchange, seed=1)

    return cycle


@pytest.mark.parametrize("cycles", [SHORT, pytest.param(CYCLES, marks=pytest.mark.sweep)])
def test_benches_that_do_not_open(tmp_path: Path, cycles: int) -> None:
    constant(failing_run(soak_plan(tmp_path), tmp_path / "out"), cycles)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("cycles", [SHORT, pytest.param(CYCLES, marks=pytest.mark.sweep)])
def test_sessions_and_journals(tmp_path: Path, cycles: int) -> None:
    def cycle(number: int) -> None:
        folder = tmp_path / str(number)
        writer = SessionWriter.create(folder, {"schema": 1}, {}, t_mono_ns=0)
        with pytest.raises(BenchError, match="B-REC-001"):
            SessionWriter.create(folder, {"schema": 1}, {}, t_mono_ns=0)
        journal = Journal(folder)
        with pytest.raises(BenchError, match="B-REC-006"):
            Journal(folder)
        journal.close()
        writer.close("done")

    constant(cycle, cycles)


@pytest.mark.slow
@pytest.mark.parametrize("cycles", [4, pytest.param(SERVED, marks=pytest.mark.sweep)])
def test_benches_in_another_process_that_do_not_open(served: Served, cycles: int) -> None:
    """Sessions of PyVISA over the network, ports and the lock of the bench."""
    station, clock = load_station(served.station), WallClock()
    served.fault("identity", "rail_dmm", "ACME,42,0,0")

    def cycle(_: int) -> None:
        with bench_lock((entry.resource for entry in station.instruments.values()), "test", clock):
            bench = open_bench(station, clock, lambda *_: None, seed=1)
            try:
                with pytest.raises(BenchError, match="B-INST-002"):
                    bench.instruments["rail_dmm"].identify()
            finally:
                bench.close()

    constant(cycle, cycles)
