"""HP/Agilent 34401A digital multimeter: check of a supply rail, resistance with four wires.

Source: 34401A User's Guide (CONFigure:VOLTage:DC, CONFigure:FRESistance, FRESistance:NPLCycles, READ?; overload answers
9.9E37). Autorange at the slowest default of 6 1/2 digits takes up to about 2 s. With four wires autozero is always on:
a reading takes twice its integration time.
"""

from __future__ import annotations

from bench.model.ports import Parameter, action
from instruments.commands import either
from instruments.scpi import RANGES_OHM, ScpiInstrument, is_range
from instruments.values import exponent_form, read_number, read_text

_READING_LIMIT_S = 5.0


class Agilent34401A(ScpiInstrument):
    """Measurement of dc voltage with autorange, and of resistance with four wires on a range that is given."""

    identity_pattern = r"(HEWLETT-PACKARD|HP|AGILENT.*|KEYSIGHT.*),34401A"
    safe_state = "nothing to do: the meter drives nothing"
    remote = "SYST:REM"
    language = "SCPI in its interface menu"

    @action(bus_s=2.0, returns="V")
    def measure_voltage(self) -> float:
        """Measure one dc voltage, volt. Raises: InstrumentError B-INST-007 on overload."""
        self.bring("measure_voltage")
        self.set("CONF:VOLT:DC", either(self._is_set_up, True))
        return self.measured(read_number, _READING_LIMIT_S)

    @action(
        Parameter("range", "ohm", RANGES_OHM[0], RANGES_OHM[-1], values=RANGES_OHM),
        Parameter("cycles", choices=(1, 10, 100)),
        bus_s=4.5,
        returns="ohm",
    )
    def measure_resistance(self, range: float, cycles: int) -> float:  # noqa: A002 - the sequence's word
        """Measure one resistance with four wires, ohm, integrated over so many power-line cycles.

        Raises: InstrumentError B-INST-008, B-INST-007 on overload (above 120 % of the range) and with open leads.
        """
        self.bring("measure_resistance")
        configured = either(lambda: is_range(self.ask("CONF?", read_text), range), True)
        self.set(f"CONF:FRES {exponent_form(range)}", configured)
        self.set(f"FRES:NPLC {cycles}", self.number("FRES:NPLC?", cycles, 0.0))
        return self.measured(read_number, _READING_LIMIT_S)

    def _is_set_up(self) -> bool:
        return self.ask("CONF?", read_text).strip('"').upper().startswith("VOLT ")

    def _go_safe(self) -> None:
        self.drain_errors()


DRIVER = Agilent34401A
