"""The whole simulated bench with the simulated unit: what is sent to the instruments shows in the unit's frames."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import pyvisa
import serial
from calibrator_trip import trip_calibrator
from sim_bench import Bench, station

from bench.frame import LinkDecoder, load_frame
from bench.model.clock import VirtualClock
from sim_instruments.worlds.simulation import open_world

NGU_A = Path(__file__).parents[3] / "frames" / "ngu_a.yaml"
GYRO_A_PER_HZ = 1.25e-6


class Session:
    """A bench, the open port A and a decoder."""

    def __init__(self) -> None:
        self.world = open_world(
            "af_converter", clock=VirtualClock(), seed=5, station=station(), options={"calibrator_gain": "off"}
        )
        self.bench = Bench(self.world, pyvisa.ResourceManager(self.world.visa_library))
        if "sim_instruments.bus" not in serial.protocol_handler_packages:
            serial.protocol_handler_packages.append("sim_instruments.bus")
        self.port = serial.serial_for_url(self.world.link_url("port_a"), baudrate=921_600, timeout=0)
        self.decoder = LinkDecoder(load_frame(NGU_A))

    def frames(self, seconds: float):
        """Frames that arrive in the next seconds; None if there are none."""
        self.port.reset_input_buffer()
        self.bench.clock.sleep(seconds)
        self.decoder.push(self.bench.clock.now_ns(), self.port.read(self.port.in_waiting))
        return self.decoder.flush().messages.get("frame")

    def close(self) -> None:
        self.port.close()
        self.bench.manager.close()
        self.world.close()


@pytest.fixture
def session() -> Iterator[Session]:
    opened = Session()
    yield opened
    opened.close()


def powered(session: Session) -> Bench:
    session.bench.send("supply", "CURR 2;VOLT 18;:OUTP ON")
    session.bench.clock.sleep(5.0)
    return session.bench


def test_no_power_no_frames(session: Session) -> None:
    silent = session.frames(10.0)
    assert silent is None or len(silent) == 0
    powered(session)
    assert len(session.frames(10.0)) == pytest.approx(1000, abs=3)
    session.bench.send("supply", "OUTP OFF")
    session.frames(1.0)
    silent = session.frames(10.0)
    assert silent is None or len(silent) == 0


@pytest.mark.parametrize(("row", "counts"), [(1, "npp"), (2, "ppp")])
def test_current_shows_in_the_counts_of_the_routed_channel(session: Session, row: int, counts: str) -> None:
    bench = powered(session)
    bench.send("switch", f":CLOS (@1!{row}!3)")
    bench.send("calibrator", "OUT 1.0E-02 A, 0 HZ", "OPER")
    bench.clock.sleep(10.0)
    frames = session.frames(20.0)
    other = {"npp": "ppp", "ppp": "npp"}[counts]
    rate_Hz = frames.raw(counts).sum(axis=0) / (len(frames) * 0.01)
    assert rate_Hz[2] * GYRO_A_PER_HZ == pytest.approx(1e-2, rel=2e-3)
    assert not frames.raw(other)[:, 2].any()
    assert np.all(np.delete(rate_Hz, 2) < 5.0)


def test_function_generator_shows_in_its_count(session: Session) -> None:
    bench = powered(session)
    bench.send("function_generator", "FUNC SQU;:OUTP:LOAD INF;:FREQ 1E7;:VOLT 1;:OUTP ON")
    bench.clock.sleep(1.0)
    frames = session.frames(10.0)
    counted = frames.raw("fg_count")
    assert counted.mean() == pytest.approx(1e5, rel=20e-6)
    bench.send("function_generator", "OUTP OFF")
    bench.clock.sleep(1.0)
    assert not session.frames(5.0).raw("fg_count").any()


def test_trip_during_a_record_leaves_frames_up_to_it_untouched(session: Session) -> None:
    bench = powered(session)
    bench.send("switch", ":CLOS (@1!1!1)")
    bench.send("calibrator", "OUT 1.0E-02 A, 0 HZ", "OPER")
    bench.clock.sleep(10.0)
    trip_ns = bench.clock.now_ns() + 5_500_000_000
    trip_calibrator(session.world, trip_ns)
    npp = session.frames(10.0).raw("npp")[:, 0]
    assert np.count_nonzero(npp > 70) == pytest.approx(550, abs=2)
    assert npp[:545].min() >= 79
    assert npp[556:].max() <= 2
