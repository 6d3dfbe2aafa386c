"""Exact exchanges of the rail multimeter, which measures resistance too."""

import pytest
from known_drivers import IDENTIFY, NO_ERROR, after, slow
from scripted import CLEAR, POLL, TIMEOUT, refused, scripted

START = [*IDENTIFY["agilent_34401a"], *after(b"CONF:VOLT:DC\n")]


def test_voltage_and_an_error_of_its_reading() -> None:
    with scripted("agilent_34401a", [*START, *slow(b"READ?\n", b"+5.00012345E+00\n"), NO_ERROR]) as meter:
        assert meter.measure_voltage() == 5.00012345
    script = [*START, *slow(b"READ?\n", b"+5.0E+00\n"), (b"SYST:ERR?\n", b'+531,"Insufficient memory"\n'), NO_ERROR]
    with scripted("agilent_34401a", script) as meter, refused("B-INST-005", "531"):
        meter.measure_voltage()


FOUR_WIRES = [*IDENTIFY["agilent_34401a"], *after(b"CONF:FRES 1.0E+03\n"), *after(b"FRES:NPLC 10\n")]


def test_resistance_and_volts_after_it_but_not_of_open_leads() -> None:
    script = [*FOUR_WIRES, *slow(b"READ?\n", b"+1.09735210E+02\n"), NO_ERROR]
    with scripted("agilent_34401a", script) as meter:
        assert meter.measure_resistance(1000.0, 10) == 109.73521
    script = [*FOUR_WIRES, *slow(b"READ?\n", b"+9.90000000E+37\n")]
    with scripted("agilent_34401a", script) as meter, refused("B-INST-007"):
        meter.measure_resistance(1000.0, 10)
    read = [*slow(b"READ?\n", b"+1.0E+00\n"), NO_ERROR]
    script = [*FOUR_WIRES, *read, *after(b"CONF:VOLT:DC\n"), *read]
    with scripted("agilent_34401a", script) as meter:
        meter.measure_resistance(1000.0, 10)
        assert meter.measure_voltage() == 1.0


@pytest.mark.parametrize(("range_ohm", "cycles"), [(10.0, 10), (2e8, 10), (1000.0, 2), (1000.0, 0.02)])
def test_what_the_meter_cannot_do_is_not_sent(range_ohm: float, cycles: float) -> None:
    with scripted("agilent_34401a", []) as meter, refused("B-INST-008"):
        meter.measure_resistance(range_ohm, cycles)


def test_a_configuration_in_doubt_is_read_back() -> None:
    """A command that was not taken is looked for: four wires on this range are set, nothing is sent again."""
    doubt = [(b"CONF:FRES 1.0E+02\n", None), (b"SYST:ERR?\n", TIMEOUT), (POLL, 0), (CLEAR, None)]
    seen = [(b"CONF?\n", b'"FRES +1.000000E+02,+1.000000E-04"\n')]
    script = [*IDENTIFY["agilent_34401a"], *doubt, *seen, *after(b"FRES:NPLC 1\n")]
    script += [*slow(b"READ?\n", b"+1.0E+02\n"), NO_ERROR]
    with scripted("agilent_34401a", script) as meter:
        assert meter.measure_resistance(100.0, 1) == 100.0
