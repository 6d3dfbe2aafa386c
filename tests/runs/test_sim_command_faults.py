"""Every fault of a served bench through what others see of it: stock PyVISA, pySerial, and its true state."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import serial
from pyvisa.constants import StatusCode
from pyvisa.errors import VisaIOError
from rehearsal import bench
from served_bench import CLOCK, Served, powered_rack

from bench.frame import LinkDecoder, load_frame
from bench.model.shipped import find_shipped
from sim_instruments.worlds.simulation import possible_faults

pytestmark = pytest.mark.waits


@pytest.fixture(scope="module")
def process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    served = powered_rack(tmp_path_factory.mktemp("bench") / "sim")
    yield served
    print(f"the simulated bench used {served.cpu_s():.1f} s of CPU")
    assert served.end() == 0


@pytest.fixture
def served(process: Served) -> Iterator[Served]:
    yield process
    process.fault("clear")


def is_gone(port: serial.Serial) -> bool:
    try:
        for _ in range(3):  # what had arrived comes first
            port.read(10_000)
    except serial.SerialException:
        return True
    return False


def timed_out(call: Any) -> bool:
    try:
        call()
    except VisaIOError as error:
        return bool(error.error_code == StatusCode.error_timeout)
    return False


@pytest.mark.parametrize(
    ("words", "count"),
    [
        (("bit_errors", "port_a", "1e-3"), "bad"),
        (("drop", "port_a", "0.2"), "lost"),
        (("duplicate", "port_a", "0.2"), "duplicate"),
    ],
)
def test_damaged_links(served: Served, words: tuple[str, ...], count: str) -> None:
    assert served.fault(*words) == [" ".join(words)]
    assert getattr(served.listen("port_a", 1.0), count) > 3


def test_silent_and_stuck_links(served: Served) -> None:
    served.fault("silent", "port_a")
    CLOCK.sleep(0.1)
    assert served.listen("port_a", 0.5).bytes <= 57
    served.fault("silent", "port_a", "off")
    served.fault("stuck", "port_a", "eb90")
    CLOCK.sleep(0.1)
    with serial.Serial(str(served.folder / "port_a"), timeout=0.5) as port:
        port.reset_input_buffer()
        assert set(port.read(2000)) == {0xEB, 0x90}


def test_unplugged_and_back(served: Served) -> None:
    path = served.folder / "port_a"
    with serial.Serial(str(path), timeout=1.0) as port:
        served.fault("unplug", "port_a")
        assert is_gone(port)
        assert not path.is_symlink()
    assert served.fault("replug", "port_a") == []
    CLOCK.sleep(0.1)
    assert served.listen("port_a", 0.5).frames > 10


def test_a_mute_and_a_hanging_instrument(served: Served) -> None:
    rail = served["rail_dmm"]
    served.fault("mute", "rail_dmm")
    assert timed_out(lambda: rail.query("*IDN?"))
    assert isinstance(rail.read_stb(), int)
    rail.clear()
    served.fault("clear")
    assert rail.query("*IDN?").startswith("HEWLETT-PACKARD,34401A")
    served.fault("hang", "rail_dmm")
    rail.write("*IDN?")
    assert timed_out(rail.read)
    with pytest.raises((VisaIOError, OSError)):  # pyvisa-py lets the socket's own time-out through
        rail.read_stb()
    assert served["dmm"].query("ID?").strip() == "HP3458A"
    served.fault("hang", "rail_dmm", "off")
    rail.close()
    del served._sessions["rail_dmm"]
    assert served["rail_dmm"].query("*IDN?").startswith("HEWLETT-PACKARD,34401A")


def test_late_garbled_and_foreign_replies(served: Served) -> None:
    supply = served["supply"]
    served.fault("late", "supply", "0.6")
    began_ns = CLOCK.now_ns()
    assert supply.query("VOLT?") == "1.80000E+01"
    assert CLOCK.now_ns() - began_ns >= 600_000_000
    served.fault("garbled", "supply", "1")
    assert "#" in supply.query("VOLT?")
    served.fault("identity", "supply", "ACME,42,0,0")
    assert supply.query("*IDN?") == "ACME,42,0,0"


def test_readings_that_are_no_numbers(served: Served) -> None:
    served["rail_dmm_2"].write("CONF:VOLT:DC 10")
    served.fault("nan", "rail_dmm_2")
    served.fault("overload", "rail_dmm_2", "1")
    readings = [float(served["rail_dmm_2"].query("READ?")) for _ in range(3)]
    assert readings[:2] == [9.91e37, 9.9e37]
    assert abs(readings[2]) < 10


@pytest.mark.parametrize(("fault", "queued"), [("trip", "502"), ("calibrator_drops", "0")])
def test_the_calibrator_goes_off_by_itself(served: Served, fault: str, queued: str) -> None:
    served["switch"].write(":CLOS (@1!1!1)")
    calibrator = served["calibrator"]
    for command in ("*CLS", "OUT 1.0E-03 A, 0 HZ", "OPER"):
        calibrator.write(command)
    CLOCK.sleep(0.2)
    state = served.state()
    assert state["instruments"]["calibrator"] | {"unchanged_s": 0} == {
        "model": "Fluke5720A", "operating": True, "set": 1e-3, "unit": "A", "unchanged_s": 0
    }  # fmt: skip
    assert state["instruments"]["switch"]["closed"] == ["1!1!1"]
    assert state["loop_current_A"] == pytest.approx(1e-3, rel=1e-3)
    assert state["unit"]["inputs_A"]["1"] == pytest.approx(1e-3, rel=1e-3)
    served.fault(fault)
    assert calibrator.query("ISR?") == "4096"
    assert calibrator.query("FAULT?") == queued
    state = served.state()
    assert (state["loop_current_A"], state["instruments"]["calibrator"]["operating"]) == (0.0, False)
    assert state["instruments"]["calibrator"]["unchanged_s"] < 5.0
    served["switch"].write(":OPEN ALL")


def test_chamber_that_runs_away_or_never_arrives(served: Served) -> None:
    chamber = served["chamber"]
    for operation in ("MRMP1,10.0", "SETP1,23.5", "RUNM"):
        assert chamber.query(operation) == "0"
    served.fault("chamber_runaway", "20")
    first = served.state()["chamber_air_degC"]
    CLOCK.sleep(1.0)
    assert served.state()["chamber_air_degC"] - first > 0.3
    served.fault("chamber_runaway", "off")
    served.fault("chamber_shortfall", "2")
    for operation in ("MRMP1,20.0", "SETP1,25"):
        chamber.query(operation)
    CLOCK.sleep(6.0)  # 0.6 s air lag
    assert abs(served.state()["chamber_air_degC"] - 25.0) > 1.5
    assert served.state()["instruments"]["chamber"]["mode"] == "running"
    assert chamber.query("STOP") == "0"
    assert served.state()["instruments"]["chamber"]["mode"] == "stopped"


def test_the_reference_is_lost(served: Served) -> None:
    served["counter"].write("ROSC:SOUR EXT")
    served.fault("reference_lost")
    assert int(served["counter"].query("STAT:QUES:EVEN?")) == 1 << 10


def test_the_unit_restarts(served: Served) -> None:
    served.fault("unit_restart")
    CLOCK.sleep(2.0)
    decoder = LinkDecoder(load_frame(find_shipped("frames", "ngu_a")))
    with serial.Serial(str(served.folder / "port_a"), timeout=0.3) as port:
        port.reset_input_buffer()
        decoder.push(0, port.read(500))
    (frames,) = decoder.flush().messages.values()
    assert int(frames.raw("counter")[0]) < 1000


def test_every_fault_is_in_the_list_and_has_a_test(served: Served) -> None:
    faults = possible_faults()
    listed = bench("sim", "fault", "--dir", str(served.folder)).stdout.splitlines()
    assert [line.split()[0] for line in listed] == [*faults, "clear", "state"]
    tables = Path(__file__).parents[1] / "unit/sim_instruments/test_sim_table.py"
    text = Path(__file__).read_text() + tables.read_text()
    assert {name for name in faults if f'"{name}"' not in text} == set()
