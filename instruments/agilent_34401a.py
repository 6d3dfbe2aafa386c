"""HP/Agilent 34401A digital multimeter: check of a supply rail.

Source: 34401A User's Guide (CONFigure:VOLTage:DC, READ?; overload answers 9.9E37). Autorange at the slowest default of
6 1/2 digits takes up to about 2 s.
"""

from __future__ import annotations

from bench.model.ports import action
from instruments.readback import either
from instruments.scpi import ScpiInstrument
from instruments.values import read_number, read_text

_READING_LIMIT_S = 5.0


class Agilent34401A(ScpiInstrument):
    """Measurement of dc voltage with autorange."""

    identity_pattern = r"(HEWLETT-PACKARD|HP|AGILENT.*|KEYSIGHT.*),34401A"
    safe_state = "nothing to do: the meter drives nothing"

    @action(bus_s=2.0, returns="V")
    def measure_voltage(self) -> float:
        """Measure one dc voltage, volt. Raises: InstrumentError B-INST-007 on overload."""
        self.set("CONF:VOLT:DC", either(self._is_set_up, True))
        voltage_V = self.ask("READ?", read_number, patience_s=_READING_LIMIT_S)
        self.check_errors("READ?")
        return voltage_V

    def _is_set_up(self) -> bool:
        return self.ask("CONF?", read_text).strip('"').upper().startswith("VOLT ")

    def _go_safe(self) -> None:
        self.drain_errors()


DRIVER = Agilent34401A
