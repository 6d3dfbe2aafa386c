"""Instruments behind a GPIB adapter, which is simulated; settings of a serial line; what a station says of them."""

from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest
from sim_bench import DRIVERS, serve

from bench.model.clock import WallClock
from bench.model.errors import InstrumentError
from bench.plan.station import SerialLine, boards_of
from bench.run.bus.opener import Visa, open_instrument, open_visa


def opened(visa: Visa, role: str) -> Any:
    """The driver of a role of the simulated bench behind the adapter."""
    address = f"GPIB0::{list(DRIVERS).index(role) + 1}::INSTR"
    entry = SimpleNamespace(driver=DRIVERS[role], resource=address, options={}, line={})
    return open_instrument(visa, role, entry, WallClock(), lambda *_: None, used=True)  # type: ignore[arg-type]


def test_a_short_session_behind_an_adapter(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three instruments share it; a poll of one that is mute mixes nothing up."""
    with serve() as served:
        visa = open_visa("@py", boards_of([served.servers.adapter]))
        calibrator, meter, supply = (opened(visa, role) for role in ("calibrator", "dmm", "supply"))
        monkeypatch.setattr("sim_instruments.hp_3458a.Hp3458A.reading_s", 0.04)
        calibrator.output(0.01)
        meter.configure_current(0.1)
        assert abs(meter.measure_current()) < 1e-3
        supply.identify()
        served.world.faults.instrument("supply").mute = True
        with pytest.raises(InstrumentError, match=r"serial poll: 0"):
            supply.bus.query("VOLT?", str, 0.2, repeatable=False)
        served.world.faults.instrument("supply").mute = False
        assert meter.ask("ID?", str) == "HP3458A"
        calibrator.make_safe()
        visa.close()


def test_a_serial_line_is_set_as_the_station_says() -> None:
    manager = MagicMock()
    manager.open_resource.return_value.resource_name = "ASRL/dev/serial/by-id/usb-A_B-if00::INSTR"
    line = SerialLine(baud=4800, bits=7, parity="even", stop=2, handshake="dtr_dsr").model_dump()
    entry: Any = SimpleNamespace(resource="ASRL/dev/serial/by-id/usb-A_B-if00::INSTR", line=line)
    Visa(manager, {}).open("meter", entry)
    found = [call.args for call in manager.open_resource.return_value.set_visa_attribute.call_args_list]
    names = ("asrl_baud_rate", "asrl_data_bits", "asrl_parity", "asrl_stop_bits", "asrl_flow_control")
    assert {name.name: int(value) for name, value in found} == dict(zip(names, (4800, 7, 2, 20, 4), strict=True))


def test_boards_by_the_number_of_their_adapter() -> None:
    adapters = ["PRLGX-TCPIP1::lab-gpib::INTFC", "PRLGX-ASRL::/dev/serial/by-id/usb-Prologix_GPIB-if00::INTFC"]
    assert boards_of(adapters) == {
        "GPIB1": "TCPIP0::lab-gpib::1234::SOCKET",
        "GPIB0": "ASRL/dev/serial/by-id/usb-Prologix_GPIB-if00::INSTR",
    }
